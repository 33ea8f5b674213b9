//! The report of a measurement of frame sync.

mod picture;
mod plot;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::json;

use evaluate::Settings;
use evaluate::drift::{Drift, EvaluatedDrift};
use evaluate::precision::{BiasStatistics, Precision};
use evaluate::shown::Shown;
use evaluate::track::{FrameCounts, Identity};

use crate::page::Page;
use crate::session::link_to;
use crate::summary::{Facts, Summary, titled};
use board::finding::{Finding, Severity};
use recording::error_budget::COARSE_US;
use recording::session_file::SessionFile;

/// Returns the page of a precision measurement, with pictures of one of its recordings.
/// `is_written` is true if the profile has its bias by now; `out` is its future path, for the links.
#[must_use]
pub fn precision(
    result: &Precision,
    is_written: bool,
    shown: &Shown,
    settings: &Settings,
    out: &Path,
) -> String {
    let recordings = result.recordings.iter();
    let mut summary = precision_summary(result, is_written);
    let mut boards = recordings.clone().filter_map(|r| board_of(&r.path));
    let simulated = boards.find(|id| protocol::usb::is_simulated(id));
    summary.title = titled(summary.title, simulated.as_deref());
    let mut page = Page::new(&summary);
    let links = recordings.filter_map(|recording| recording_link(&recording.path, out));
    page.links(&links.collect::<Vec<_>>());
    pictures(&mut page, shown);
    if result.recordings.len() > 1 {
        let svg = plot::launches(&result.recordings);
        page.figure(&svg, "The bias of each recording, with its 1-sigma.");
    }
    page.settings("Settings", &json!(settings));
    page.html()
}

/// Returns the page of a drift measurement; `out` is its future path, for the links.
#[must_use]
pub fn drift(drift: &EvaluatedDrift, settings: &Settings, out: &Path) -> String {
    let mut summary = drift_summary(&drift.result);
    summary.title = titled(summary.title, board_of(&drift.result.path).as_deref());
    let mut page = Page::new(&summary);
    page.links(recording_link(&drift.result.path, out).as_slice());
    pictures(&mut page, &drift.shown);
    page.figure(
        &plot::course(drift),
        "The train's place against time, as a time from the middle row, with the fitted line.",
    );
    page.settings("Settings", &json!(settings));
    page.html()
}

/// Returns the serial number of the board with which a video was recorded, if that is known.
fn board_of(video: &Path) -> Option<String> {
    let session = SessionFile::load(system::folder_of(video)).ok()?;
    session.board.map(|board| board.id)
}

/// Returns the link to the report of the recording that contains a video.
fn recording_link(video: &Path, out: &Path) -> Option<(String, String)> {
    let from = system::folder_of(out);
    link_to(video, from).or_else(|| link_to(system::folder_of(video), from))
}

/// Adds the frame with lines at the flashes, and the drawing of the fit.
fn pictures(page: &mut Page, shown: &Shown) {
    page.section("Frame with the rows found");
    let index = shown.picture.index;
    match picture::svg(shown) {
        Ok(svg) => page.picture(
            &svg,
            &format!("Frame {index} of the recording. Dashed: the middle row."),
        ),
        Err(error) => page.note(
            Severity::Check,
            &format!("The frame cannot be drawn: {error}"),
        ),
    }
    page.section("Row profile and fit");
    let caption = "Mean brightness of the sensor's rows with the fitted train of flashes.";
    page.figure(&plot::profile(shown), caption);
}

