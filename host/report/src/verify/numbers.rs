//! The numbers that the board gave its messages against what the board itself counts.

use std::collections::BTreeMap;

use board::{Stream, follow};
use protocol::Ticks;
use recording::Topic;
use recording::diagnostics::BoardCounters;
use recording::finding::Severity;

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
    epoch: Option<u32>,
    /// The first and the last status.
    statuses: Option<(BoardCounters, BoardCounters)>,
}

impl Numbers {
    /// Takes the counters of a status.
    pub(super) fn status(&mut self, status: BoardCounters, at: Ticks, findings: &mut Findings) {
        self.life(status.epoch, at, findings);
        let first = self.statuses.map_or(status, |(first, _)| first);
        self.statuses = Some((first, status));
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
