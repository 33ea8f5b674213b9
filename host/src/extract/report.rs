//! The report of an extraction: `report.json` for programs, `report.html` for
//! people, with the same content.
//!
//! Nothing in it depends on when or how often the extraction ran, so that
//! repeating it gives the same files.

use std::fmt::Write;

use serde::Serialize;

use super::gyro_clock::WindowResult;
use super::layout::Format;
use super::pairs::{Histogram, Spread};
use super::survey::ImuSpan;

/// Something that is missing or damaged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Loss {
    /// Which part: `board`, `phone`, `video`, `depth`, `clock`, `pairs`.
    pub part: &'static str,
    /// What is missing, and what that means.
    pub what: String,
}

/// Everything there is to say.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Version of this form.
    pub version: u32,
    /// Name of the recording.
    pub recording: String,
    /// The format.
    pub format: Format,
    /// The board.
    pub board: BoardReport,
    /// The phone, if its files are there.
    pub phone: Option<PhoneReport>,
    /// How phone time became board time.
    pub clock: Option<ClockReport>,
    /// The depth camera, if its recording is there.
    pub depth: Option<DepthReport>,
    /// Pairs of frames.
    pub pairs: Option<PairsReport>,
    /// The parts that marks divide the recording into.
    pub sequences: Vec<SequenceReport>,
    /// Constants that went into the times, ns.
    pub constants: Constants,
    /// What is missing or damaged. Empty: all is there.
    pub losses: Vec<Loss>,
    /// Worth knowing, but no loss.
    pub remarks: Vec<String>,
}

/// Constants that went into the times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Constants {
    /// Low-pass delay subtracted from the board's IMU times (not in the topics
    /// layout), ns.
    pub board_imu_delay_ns: i64,
    /// The same of the phone, ns.
    pub phone_imu_delay_ns: i64,
    /// From the phone's frame timestamp to the middle of exposure of the middle
    /// row, ns.
    pub color_middle_ns: i64,
    /// From the trigger pulse to the depth timestamp, ns.
    pub depth_center_ns: i64,
}

/// The board's part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BoardReport {
    /// The board's unique ID, if the session knows it.
    pub id: Option<String>,
    /// Pulses.
    pub pulses: usize,
    /// Median distance of pulses, ns.
    pub pulse_period_ns: Option<i64>,
    /// Pulses missing in the recording: train, first number, how many.
    pub missing_pulses: Vec<(u32, u64, u64)>,
    /// Samples of the IMU.
    pub imu: ImuSpan,
    /// Marks, ns.
    pub marks_ns: Vec<i64>,
}

/// The phone's part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PhoneReport {
    /// Name of the video.
    pub name: String,
    /// Frame timestamps.
    pub timestamps: usize,
    /// Frames of the video as decoded.
    pub video_frames: Option<u64>,
    /// Images written.
    pub images: u64,
    /// Samples of the gyroscope.
    pub gyro_samples: u64,
    /// Rows of the IMU table.
    pub imu_rows: u64,
}

/// How phone time became board time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockReport {
    /// `gyroscopes`, `session` (the twist's model) or `bag` (the recorded offset).
    pub source: &'static str,
    /// Windows with data.
    pub windows: usize,
    /// Windows that were used.
    pub used: usize,
    /// Windows that contradict the rest.
    pub contradicting: usize,
    /// Phone − board at the middle of the recording, s.
    pub offset_s: f64,
    /// Rate of the phone's clock against the board's, ppm.
    pub skew_ppm: f64,
    /// 1-sigma of the rate, ppm.
    pub skew_sigma_ppm: f64,
    /// Smallest and largest 1-sigma of the offset over the frames, µs.
    pub sigma_us: [f64; 2],
    /// Root mean square of the windows against the course, µs.
    pub residual_us: f64,
    /// Distance of frames in the phone's own time, ns, with 1-sigma.
    pub frame_period_ns: Option<(f64, f64)>,
    /// The windows.
    pub course: Vec<WindowResult>,
}

