//! The board's own counters over a run against what is missing.

use protocol::Status;

use super::STREAMS;
use crate::verify::{Findings, Grade};
use board::Stream;

/// How many messages may be under way between a status and the streams that it
/// counts: the queues of the board hold at most a few.
const UNDER_WAY: u32 = 8;

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
    last: Status,
    /// At the first and the last status that came behind a sample.
    imu: Option<(ImuCount, ImuCount)>,
    missing_at_first: [u64; STREAMS],
}

/// Samples as the board counts and as it numbers them.
#[derive(Clone, Copy)]
struct ImuCount {
    read: u32,
    next: u32,
}

impl Counters {
    /// Takes a status. `imu` is the number of the next sample, if one has come since the
    /// board's reset, `missing` what is missing of each stream so far.
    pub(super) fn take(&mut self, status: &Status, imu: Option<u32>, missing: [u64; STREAMS]) {
        let run = self.run.get_or_insert_with(|| Run {
            first: status.clone(),
            last: status.clone(),
            imu: None,
            missing_at_first: missing,
        });
        run.last = status.clone();
        if let Some(next) = imu {
            let read = status.imu.samples;
            let now = ImuCount { read, next };
            let first = run.imu.map_or(now, |(first, _)| first);
            run.imu = Some((first, now));
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
        let Some((first, last)) = run.imu else {
            return;
        };
        let made = last.read.wrapping_sub(first.read);
        let numbered = last.next.wrapping_sub(first.next);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A board that was reset and counted 1,385 samples before a host came back.
    #[test]
    fn a_status_before_the_first_sample_of_a_run_counts_no_samples() {
        let status = |samples| {
            // All counters 0, the first of each enum.
            let mut status: Status = postcard::from_bytes(&[0; 256]).unwrap();
            status.imu.samples = samples;
            status
        };
        let judged = |last_number| {
            let mut counters = Counters::default();
            counters.take(&status(1_385), None, [0; STREAMS]);
            counters.take(&status(1_885), Some(1_885), [0; STREAMS]);
            counters.take(&status(8_385), Some(last_number), [0; STREAMS]);
            let mut findings = Findings::default();
            counters.close_run([0; STREAMS], false, &mut findings);
            findings.0.len()
        };
        assert_eq!(judged(8_385), 0);
        assert_eq!(judged(8_400), 1);
    }
}
