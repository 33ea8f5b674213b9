//! The session file of a recording that went well, of a rig that is not there.

use std::collections::BTreeMap;
use std::path::Path;

use clock::alignment::GridPlan;
use clock::frames::{FramePeriodSource, Frames};
use clock::{ClockRelation, Wander};
use protocol::{Period, TICK_HZ, Ticks};
use recording::contents::TopicContents;
use recording::profile::Profile;
use recording::session_file::{Alignment, SessionFile, SessionOutcome, Span};

/// A clock of a phone whose offset at a board time is known to `sigma_s`, and its rate to
/// 0.1 ppm.
pub(crate) const fn clock(reference: f64, offset: f64, skew: f64, sigma_s: f64) -> ClockRelation {
    ClockRelation {
        reference,
        offset,
        skew,
        covariance: [[sigma_s * sigma_s, 0.0], [0.0, 1e-14]],
        wander: Wander(5e-8),
    }
}

/// Returns the session file of `walk`, recorded for `seconds` from `anchor` on, with pulses on a
/// grid.
pub(crate) fn session(
    profile: Profile,
    clock: ClockRelation,
    (anchor, period): (Ticks, Period),
    frame_period_ns: f64,
    seconds: u64,
) -> SessionFile {
    let mut session = SessionFile::new(String::from("walk"), profile);
    session.alignment = Some(Alignment {
        exposure_us: 4_000.0,
        middle_row_us: 5_503.0,
        center_offset_us: 6_362.5,
        constant_sigma_us: Some(100.0),
        plan: GridPlan {
            frames: Frames {
                period_ns: frame_period_ns,
                source: FramePeriodSource::VideoStart,
                ..Frames::default()
            },
            clock,
            anchor,
            period,
            ..GridPlan::default()
        },
        phase_sigma_us: 3.0,
        drift_sigma_us_per_min: 10.0,
        arrival_pulse: Some(0),
        arrival: Some(anchor),
        ..Alignment::default()
    });
    session.recorded = Some(Span {
        from: anchor,
        to: Ticks(anchor.0 + seconds * u64::from(TICK_HZ)),
    });
    session.outcome = Some(SessionOutcome::Good);
    session
}

/// Closes a recording as a session does, with the messages that were written.
pub(crate) fn close(
    session: &mut SessionFile,
    topics: BTreeMap<String, TopicContents>,
    folder: &Path,
) {
    session.close(SessionOutcome::Good, Some(topics));
    let monitor = system::ReadMonitor::default();
    session.close_files(folder, &monitor).unwrap();
    session.save(folder).unwrap();
}