/// The depth camera's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DepthReport {
    /// Frames in the file.
    pub frames: usize,
    /// Frames with a pulse of their own.
    pub matched: usize,
    /// What decided which pulse is whose; empty if the frames were not matched.
    pub decided_by: String,
    /// Why they were not matched.
    pub not_matched: Option<String>,
    /// Rate of the camera's clock against the board's, ppm, with 1-sigma.
    pub rate_ppm: Option<(f64, f64)>,
    /// Robust scatter of frame time against pulse, µs.
    pub residual_us: Option<f64>,
    /// Pulses without a frame (numbers), between the first and the last frame.
    pub missing: Vec<u64>,
    /// Doubled frames.
    pub doubled: Vec<usize>,
    /// Frames off any recorded pulse.
    pub off_pulse: Vec<usize>,
    /// Frames behind the last pulse.
    pub after_last_pulse: usize,
    /// Frames without a whole image.
    pub broken: Vec<usize>,
    /// Frames whose part of the file has a wrong checksum.
    pub damaged: Vec<usize>,
    /// Frames without any depth.
    pub empty: Vec<usize>,
    /// Pixels beyond the format's range.
    pub out_of_range: u64,
    /// Images written.
    pub images: u64,
    /// Infrared images written.
    pub infrared: u64,
    /// Mode of the camera.
    pub mode: Option<String>,
    /// Serial number of the camera.
    pub serial: Option<String>,
}

/// Pairs of frames.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PairsReport {
    /// Phone − depth.
    pub spread: Spread,
    /// Phone − depth.
    pub histogram: Histogram,
}

/// One part of the recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SequenceReport {
    /// Its folder; `.` if there are no marks.
    pub folder: String,
    /// Phone images.
    pub color: usize,
    /// Depth images.
    pub depth: usize,
    /// Pairs.
    pub pairs: usize,
}

impl Report {
    /// The report as text for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        for (name, value) in self.lines() {
            let _ = writeln!(out, "{name:<22} {value}");
        }
        for loss in &self.losses {
            let _ = writeln!(out, "missing ({}): {}", loss.part, loss.what);
        }
        for remark in &self.remarks {
            let _ = writeln!(out, "note: {remark}");
        }
        out
    }

    /// Name and value of what matters most.
    fn lines(&self) -> Vec<(&'static str, String)> {
        let mut lines = vec![
            ("recording", self.recording.clone()),
            ("format", self.format.name().into()),
            ("trigger pulses", self.board.pulses.to_string()),
            ("board IMU samples", self.board.imu.samples.to_string()),
        ];
        if let Some(phone) = &self.phone {
            lines.push(("phone timestamps", phone.timestamps.to_string()));
            lines.push(("phone images", phone.images.to_string()));
            lines.push(("phone IMU rows", phone.imu_rows.to_string()));
        }
        if let Some(clock) = &self.clock {
            lines.push((
                "clock relation",
                format!(
                    "from {}: {:.3} ppm ± {:.3}, 1-sigma {:.1} to {:.1} µs, residual {:.1} µs, {} of {} windows",
                    clock.source,
                    clock.skew_ppm,
                    clock.skew_sigma_ppm,
                    clock.sigma_us[0],
                    clock.sigma_us[1],
                    clock.residual_us,
                    clock.used,
                    clock.windows
                ),
            ));
        }
        if let Some(depth) = &self.depth {
            lines.push((
                "depth frames",
                format!("{}, {} on a pulse", depth.frames, depth.matched),
            ));
            lines.push(("depth images", depth.images.to_string()));
            if let (Some((rate, sigma)), Some(residual)) = (depth.rate_ppm, depth.residual_us) {
                lines.push((
                    "depth clock",
                    format!(
                        "{rate:.2} ppm ± {sigma:.2}, scatter {residual:.1} µs, decided by {}",
                        depth.decided_by
                    ),
                ));
            }
            lines.push(("pulses without a frame", depth.missing.len().to_string()));
        }
        if let Some(pairs) = &self.pairs {
            let us = |ns: i64| format!("{:.1}", ns as f64 / 1000.0);
            let spread = &pairs.spread;
            lines.push((
                "pairs",
                format!(
                    "{}, phone − depth: median {} µs, quartiles {} to {} µs",
                    spread.count,
                    us(spread.median_ns),
                    us(spread.quartiles_ns[0]),
                    us(spread.quartiles_ns[1])
                ),
            ));
        }
        lines
    }

    /// The report as a page without anything from outside.
    #[must_use]
    pub fn html(&self) -> String {
        let mut out = String::from(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Extraction</title>\n\
             <style>body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}\
             table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.2em .6em;text-align:left}\
             svg{width:100%;height:auto}</style></head><body>\n",
        );
        let _ = writeln!(
            out,
            "<h1>Extraction of {}</h1>\n<table>",
            escape(&self.recording)
        );
        for (name, value) in self.lines() {
            let _ = writeln!(out, "<tr><th>{name}</th><td>{}</td></tr>", escape(&value));
        }
        out.push_str("</table>\n");
        let lists = [
            (
                "Missing or damaged",
                self.losses
                    .iter()
                    .map(|loss| format!("{}: {}", loss.part, loss.what))
                    .collect::<Vec<_>>(),
            ),
            ("Remarks", self.remarks.clone()),
        ];
        for (title, items) in lists {
            if items.is_empty() {
                continue;
            }
            let _ = writeln!(out, "<h2>{title}</h2>\n<ul>");
            for item in items {
                let _ = writeln!(out, "<li>{}</li>", escape(&item));
            }
            out.push_str("</ul>\n");
        }
        if let Some(pairs) = &self.pairs {
            out.push_str("<h2>Time difference of the pairs</h2>\n");
            out.push_str(&histogram_svg(&pairs.histogram));
        }
        if let Some(clock) = self.clock.as_ref().filter(|clock| clock.course.len() > 1) {
            out.push_str("<h2>Clock of the phone: each window against the smoothed course</h2>\n");
            out.push_str(&course_svg(&clock.course));
        }
        if self.sequences.len() > 1 {
            out.push_str("<h2>Sequences</h2>\n<table><tr><th>folder</th><th>phone</th><th>depth</th><th>pairs</th></tr>\n");
            for part in &self.sequences {
                let _ = writeln!(
                    out,
                    "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                    escape(&part.folder),
                    part.color,
                    part.depth,
                    part.pairs
                );
            }
            out.push_str("</table>\n");
        }
        out.push_str("</body></html>\n");
        out
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// A drawing with plotters; the backend draws into text, which cannot fail, so a
/// failure gives an empty drawing.
fn histogram_svg(histogram: &Histogram) -> String {
    use plotters::prelude::*;
    let mut svg = String::new();
    let us = |bin: usize| (histogram.first_ns + bin as i64 * histogram.bin_ns) as f64 / 1000.0;
    let top = histogram.counts.iter().copied().max().unwrap_or(0).max(1) as f64;
    let mut draw = || -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(&mut svg, (800, 320)).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(us(0)..us(histogram.counts.len()), 0.0..top * 1.05)?;
        chart
            .configure_mesh()
            .x_desc("phone − depth, µs")
            .y_desc("pairs")
            .draw()?;
        chart.draw_series(histogram.counts.iter().enumerate().map(|(bin, &count)| {
            Rectangle::new(
                [(us(bin), 0.0), (us(bin + 1), count as f64)],
                BLUE.mix(0.6).filled(),
            )
        }))?;
        root.present()?;
        Ok(())
    };
    if draw().is_err() {
        return String::new();
    }
    svg
}