/// Returns the summary of a precision measurement: bias, scatter and row time over all
/// recordings, and each recording. `is_written` is true if the profile has the bias by now.
#[must_use]
pub fn precision_summary(result: &Precision, is_written: bool) -> Summary {
    let mut facts = Facts::new();
    if let Some(bias) = &result.bias {
        bias_facts(&mut facts, bias);
    }
    let (row_time_us, sigma_us) = (result.row_time_us, result.row_time_sigma_us);
    facts.push(("row time", format!("{row_time_us:.4} ± {sigma_us:.4} µs")));
    let mut parts = Vec::new();
    for r in &result.recordings {
        let name = short(&r.path);
        let frames = counts_text(&r.frames);
        facts.push((
            "recording",
            format!(
                "{name}: {:+.3} ± {:.3} µs (1 σ){}, row {:.2}; row time {:.4} ± {:.4} µs, exposure \
                 {:.1} µs, flash {:.1} grey levels; frames: {frames}",
                r.unshifted_us(),
                r.sigma_us,
                shifted(r.shift_us),
                r.row,
                r.row_time_us,
                r.row_time_sigma_us,
                r.exposure_us,
                r.amplitude
            ),
        ));
        parts.extend(remarks(&name, &r.identity, &r.notes));
    }
    let is_open = result.recordings.iter().any(|r| !r.identity.unique);
    let left_out = result.left_out.iter();
    parts.extend(left_out.map(|l| {
        let text = format!("left out: {}", l.reason);
        Finding::check(short(&l.path), text)
    }));
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
    let total = result.bias.as_ref().filter(|_| !is_open);
    let total_us = total.map(|bias| bias.mean_us.hypot(bias.mean_sigma_us));
    if is_open {
        text.push_str(" Which flash is which is open: the bias may be off by whole pitches.");
    } else if is_written {
        text.push_str(" It is in the profile: the next recording takes it out.");
    } else if total_us.is_some_and(|total| total >= COARSE_US) {
        // The distance itself is the verdict, however well it was measured.
        parts.push(Finding::check(
            "bias",
            "milliseconds apart: it belongs into the profile (--calibrate)",
        ));
    }
    let severities = parts.iter().map(|part| part.severity);
    Summary {
        title: String::from("Frame sync: bias and precision"),
        severity: severities.max().unwrap_or(Severity::Good),
        text,
        parts,
        facts,
    }
}

/// Describes an intended shift, µs, that was taken out of a bias.
fn shifted(shift_us: f64) -> String {
    if shift_us == 0.0 {
        return String::new();
    }
    format!(" without the {shift_us:.0} µs by which the trigger was shifted on purpose")
}

/// Returns the summary of a drift measurement.
#[must_use]
pub fn drift_summary(r: &Drift) -> Summary {
    let mut facts = Facts::new();
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
        match (r.bias_at_start_us, r.bias_at_end_us) {
            (Some(start), Some(end)) => format!(
                "{start:+.3} µs at the start, {end:+.3} µs at the end, {:.1} s later",
                r.span_s
            ),
            _ => String::from("open by whole pitches: which flash is which is not known"),
        },
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
    if let Some(window) = window_text(r) {
        fact("window", window);
    }
    fact("frames", counts_text(&r.frames));
    let parts = remarks(&short(&r.path), &r.identity, &r.notes);
    Summary {
        title: String::from("Frame sync: drift"),
        severity: match parts.as_slice() {
            [] => Severity::Good,
            _ => Severity::Check,
        },
        text: format!(
            "Over {:.1} s the depth camera's exposure moves against the phone's (depth minus \
             phone) by {:+.2} ± {:.2} µs a minute.",
            r.span_s, r.drift_us_per_min, r.drift_sigma_us_per_min
        ),
        parts,
        facts,
    }
}

/// Returns the remarks about a recording as findings.
fn remarks(name: &str, identity: &Identity, notes: &[String]) -> Vec<Finding> {
    let open = (!identity.unique).then(|| {
        let flashes = identity_text(identity);
        format!("which flash is which is {flashes}")
    });
    let notes = open.iter().chain(notes);
    notes.map(|note| Finding::check(name, note)).collect()
}

/// Describes an ambiguous assignment of flashes to bands.
fn identity_text(identity: &Identity) -> String {
    let candidates = identity.candidates.iter();
    let candidates: Vec<String> = candidates.map(|c| format!("{:+.1}", c.bias_us)).collect();
    if candidates.is_empty() {
        return "open".to_owned();
    }
    format!(
        "open: the frames do not show the train's ends; {} µs fit equally well, the first is used \
         (shortest exposure, nearest to the expected bias; --exposure and --near decide)",
        candidates.join(", ")
    )
}

/// Describes the part of the recording that was found automatically.
fn window_text(drift: &Drift) -> Option<String> {
    let [from, to] = drift.window_s?;
    Some(format!(
        "{from:.1} s to {to:.1} s of the recording, found automatically: before or after that the \
         train is being aligned or runs free (others: --from, --to)"
    ))
}

/// Describes the counts of the frames.
fn counts_text(c: &FrameCounts) -> String {
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

/// Returns the last two parts of a path: the names of a recording and of its video.
fn short(path: &Path) -> String {
    let parts: Vec<_> = path.components().collect();
    let last: PathBuf = parts.iter().skip(parts.len().saturating_sub(2)).collect();
    last.display().to_string()
}

fn bias_facts(facts: &mut Facts, s: &BiasStatistics) {
    let rest = match s.count {
        1 => String::from("one recording"),
        count => format!("median {:+.3} µs, {count} recordings", s.median_us),
    };
    facts.push((
        "bias from perfect sync",
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
