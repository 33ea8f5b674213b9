//! The demonstration's result: a table, JSON, and one HTML page with plots.
//!
//! The page is a [`Page`] like the host tool's reports, so a reader finds the same
//! things in the same order.

use board::finding::Severity;
use evaluate::stats::quantile;
use report::chart::{self, Data};
use report::page::Page;
use report::summary::{Facts, Summary, facts_text};
use serde::Serialize;

use super::data_set::DataSet;
use crate::judge::Verdict;

/// The figures of one run, as `--json` writes them. All are of the simulated rig.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// The session that is shown.
    #[serde(flatten)]
    pub session: SessionFigures,
    /// Virtual time of the whole run, seconds.
    pub virtual_s: f64,
    /// Wall time of the whole run, seconds.
    pub wall_s: f64,
    /// The seed.
    pub seed: u64,
    /// The session before it, which calibrated the rig.
    pub before_learning: SessionFigures,
}

/// The figures of a session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SessionFigures {
    /// Middle of exposure of the depth camera minus that of the phone at the
    /// start, µs.
    pub phase_error_us: f64,
    /// Its stated 1-sigma, µs, with that of the constant between the exposures.
    pub phase_sigma_us: f64,
    /// True if the session states that the cameras expose together.
    pub is_sure: bool,
    /// Error of the clock offset at the start, µs.
    pub offset_error_us: f64,
    /// Its stated 1-sigma, µs.
    pub offset_sigma_us: f64,
    /// Change of that, µs a minute.
    pub drift_us_per_min: f64,
    /// The phase of 95 % of the frames is within this of zero, µs.
    pub phase_held_us: f64,
    /// Error of the clock offset at the end, µs.
    pub offset_error_end_us: f64,
    /// Its stated 1-sigma, µs.
    pub offset_sigma_end_us: f64,
    /// Pulses in the recording.
    pub pulses: u64,
    /// IMU samples in the recording.
    pub imu_samples: u64,
    /// Losses.
    pub lost: u64,
    /// Length of the recorded span, seconds of board time.
    pub recorded_s: f64,
}

/// Title of the figures of the session before.
const BEFORE: &str = "The session before it, which calibrated the rig:";

fn with_sigma(error: f64, sigma: f64) -> String {
    format!("{error:+.2} µs (stated 1-sigma {sigma:.2} µs)")
}

impl SessionFigures {
    /// Name and value of each line of the table about the exposures.
    fn phase_lines(&self) -> Facts {
        vec![
            (
                "phase between the middles of exposure at the start",
                with_sigma(self.phase_error_us, self.phase_sigma_us),
            ),
            ("its drift", format!("{:+.2} µs/min", self.drift_us_per_min)),
            (
                "phase held, 95 % of the frames",
                format!("± {:.2} µs", self.phase_held_us),
            ),
            (
                "stated to expose together",
                if self.is_sure { "yes" } else { "no" }.to_owned(),
            ),
        ]
    }

    /// Name and value of each line of the table.
    fn lines(&self) -> Facts {
        let mut lines = self.phase_lines();
        lines.extend([
            (
                "clock offset at the start, error",
                with_sigma(self.offset_error_us, self.offset_sigma_us),
            ),
            (
                "clock offset at the end, error",
                with_sigma(self.offset_error_end_us, self.offset_sigma_end_us),
            ),
            ("lost", self.lost.to_string()),
            (
                "recorded span, board time",
                format!("{:.1} s", self.recorded_s),
            ),
            ("trigger pulses recorded", self.pulses.to_string()),
            ("IMU samples recorded", self.imu_samples.to_string()),
        ]);
        lines
    }

    /// Those of a judged session.
    pub(super) fn from_verdict(verdict: &Verdict) -> Self {
        let sizes: Vec<f64> = verdict.phases.iter().map(|p| p.error_us.abs()).collect();
        Self {
            offset_error_us: verdict.offset_start.error_us,
            offset_sigma_us: verdict.offset_start.sigma_us,
            phase_error_us: verdict.phase.start_us,
            phase_sigma_us: verdict.phase_sigma_us,
            is_sure: verdict.is_sure,
            drift_us_per_min: verdict.phase.drift_us_per_min,
            phase_held_us: quantile(&sizes, 0.95).unwrap_or(f64::NAN),
            offset_error_end_us: verdict.offset_end.error_us,
            offset_sigma_end_us: verdict.offset_end.sigma_us,
            pulses: verdict.pulses,
            imu_samples: verdict.imu_samples,
            lost: verdict.lost,
            recorded_s: verdict.recorded_s,
        }
    }
}

impl Figures {
    /// Name and value of each line of the table.
    fn lines(&self) -> Facts {
        let mut lines = self.session.lines();
        lines.extend([
            (
                "whole run, virtual time",
                format!("{:.1} s", self.virtual_s),
            ),
            ("whole run, wall time", format!("{:.1} s", self.wall_s)),
            ("seed", self.seed.to_string()),
        ]);
        lines
    }

    /// The table for the terminal.
    #[must_use]
    pub fn table(&self) -> String {
        format!(
            "Against the ground truth of the simulated rig:\n{}{BEFORE}\n{}",
            facts_text(&self.lines()),
            facts_text(&self.before_learning.phase_lines())
        )
    }
}

