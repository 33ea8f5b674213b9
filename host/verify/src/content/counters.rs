//! The board's own counters over a run against what is missing.

use protocol::Status;

use super::STREAMS;
use crate::{Findings, Grade};
use board::Stream;

/// How many messages may be under way between a status and the streams that it
/// counts: the queues of the board hold at most a few.
const UNDER_WAY: u64 = 8;

/// The counters while they are followed.
#[derive(Default)]
pub(super) struct Counters {
    run: Option<Run>,
    /// What the board dropped of each stream in all runs.
    pub(super) dropped: [u64; STREAMS],
}

/// The board's counters at its first and its last status of a run.
struct Run {
    first: Status,
    first_imu: u64,
    last: Status,
    last_imu: u64,
    missing_at_first: [u64; STREAMS],
}

impl Counters {
    /// Takes a status. `imu` is the number of the next sample, `missing` what is missing
    /// of each stream so far.
    pub(super) fn take(&mut self, status: &Status, imu: u64, missing: [u64; STREAMS]) {
        match &mut self.run {
            None => {
                self.run = Some(Run {
                    first: status.clone(),
                    first_imu: imu,
                    last: status.clone(),
                    last_imu: imu,
                    missing_at_first: missing,
                });
            }
            Some(run) => {
                run.last = status.clone();
                run.last_imu = imu;
            }
        }
    }

    /// Something is missing here: counting begins anew.
    pub(super) fn forget(&mut self) {
        self.run = None;
    }

    /// Compares over the run that ends here. In a file with gaps only drops are added up.
    pub(super) fn close_run(
        &mut self,
        missing: [u64; STREAMS],
        has_gaps: bool,
        findings: &mut Findings,
    ) {
        let Some(run) = self.run.take() else {
            return;
        };
        let before = run.missing_at_first;
        let totals = self.dropped.iter_mut().zip(Stream::ALL);
        for ((total, of), (missing, before)) in totals.zip(missing.into_iter().zip(before)) {
            let counted = |status: &Status| of.dropped(&status.dropped).unwrap_or_default();
            let dropped = u64::from(counted(&run.last).wrapping_sub(counted(&run.first)));
            *total += dropped;
            let here = missing - before;
            // What was dropped last shows with the stream's next message only.
            if dropped > here + 1 && !has_gaps && here > 0 {
                findings.add(Grade::Note, "drops_not_seen", None, || {
                    let name = of.name();
                    format!("the board dropped {dropped} {name}, of which {here} show as a gap")
                });
            }
        }
        let made = u64::from(run.last.imu.samples.wrapping_sub(run.first.imu.samples));
        let numbered = run.last_imu.wrapping_sub(run.first_imu) & u64::from(u32::MAX);
        if !has_gaps && made.abs_diff(numbered) > UNDER_WAY {
            findings.add(Grade::Error, "imu_count", Some(run.last.at), || {
                format!(
                    "the board read {made} IMU samples between its first and last status, but their \
                     numbers grew by {numbered}"
                )
            });
        }
    }
}
