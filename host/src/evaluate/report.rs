//! A report as one HTML file without any other file: tables and pictures.

use std::fmt::Write as _;
use std::io::Cursor;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::classify::{FrameCounts, Reference};
use super::drift::EvaluatedDrift;
use super::identity::Identity;
use super::plot::{self, flash_rows};
use super::precision::{Evaluated, Precision, Spread, middle_row};
use super::recording::Recording;
use super::track::Track;
use super::{EvaluateError, Settings};

const STYLE: &str = "body{font-family:sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.25rem .8rem;text-align:left;border-bottom:1px solid #ddd;vertical-align:top}\
td.n{text-align:right;font-variant-numeric:tabular-nums}svg{max-width:100%;height:auto}\
.note{background:#fff5d6;padding:.4rem .8rem;margin:.3rem 0}";

/// Report of a precision measurement.
pub fn precision(
    result: &Precision,
    shown: &Evaluated,
    settings: &Settings,
) -> Result<String, EvaluateError> {
    let mut body = String::from("<h1>Frame sync: bias and precision</h1>\n");
    body.push_str("<table>\n");
    if let Some(bias) = &result.bias {
        spread_rows(&mut body, "bias from perfect sync", bias);
    }
    row(
        &mut body,
        "row time",
        &format!(
            "{:.4} ± {:.4} µs",
            result.row_time_us, result.row_time_sigma_us
        ),
    );
    if let Some(paper) = &result.paper_bias {
        spread_rows(&mut body, "published pipeline: bias", paper);
        if let Some(t) = result.paper_row_time_us {
            row(
                &mut body,
                "published pipeline: row time",
                &format!("{t:.4} µs"),
            );
        }
    }
    body.push_str("</table>\n<h2>Recordings</h2>\n<table><tr><th>recording</th><th>bias, µs</th><th>1 σ, µs</th><th>row</th><th>row time, µs</th><th>which flash</th><th>frames</th></tr>\n");
    for r in &result.recordings {
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td class=n>{:.3}</td><td class=n>{:.3}</td><td class=n>{:.2}</td><td class=n>{:.4}</td><td>{}</td><td>{}</td></tr>",
            escape(&r.path.display().to_string()),
            r.bias_us,
            r.sigma_us,
            r.row,
            r.row_time_us,
            identity_text(&r.identity),
            counts_text(&r.frames),
        );
    }
    for l in &result.left_out {
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td colspan=6>left out: {}</td></tr>",
            escape(&l.path.display().to_string()),
            escape(&l.reason)
        );
    }
    body.push_str("</table>\n");
    for r in &result.recordings {
        notes(&mut body, &r.path.display().to_string(), &r.notes);
    }
    body.push_str("<h2>Frame with the rows found</h2>\n");
    body.push_str(&picture(&shown.recording, &shown.track, settings)?);
    body.push_str("<h2>Row profile and launches</h2>\n");
    body.push_str(&plot::precision(
        result,
        shown,
        &settings.train,
        settings.path_delay_us,
    )?);
    Ok(page("Frame sync: precision", &body))
}

/// Report of a drift measurement.
pub fn drift(drift: &EvaluatedDrift, settings: &Settings) -> Result<String, EvaluateError> {
    let r = &drift.result;
    let mut body = String::from("<h1>Frame sync: drift</h1>\n<table>\n");
    row(
        &mut body,
        "recording",
        &escape(&r.path.display().to_string()),
    );
    row(
        &mut body,
        "drift",
        &format!(
            "{:+.4} ± {:.4} µs/min (1 σ)",
            r.drift_us_per_min, r.drift_sigma_us_per_min
        ),
    );
    row(
        &mut body,
        "bias",
        &format!(
            "{:+.3} µs at the start, {:+.3} µs at the end, {:.1} s later",
            r.bias_at_start_us, r.bias_at_end_us, r.span_s
        ),
    );
    row(
        &mut body,
        "frames about the line",
        &format!("{:.3} µs (standard deviation)", r.residual_sd_us),
    );
    row(
        &mut body,
        "row time",
        &format!("{:.4} ± {:.4} µs", r.row_time_us, r.row_time_sigma_us),
    );
    row(&mut body, "which flash", &identity_text(&r.identity));
    row(&mut body, "frames", &counts_text(&r.frames));
    row(&mut body, "scene taken from", reference_text(r.reference));
    if let Some(p) = &r.paper {
        row(
            &mut body,
            "published pipeline",
            &format!(
                "{:+.4} ± {:.4} µs/min from {} frames, row time {:.4} µs",
                p.drift_us_per_min, p.drift_sigma_us_per_min, p.frames, p.row_time_us
            ),
        );
    }
    body.push_str("</table>\n");
    notes(&mut body, &r.path.display().to_string(), &r.notes);
    body.push_str("<h2>Frame with the rows found</h2>\n");
    body.push_str(&picture(&drift.recording, &drift.track, settings)?);
    body.push_str("<h2>Row profile and drift</h2>\n");
    body.push_str(&plot::drift(
        drift,
        &settings.train,
        settings.path_delay_us,
    )?);
    Ok(page("Frame sync: drift", &body))
}