/// The page.
#[must_use]
pub fn page(figures: &Figures, verdict: &Verdict, data: &DataSet) -> String {
    let level = if figures.session.lost == 0 {
        Severity::Good
    } else {
        Severity::Check
    };
    let lost = match figures.session.lost {
        0 => "Nothing was lost.".to_owned(),
        lost => format!("Lost: {lost} pulses, samples or frames."),
    };
    let said = format!(
        "The frames of phone and depth camera were {:.2} µs apart at the start; 95 % of them \
         within {:.2} µs, over {:.1} s. {lost}",
        figures.session.phase_error_us.abs(),
        figures.session.phase_held_us,
        figures.session.recorded_s,
    );
    let title = format!("A session on the simulated rig, seed {}", figures.seed);
    let mut page = Page::new(&Summary {
        title,
        severity: level,
        text: said,
        parts: Vec::new(),
        facts: figures.lines(),
    });
    page.text(
        "The firmware ran on a simulated microcontroller; phone, depth camera, IMU and their \
         clocks are models. Every figure is simulated and judged against the models' ground truth. \
         The delays of the two exposures were drawn and not given: LED and photodiode measured them \
         in the session before.",
    );
    page.section(BEFORE.trim_end_matches(':'));
    page.text(
        "It began with the profile of a first set-up, in which the constant between the exposures is \
         assumed. From it the profile learnt that constant, the period of the phone's frames and the \
         rate of its clock.",
    );
    page.facts(&figures.before_learning.phase_lines());
    page.section("The data set");
    page.text(&format!(
        "The recording was extracted as EuRoC into {}; every time in it was compared with the \
         ground truth.",
        data.folder.display()
    ));
    page.facts(&[
        (
            "phone, middle of exposure",
            data.figures.phone_middle.line(),
        ),
        ("depth, centre of exposure", data.figures.depth.line()),
        ("pairs, all the true ones", data.figures.pairs.to_string()),
    ]);
    page.figure(
        &data.strip,
        "Pairs of the data set, a picture of the phone above the depth picture of the same \
         instant: a ball that swings before a wall. Depth: near is light.",
    );
    page.section("Phase of the frames");
    page.figure(
        &phase_plot(verdict),
        "Middle of exposure of the depth camera minus that of the phone's middle row, in true \
         time, for the frames of the recorded span; with the straight line that is the drift.",
    );
    page.html()
}

/// Phase over time, thinned to at most some thousand points.
fn phase_plot(verdict: &Verdict) -> String {
    const MOST: usize = 3000;
    let begin = verdict.phases.first().map_or(0.0, |p| p.at_s);
    let step = verdict.phases.len().div_ceil(MOST).max(1);
    let points: Vec<(f64, f64)> = verdict
        .phases
        .iter()
        .step_by(step)
        .map(|p| (p.at_s - begin, p.error_us))
        .collect();
    let end = points.last().map_or(1.0, |p| p.0.max(1.0));
    let line = |t: f64| verdict.phase.start_us + verdict.phase.drift_us_per_min * t / 60.0;
    chart::series(
        "time since the first frame, s",
        "depth minus phone, µs",
        -1.0..1.0,
        vec![
            ("frames", Data::Points(points)),
            (
                "drift",
                Data::Line(vec![(0.0, line(0.0)), (end, line(end))]),
            ),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame_phase::{PhaseError, summarise};
    use crate::judge::{OffsetError, TwistVerdict};
    use crate::whole_chain::extraction::{Errors, ExtractionFigures};

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
            twist: TwistVerdict::default(),
            offset_start: offset,
            offset_end: offset,
            phase: summarise(&phases).unwrap(),
            phase_sigma_us: 8.0,
            is_sure: true,
            phases,
            pulses: 9000,
            imu_samples: 150_000,
            lost: 0,
            recorded_s: 300.0,
            others: Vec::new(),
        }
    }

    fn figures(verdict: &Verdict) -> Figures {
        Figures {
            session: SessionFigures::from_verdict(verdict),
            virtual_s: 320.0,
            wall_s: 20.0,
            seed: 7,
            before_learning: SessionFigures::from_verdict(verdict),
        }
    }

    #[test]
    fn the_figures_have_the_documented_keys() {
        let figures = figures(&verdict());
        let json = serde_json::to_value(&figures).unwrap();
        for key in [
            "offset_error_us",
            "offset_sigma_us",
            "phase_error_us",
            "phase_sigma_us",
            "drift_us_per_min",
            "phase_held_us",
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
        let figures = figures(&verdict);
        let data = DataSet {
            folder: "demo/recording-euroc".into(),
            figures: ExtractionFigures {
                recorded_s: 60.0,
                phone_start: Errors::default(),
                phone_middle: Errors::default(),
                phone_sigma_us: 3.0,
                phone_limit_us: 25.0,
                depth: Errors::default(),
                pairs: 1_800,
                dropped: 0,
                free_running: 0,
            },
            strip: String::from("<svg id=\"strip\"></svg>"),
        };
        let page = page(&figures, &verdict, &data);
        assert!(page.contains("recording-euroc") && page.contains("id=\"strip\""));
        assert!(page.contains("which calibrated the rig"));
        assert_eq!(page.matches("<svg").count(), 2);
        // 4 to 13 µs, evenly.
        assert!(page.contains("within 12.55 µs"), "{page}");
        assert!(page.contains("4.00 µs apart") && page.contains("Nothing was lost"));
        // Thinned: far fewer marks than frames.
        assert!(page.matches("<circle").count() <= 3001);
    }
}
