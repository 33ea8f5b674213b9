//! The report of a measurement of frame sync.

mod picture;
pub mod plot;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::json;

use evaluate::Settings;
use evaluate::classify::{FrameCounts, Reference};
use evaluate::drift::{Drift, EvaluatedDrift};
use evaluate::identity::Identity;
use evaluate::precision::{Precision, Spread};
use evaluate::shown::Shown;

use crate::page::Page;
use recording::finding::Severity;

/// The report of a precision measurement, with pictures of one of its recordings.
#[must_use]
pub fn precision(result: &Precision, shown: &Shown, settings: &Settings) -> String {
    let (level, verdict) = precision_verdict(result);
    let mut page = Page::new("Frame sync: bias and precision", level, &verdict);
    page.facts(&precision_facts(result));
    page.section("Recordings");
    let rows = result.recordings.iter().map(|r| {
        [
            short(&r.path),
            format!("{:.3}", r.bias_us),
            format!("{:.3}", r.sigma_us),
            format!("{:.2}", r.row),
            format!("{:.4}", r.row_time_us),
            String::from(if r.identity.unique { "decided" } else { "open" }),
            format!("{} of {}", r.frames.used, r.frames.read),
        ]
    });
    page.table(
        [
            "recording",
            "bias, µs",
            "1 σ, µs",
            "row",
            "row time, µs",
            "which flash",
            "frames used",
        ],
        rows,
    );
    for r in &result.recordings {
        let name = short(&r.path);
        if !r.identity.unique {
            let open = format!(
                "{name}: which flash is which is {}",
                identity_text(&r.identity)
            );
            page.note(Severity::Check, &open);
        }
        notes(&mut page, &name, &r.notes);
    }
    for l in &result.left_out {
        let text = format!("{} is left out: {}", l.path.display(), l.reason);
        page.note(Severity::Bad, &text);
    }
    page.section("Frame with the rows found");
    picture(&mut page, shown);
    page.section("Row profile and launches");
    page.figure(
        &plot::precision(result, shown),
        "Brightness of the sensor's rows with the fitted train of flashes; with two or more \
         recordings, their biases.",
    );
    page.settings("Settings", &json!(settings));
    page.html()
}

/// Bias, spread and row time over all recordings, each with its name.
#[must_use]
pub fn precision_facts(result: &Precision) -> Vec<(&'static str, String)> {
    let mut facts = Vec::new();
    if let Some(bias) = &result.bias {
        spread_rows(&mut facts, "bias from perfect sync", bias);
    }
    let (row_time_us, sigma_us) = (result.row_time_us, result.row_time_sigma_us);
    facts.push(("row time", format!("{row_time_us:.4} ± {sigma_us:.4} µs")));
    facts
}

fn precision_verdict(result: &Precision) -> (Severity, String) {
    let open = result.recordings.iter().any(|r| !r.identity.unique);
    let level = if open || !result.left_out.is_empty() {
        Severity::Check
    } else {
        Severity::Good
    };
    let mut text = match &result.bias {
        Some(bias) => format!(
            "The depth camera is exposed {:.1} ± {:.1} µs {} the middle of the phone's frame \
             ({}).",
            bias.mean_us.abs(),
            bias.mean_sigma_us,
            if bias.mean_us < 0.0 {
                "before"
            } else {
                "after"
            },
            if bias.count == 1 {
                String::from("one recording")
            } else {
                format!("mean of {} recordings", bias.count)
            }
        ),
        None => String::from("No recording gave a bias."),
    };
    if open {
        text.push_str(
            " Which flash is which is open: the bias may be off by whole pitches (see below).",
        );
    }
    if !result.left_out.is_empty() {
        let _ = write!(
            text,
            " Left out, because it could not be used: {}.",
            result.left_out.len()
        );
    }
    (level, text)
}

/// The report of a drift measurement.
#[must_use]
pub fn drift(drift: &EvaluatedDrift, settings: &Settings) -> String {
    let r = &drift.result;
    let level = if r.identity.unique && r.notes.is_empty() {
        Severity::Good
    } else {
        Severity::Check
    };
    let verdict = format!(
        "Over {:.1} s the depth camera's exposure moves against the phone's (depth minus phone) \
         by {:+.2} ± {:.2} µs a minute, from \
         {:+.1} µs at the start to {:+.1} µs at the end.",
        r.span_s,
        r.drift_us_per_min,
        r.drift_sigma_us_per_min,
        r.bias_at_start_us,
        r.bias_at_end_us
    );
    let mut page = Page::new("Frame sync: drift", level, &verdict);
    page.facts(&drift_facts(r));
    notes(&mut page, &r.path.display().to_string(), &r.notes);
    page.section("Frame with the rows found");
    picture(&mut page, &drift.shown);
    page.section("Row profile and drift");
    page.figure(
        &plot::drift(drift),
        "Brightness of the sensor's rows with the fitted train of flashes; and the train's place \
         against time with the fitted line.",
    );
    page.settings("Settings", &json!(settings));
    page.html()
}