fn course_svg(course: &[WindowResult]) -> String {
    use plotters::prelude::*;
    let mut svg = String::new();
    let first = course.first().map_or(0.0, |window| window.board_s);
    let last = course.last().map_or(1.0, |window| window.board_s);
    let reach = course
        .iter()
        .map(|window| (window.residual_s.abs() + window.sigma_s) * 1e6)
        .fold(1.0, f64::max);
    let mut draw = || -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(&mut svg, (800, 320)).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(first..last.max(first + 1.0), -reach * 1.1..reach * 1.1)?;
        chart
            .configure_mesh()
            .x_desc("board time, s")
            .y_desc("window − course, µs")
            .draw()?;
        let band: Vec<(f64, f64)> = course
            .iter()
            .map(|window| (window.board_s, window.course_sigma_s * 1e6))
            .chain(
                course
                    .iter()
                    .rev()
                    .map(|window| (window.board_s, -window.course_sigma_s * 1e6)),
            )
            .collect();
        chart.draw_series([Polygon::new(band, GREEN.mix(0.3))])?;
        chart.draw_series(course.iter().map(|window| {
            let (value, sigma) = (window.residual_s * 1e6, window.sigma_s * 1e6);
            PathElement::new(
                vec![
                    (window.board_s, value - sigma),
                    (window.board_s, value + sigma),
                ],
                BLACK.mix(0.5),
            )
        }))?;
        chart.draw_series(course.iter().map(|window| {
            Circle::new((window.board_s, window.residual_s * 1e6), 2, BLUE.filled())
        }))?;
        root.present()?;
        Ok(())
    };
    if draw().is_err() {
        return String::new();
    }
    svg
}
