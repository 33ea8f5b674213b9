//! The numbers that the board gave its messages against what the board itself counts.

use std::collections::BTreeMap;

use board::finding::Severity;
use board::{Stream, follow};
use protocol::{TICK_HZ, Ticks};
use recording::Topic;
use recording::diagnostics::BoardCounters;
use recording::messages::ImuFlags;
use recording::walk::Message;

use super::{Findings, StreamReport};

/// The stream whose numbers the messages of a topic have.
pub(crate) const fn stream_of(topic: Topic) -> Option<Stream> {
    Some(match topic {
        Topic::Status => Stream::Status,
        Topic::Pulse => Stream::Pulses,
        Topic::Capture => Stream::Captures,
        Topic::Imu => Stream::Imu,
        Topic::Output => Stream::Outputs,
        Topic::Gnss => Stream::Pps,
        _ => return None,
    })
}

#[derive(Default)]
struct Numbered {
    expected: Option<u32>,
    report: StreamReport,
}

/// The checks while they run.
#[derive(Default)]
pub(super) struct Numbers {
    streams: [Numbered; Stream::ALL.len()],
    /// Nominal ticks from sample to sample.
    imu_interval: Option<u64>,
    last_imu: Option<(Ticks, u32)>,
    /// Time of a sample that the board gives a reason for a silence before.
    has_reason: Option<Ticks>,
    epoch: Option<u32>,
    /// The first and the last status.
    statuses: Option<(BoardCounters, BoardCounters)>,
    damaged_frames: u64,
}

impl Numbers {
    pub(super) fn new(imu_interval: Option<u64>) -> Self {
        Self {
            imu_interval,
            ..Self::default()
        }
    }

    /// Takes the counters of a status.
    pub(super) fn status(&mut self, status: BoardCounters, at: Ticks, findings: &mut Findings) {
        self.life(status.epoch, at, findings);
        let first = self.statuses.map_or(status, |(first, _)| first);
        self.statuses = Some((first, status));
    }

    /// A frame of the link came damaged, for the reason `why`.
    pub(super) fn damaged(&mut self, why: &str, at: Ticks, findings: &mut Findings) {
        self.damaged_frames += 1;
        findings.check("frame_damaged", Some(at), || {
            format!("a frame of the link was damaged when it came: {why}")
        });
    }

    /// Something is missing in the file here.
    pub(super) fn forget(&mut self) {
        self.last_imu = None;
    }

    /// The board has this epoch. A recording is of one life of the board.
    fn life(&mut self, epoch: u32, at: Ticks, findings: &mut Findings) {
        if self
            .epoch
            .replace(epoch)
            .is_some_and(|known| known != epoch)
        {
            findings.check("board_reset", Some(at), || {
                String::from("the board was reset within the recording")
            });
            for stream in &mut self.streams {
                stream.expected = None;
            }
            self.statuses = None;
            self.forget();
        }
    }

    /// The board's number of a message must follow on the one before.
    pub(super) fn number(&mut self, of: Stream, number: u32, at: Ticks, findings: &mut Findings) {
        let Some(stream) = self.streams.get_mut(of as usize) else {
            return;
        };
        match follow(&mut stream.expected, number) {
            None => findings.bad("number_backwards", Some(at), || {
                format!("the board's numbers of {of} go back to {number}")
            }),
            Some(gap) => stream.report.missing += u64::from(gap),
        }
        stream.report.received += 1;
    }

    /// Takes what the board says of the sample that comes next.
    pub(super) fn flags(&mut self, at: Ticks, flags: &ImuFlags) {
        self.has_reason = Some(at).filter(|_| flags.after_loss || flags.first);
    }

    /// Silence between samples must have a reason.
    pub(super) fn sample(
        &mut self,
        message: &Message<'_>,
        after_gap: bool,
        findings: &mut Findings,
    ) {
        let (at, number) = (message.at(), message.header.sequence);
        let has_reason = self.has_reason.take() == Some(at);
        let last = self.last_imu.replace((at, number));
        let (Some((last, before)), Some(interval)) = (last, self.imu_interval) else {
            return;
        };
        let steps = u64::from(number.wrapping_sub(before));
        let silence = at.0.saturating_sub(last.0);
        if silence <= interval.saturating_mul(steps).saturating_add(interval / 2) || after_gap {
            return;
        }
        let ms = silence as f64 * 1e3 / f64::from(TICK_HZ);
        if has_reason {
            findings.check("imu_gap", Some(at), || {
                format!("{ms:.1} ms without IMU samples, as the board itself says")
            });
        } else {
            findings.bad("imu_gap_unexplained", Some(at), || {
                format!("{ms:.1} ms without IMU samples, and the board does not say why")
            });
        }
    }

    pub(super) const fn damaged_frames(&self) -> u64 {
        self.damaged_frames
    }

    /// What came of it, by the streams' names.
    pub(super) fn finish(
        mut self,
        findings: &mut Findings,
    ) -> BTreeMap<&'static str, StreamReport> {
        self.share_drops();
        for (stream, of) in self.streams.iter().zip(Stream::ALL) {
            let StreamReport {
                missing,
                dropped_by_board: dropped,
                ..
            } = stream.report;
            if missing > 0 {
                let lost = missing - dropped;
                findings.add(Severity::Check, "messages_missing", (None, missing), || {
                    format!(
                        "{missing} messages of {of} are missing by the board's numbers: {dropped} \
                         the board dropped itself, {lost} were lost on the link or with a damaged \
                         part"
                    )
                });
            }
        }
        let reports = Stream::ALL.iter().zip(&self.streams);
        reports
            .filter(|(of, _)| **of != Stream::Filler)
            .map(|(of, stream)| (of.name(), stream.report))
            .collect()
    }

    /// Of what is missing, what the board dropped itself. Pulses per second are counted with
    /// the auxiliary outputs.
    fn share_drops(&mut self) {
        let Some((first, last)) = self.statuses else {
            return;
        };
        let mut left_of_outputs = 0;
        for (stream, of) in self.streams.iter_mut().zip(Stream::ALL) {
            let counted = |status: BoardCounters| of.dropped(&status.dropped).unwrap_or_default();
            let dropped = match of {
                Stream::Pps => left_of_outputs,
                _ => u64::from(counted(last).wrapping_sub(counted(first))),
            };
            let report = &mut stream.report;
            report.dropped_by_board = dropped.min(report.missing);
            if of == Stream::Outputs {
                left_of_outputs = dropped - report.dropped_by_board;
            }
        }
    }
}
