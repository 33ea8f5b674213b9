//! The demonstration's result: a table, JSON, and one HTML page with plots.
//!
//! The page has no parts outside of itself: styles and plots (SVG) are in it.

use std::fmt::Write as _;

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use serde::Serialize;

use super::judge::Verdict;

/// The figures of one run, as `--json` writes them. All are of the simulated rig.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Error of the clock offset at the start, µs.
    pub offset_error_us: f64,
    /// Its stated 1-sigma, µs.
    pub offset_sigma_us: f64,
    /// Error of the clock offset at the end, µs.
    pub offset_error_end_us: f64,
    /// Its stated 1-sigma, µs.
    pub offset_sigma_end_us: f64,
    /// Middle of exposure of the depth camera minus that of the phone at the
    /// start, µs.
    pub phase_error_us: f64,
    /// Change of that, µs a minute.
    pub drift_us_per_min: f64,
    /// Pulses in the recording.
    pub pulses: u64,
    /// IMU samples in the recording.
    pub imu_samples: u64,
    /// What is missing.
    pub lost: u64,
    /// Length of the recorded span, seconds of board time.
    pub recorded_s: f64,
    /// Virtual time of the whole run, seconds.
    pub virtual_s: f64,
    /// Wall time of the whole run, seconds.
    pub wall_s: f64,
    /// The seed.
    pub seed: u64,
}

impl Figures {
    /// The figures of a judged run.
    #[must_use]
    pub fn new(verdict: &Verdict, virtual_s: f64, wall_s: f64, seed: u64) -> Self {
        Self {
            offset_error_us: verdict.offset_start.error_us,
            offset_sigma_us: verdict.offset_start.sigma_us,
            offset_error_end_us: verdict.offset_end.error_us,
            offset_sigma_end_us: verdict.offset_end.sigma_us,
            phase_error_us: verdict.phase.start_us,
            drift_us_per_min: verdict.phase.drift_us_per_min,
            pulses: verdict.pulses,
            imu_samples: verdict.imu_samples,
            lost: verdict.lost,
            recorded_s: verdict.recorded_s,
            virtual_s,
            wall_s,
            seed,
        }
    }

    /// Name and value of each line of the table.
    fn lines(&self) -> Vec<(&'static str, String)> {
        let with_sigma = |error, sigma| format!("{error:+.2} µs (stated 1-sigma {sigma:.2} µs)");
        vec![
            (
                "clock offset at the start, error",
                with_sigma(self.offset_error_us, self.offset_sigma_us),
            ),
            (
                "clock offset at the end, error",
                with_sigma(self.offset_error_end_us, self.offset_sigma_end_us),
            ),
            (
                "phase between the middles of exposure at the start",
                format!("{:+.2} µs", self.phase_error_us),
            ),
            ("its drift", format!("{:+.2} µs/min", self.drift_us_per_min)),
            ("trigger pulses recorded", self.pulses.to_string()),
            ("IMU samples recorded", self.imu_samples.to_string()),
            ("lost", self.lost.to_string()),
            (
                "recorded span, board time",
                format!("{:.1} s", self.recorded_s),
            ),
            (
                "whole run, virtual time",
                format!("{:.1} s", self.virtual_s),
            ),
            ("whole run, wall time", format!("{:.1} s", self.wall_s)),
            ("seed", self.seed.to_string()),
        ]
    }

    /// The table for the terminal.
    #[must_use]
    pub fn table(&self) -> String {
        let lines = self.lines();
        let width = lines.iter().map(|(name, _)| name.chars().count()).max();
        let mut out = String::from("Against the truth of the simulated rig:\n");
        for (name, value) in lines {
            let _ = writeln!(out, "  {name:<0$}  {value}", width.unwrap_or(0));
        }
        out
    }
}