/// Which flash is which, in words.
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

/// What became of the frames, in words.
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

/// What the scene's own brightness was taken from, in words.
pub const fn reference_text(reference: Reference) -> &'static str {
    match reference {
        Reference::DarkFrames(_) => "frames without flashes",
        Reference::DarkRows => "rows while they saw no flash",
        Reference::Polynomial => "a smooth curve (no frames without flashes)",
    }
}

fn spread_rows(out: &mut String, name: &str, s: &Spread) {
    row(
        out,
        name,
        &format!(
            "mean {:+.3} ± {:.3} µs, median {:+.3} µs, {} recordings",
            s.mean_us, s.mean_sigma_us, s.median_us, s.count
        ),
    );
    if let (Some(sd), Some(sd_sigma), Some(iqr), Some(iqr_sigma)) =
        (s.sd_us, s.sd_sigma_us, s.iqr_us, s.iqr_sigma_us)
    {
        row(
            out,
            "spread over recordings",
            &format!("IQR {iqr:.3} ± {iqr_sigma:.3} µs, SD {sd:.3} ± {sd_sigma:.3} µs"),
        );
    }
}

fn row(out: &mut String, name: &str, value: &str) {
    let _ = writeln!(out, "<tr><th>{name}</th><td>{value}</td></tr>");
}

fn notes(out: &mut String, path: &str, notes: &[String]) {
    for note in notes {
        let _ = writeln!(out, "<p class=note>{}: {}</p>", escape(path), escape(note));
    }
}

/// The frame with lines where the flashes were found.
fn picture(
    recording: &Recording,
    track: &Track,
    settings: &Settings,
) -> Result<String, EvaluateError> {
    let picture = &recording.picture;
    let (w, h) = (picture.width, picture.height);
    let png_error = |e: image::ImageError| EvaluateError::Plot(e.to_string());
    let mut png = Cursor::new(Vec::new());
    image::write_buffer_with_format(
        &mut png,
        &picture.pixels,
        w as u32,
        h as u32,
        image::ExtendedColorType::L8,
        image::ImageFormat::Png,
    )
    .map_err(png_error)?;
    let own = track.points.iter().find(|p| p.index == picture.index);
    let bias = own.map_or(track.joint.mean_us, |p| p.bias_us) + settings.path_delay_us;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\">\n<image width=\"{w}\" height=\"{h}\" href=\"data:image/png;base64,{}\"/>\n",
        STANDARD.encode(png.get_ref())
    );
    // Places in the reduced picture: the centre of a row's pixels.
    let place = |row: f64| {
        let (line, vertical) = recording.reducer.image_line(row);
        ((line + 0.5) / picture.reduction as f64, vertical)
    };
    let across = |row: f64, from: f64, to: f64| {
        let (at, vertical) = place(row);
        if vertical {
            format!(
                "x1=\"{at:.2}\" y1=\"{:.1}\" x2=\"{at:.2}\" y2=\"{:.1}\"",
                from * h as f64,
                to * h as f64
            )
        } else {
            format!(
                "x1=\"{:.1}\" y1=\"{at:.2}\" x2=\"{:.1}\" y2=\"{at:.2}\"",
                from * w as f64,
                to * w as f64
            )
        }
    };
    for (number, row) in flash_rows(recording, track, &settings.train, bias) {
        // Only at the edges, so that the bands stay visible.
        for (from, to) in [(0.0, 0.18), (0.82, 1.0)] {
            let _ = writeln!(
                svg,
                "<line {} stroke=\"#ff6a3d\" stroke-width=\"1.2\"/>",
                across(row, from, to)
            );
        }
        let (at, vertical) = place(row);
        let (x, y) = if vertical {
            (at + 3.0, 14.0)
        } else {
            (4.0, at - 3.0)
        };
        let _ = writeln!(
            svg,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"#ff6a3d\" font-family=\"sans-serif\" font-size=\"14\">flash {number}, row {row:.2}</text>"
        );
    }
    let _ = writeln!(
        svg,
        "<line {} stroke=\"#39a0ff\" stroke-width=\"1.2\" stroke-dasharray=\"6 4\"/>",
        across(middle_row(recording), 0.0, 1.0)
    );
    svg.push_str("</svg>\n");
    let _ = writeln!(
        svg,
        "<p>Frame {} of the recording. Dashed: the middle row.</p>",
        picture.index
    );
    Ok(svg)
}

fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style></head>\n<body>\n{body}</body></html>\n"
    )
}

/// File names are not markup.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_not_markup() {
        assert_eq!(
            escape("<a href=\"x\">&"),
            "&lt;a href=&quot;x&quot;&gt;&amp;"
        );
    }

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