/// Figures of a recording, each with its name.
#[must_use]
pub fn drift_facts(r: &Drift) -> Vec<(&'static str, String)> {
    let mut facts = Vec::new();
    let mut fact = |name, value: String| facts.push((name, value));
    fact("recording", r.path.display().to_string());
    fact(
        "drift",
        format!(
            "{:+.4} ± {:.4} µs/min, depth minus phone (1 σ)",
            r.drift_us_per_min, r.drift_sigma_us_per_min
        ),
    );
    fact(
        "bias",
        format!(
            "{:+.3} µs at the start, {:+.3} µs at the end, {:.1} s later",
            r.bias_at_start_us, r.bias_at_end_us, r.span_s
        ),
    );
    fact(
        "frames about the line",
        format!(
            "{:.3} µs (standard deviation), {} far off it left out",
            r.residual_sd_us, r.outliers
        ),
    );
    fact(
        "row time",
        format!(
            "{:.4} ± {:.4} µs, exposure {:.1} µs",
            r.row_time_us, r.row_time_sigma_us, r.exposure_us
        ),
    );
    fact("which flash", identity_text(&r.identity));
    if let Some(window) = window_text(r) {
        fact("window", window);
    }
    fact("frames", counts_text(&r.frames));
    fact("scene taken from", reference_text(r.reference).to_owned());
    facts
}

/// Assignment of flashes to bands, in words.
pub fn identity_text(identity: &Identity) -> String {
    if identity.unique {
        return "decided by the train's ends".to_owned();
    }
    let Some(first) = identity.candidates.first() else {
        return "open".to_owned();
    };
    let candidates: Vec<String> = identity
        .candidates
        .iter()
        .map(|c| format!("{:+.1}", c.bias_us))
        .collect();
    let exposures = identity
        .candidates
        .iter()
        .any(|c| (c.exposure_us - first.exposure_us).abs() > 1.0);
    format!(
        "open: the frames do not show the train's ends; {} µs fit equally well, the first is taken (nearest to the expected bias{})",
        candidates.join(", "),
        if exposures {
            ", shortest exposure; the true exposure, given with --exposure, decides between them"
        } else {
            ""
        }
    )
}

/// The part of the recording that was found by itself, in words.
fn window_text(drift: &Drift) -> Option<String> {
    let [from, to] = drift.window_s?;
    Some(format!(
        "{from:.1} s to {to:.1} s of the recording, found by itself: before or after that the \
         train is being aligned or runs free (others: --from, --to)"
    ))
}

/// Counts of the frames, in words.
pub fn counts_text(c: &FrameCounts) -> String {
    let mut text = format!("{} used of {}", c.used, c.read);
    for (count, what) in [
        (c.read - c.examined.min(c.read), "not examined"),
        (c.spare, "not needed"),
        (c.without_flashes, "without flashes"),
        (c.flicker, "with changing room light"),
        (c.unclear, "unclear"),
    ] {
        if count > 0 {
            let _ = write!(text, ", {count} {what}");
        }
    }
    text
}

/// Source of the scene's own brightness, in words.
pub const fn reference_text(reference: Reference) -> &'static str {
    match reference {
        Reference::DarkFrames(_) => "frames without flashes",
        Reference::DarkRows => "rows while they saw no flash",
        Reference::Polynomial => "a smooth curve (no frames without flashes)",
    }
}

/// The last two parts of a path: a recording's name and its video's.
fn short(path: &Path) -> String {
    let parts: Vec<_> = path.components().collect();
    let last: PathBuf = parts.iter().skip(parts.len().saturating_sub(2)).collect();
    last.display().to_string()
}

fn spread_rows(facts: &mut Vec<(&str, String)>, name: &'static str, s: &Spread) {
    let rest = match s.count {
        1 => String::from("one recording"),
        count => format!("median {:+.3} µs, {count} recordings", s.median_us),
    };
    facts.push((
        name,
        format!("mean {:+.3} ± {:.3} µs, {rest}", s.mean_us, s.mean_sigma_us),
    ));
    if let (Some(sd), Some(sd_sigma), Some(iqr), Some(iqr_sigma)) =
        (s.sd_us, s.sd_sigma_us, s.iqr_us, s.iqr_sigma_us)
    {
        facts.push((
            "spread over recordings",
            format!("IQR {iqr:.3} ± {iqr_sigma:.3} µs, SD {sd:.3} ± {sd_sigma:.3} µs"),
        ));
    }
}

fn notes(page: &mut Page, path: &str, notes: &[String]) {
    for note in notes {
        page.note(Severity::Check, &format!("{path}: {note}"));
    }
}

/// The frame with lines where the flashes were found.
fn picture(page: &mut Page, shown: &Shown) {
    let index = shown.picture.index;
    let caption = format!("Frame {index} of the recording. Dashed: the middle row.");
    match picture::svg(shown) {
        Ok(svg) => page.picture(&svg, &caption),
        Err(error) => page.note(
            Severity::Check,
            &format!("The frame cannot be drawn: {error}"),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_name_only_what_there_is() {
        let counts = FrameCounts {
            read: 30,
            examined: 30,
            used: 16,
            spare: 10,
            without_flashes: 4,
            ..FrameCounts::default()
        };
        assert_eq!(
            counts_text(&counts),
            "16 used of 30, 10 not needed, 4 without flashes"
        );
    }
}