/// The page. `twist_svg` is the plot of both gyroscopes, if there is one.
///
/// # Errors
///
/// The plot of the phase cannot be drawn.
pub fn page(figures: &Figures, verdict: &Verdict, twist_svg: Option<&str>) -> Result<String> {
    let mut rows = String::new();
    for (name, value) in figures.lines() {
        let _ = writeln!(
            rows,
            "<tr><td>{}</td><td>{}</td></tr>",
            escape(name),
            escape(&value)
        );
    }
    let phase = phase_plot(verdict)?;
    let twist = twist_svg.unwrap_or("<p>There is no plot of a twist in this run.</p>");
    Ok(format!(
        r#"<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>SmartDepthSync: demonstration, seed {seed}</title>
<style>
body {{ font-family: sans-serif; max-width: 64rem; margin: 2rem auto; padding: 0 1rem; }}
table {{ border-collapse: collapse; }}
td {{ padding: 0.2rem 1rem 0.2rem 0; border-bottom: 1px solid #ccc; }}
td:last-child {{ font-variant-numeric: tabular-nums; }}
svg {{ max-width: 100%; height: auto; }}
</style></head><body>
<h1>A session on the simulated rig</h1>
<p>The firmware ran on a simulated microcontroller; phone, depth camera, IMU and
their clocks are models. Every figure is simulated and judged against the models'
truth.</p>
<table>
{rows}</table>
<h2>Phase of the frames</h2>
<p>Middle of exposure of the depth camera minus that of the phone's middle row, in
true time, for every frame of the recorded span.</p>
{phase}
<h2>The twist</h2>
<p>Both gyroscopes before and after synchronisation, and what is left between
them.</p>
{twist}
</body></html>
"#,
        seed = figures.seed,
    ))
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// Phase over time, thinned to at most some thousand points.
fn phase_plot(verdict: &Verdict) -> Result<String> {
    const MOST: usize = 3000;
    let failed = |e: &dyn std::fmt::Display| anyhow!("cannot draw the phase: {e}");
    let begin = verdict.phases.first().map_or(0.0, |p| p.at_s);
    let step = verdict.phases.len().div_ceil(MOST).max(1);
    let points: Vec<(f64, f64)> = verdict
        .phases
        .iter()
        .step_by(step)
        .map(|p| (p.at_s - begin, p.error_us))
        .collect();
    let end = points.last().map_or(1.0, |p| p.0.max(1.0));
    let (low, high) = points.iter().fold((-1.0f64, 1.0f64), |(low, high), p| {
        (low.min(p.1), high.max(p.1))
    });
    let margin = 0.1 * (high - low);
    let line = |t: f64| verdict.phase.start_us + verdict.phase.drift_us_per_min * t / 60.0;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (900, 360)).into_drawing_area();
        area.fill(&WHITE).map_err(|e| failed(&e))?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..end, (low - margin)..(high + margin))
            .map_err(|e| failed(&e))?;
        chart
            .configure_mesh()
            .x_desc("time since the first frame, s")
            .y_desc("depth minus phone, µs")
            .draw()
            .map_err(|e| failed(&e))?;
        chart
            .draw_series(points.iter().map(|&p| Circle::new(p, 1, BLUE.filled())))
            .map_err(|e| failed(&e))?;
        chart
            .draw_series(LineSeries::new([(0.0, line(0.0)), (end, line(end))], &RED))
            .map_err(|e| failed(&e))?;
        area.present().map_err(|e| failed(&e))?;
    }
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::super::judge::OffsetError;
    use super::*;
    use crate::frame_phase::{PhaseError, summarise};

    fn verdict() -> Verdict {
        let phases: Vec<PhaseError> = (0..9000)
            .map(|n| PhaseError {
                phone_frame: n,
                depth_frame: n as u64,
                at_s: n as f64 / 30.0,
                error_us: 4.0 + n as f64 * 1e-3,
            })
            .collect();
        let offset = OffsetError {
            error_us: 1.5,
            sigma_us: 3.0,
        };
        Verdict {
            offset_start: offset,
            offset_end: offset,
            phase: summarise(&phases).unwrap(),
            phases,
            pulses: 9000,
            imu_samples: 150_000,
            lost: 0,
            recorded_s: 300.0,
        }
    }

    #[test]
    fn the_figures_have_the_documented_keys() {
        let figures = Figures::new(&verdict(), 320.0, 20.0, 7);
        let json = serde_json::to_value(&figures).unwrap();
        for key in [
            "offset_error_us",
            "offset_sigma_us",
            "phase_error_us",
            "drift_us_per_min",
            "pulses",
            "imu_samples",
            "lost",
            "virtual_s",
            "wall_s",
            "seed",
        ] {
            assert!(json[key].is_number(), "{key}");
        }
        let table = figures.table();
        assert!(
            table.contains("+4.00 µs") && table.contains("+1.80 µs/min"),
            "{table}"
        );
    }

    #[test]
    fn the_page_holds_all_it_needs() {
        let verdict = verdict();
        let figures = Figures::new(&verdict, 320.0, 20.0, 7);
        let page = page(&figures, &verdict, Some("<svg id=\"twist\"></svg>")).unwrap();
        assert!(page.matches("<svg").count() == 2 && page.contains("id=\"twist\""));
        assert!(!page.contains("src=") && !page.contains("href="));
        // Thinned: far fewer marks than frames.
        assert!(page.matches("<circle").count() <= 3000);
    }
}
