//! Checks the numbers that the board gave its messages against its own counters.

use std::collections::BTreeMap;

use board::{Stream, follow};
use protocol::Ticks;

use super::StreamCheck;
use super::fault::Fault;
use super::findings::Findings;
use crate::diagnostics::BoardCounters;
use crate::messages::ImuFlags;
use crate::walk::Message;

#[derive(Default)]
struct Numbered {
    expected: Option<u32>,
    counts: StreamCheck,
}

/// The checks in progress.
#[derive(Default)]
pub(super) struct Numbers {
    streams: [Numbered; Stream::ALL.len()],
    /// Nominal ticks from sample to sample.
    imu_interval: Option<u64>,
    last_imu: Option<(Ticks, u32)>,
    /// Time of the next sample, if the board explains a silence before it.
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

    /// Checks the counters of a status message.
    pub(super) fn status(&mut self, status: BoardCounters, at: Ticks, findings: &mut Findings) {
        self.check_epoch(status.epoch, at, findings);
        let first = self.statuses.map_or(status, |(first, _)| first);
        self.statuses = Some((first, status));
    }

    /// Counts a frame of the link that arrived damaged, for the reason `why`.
    pub(super) fn damaged(&mut self, why: &str, at: Ticks, findings: &mut Findings) {
        self.damaged_frames += 1;
        findings.add(&Fault::FrameDamaged(why.to_owned()), Some(at));
    }

    /// Forgets the last sample: messages may be missing in the file here.
    pub(super) fn forget(&mut self) {
        self.last_imu = None;
    }

    /// Checks that the board was not reset: a recording covers one epoch of the board.
    fn check_epoch(&mut self, epoch: u32, at: Ticks, findings: &mut Findings) {
        if self
            .epoch
            .replace(epoch)
            .is_some_and(|known| known != epoch)
        {
            findings.add(&Fault::BoardReset, Some(at));
            for stream in &mut self.streams {
                stream.expected = None;
            }
            self.statuses = None;
            self.forget();
        }
    }

    /// Checks that the board's number of a message follows the previous one.
    pub(super) fn number(
        &mut self,
        stream: Stream,
        number: u32,
        at: Ticks,
        findings: &mut Findings,
    ) {
        let Some(numbered) = self.streams.get_mut(stream as usize) else {
            return;
        };
        match follow(&mut numbered.expected, number) {
            None => findings.add(&Fault::NumberBackwards { stream, number }, Some(at)),
            Some(gap) => numbered.counts.missing += u64::from(gap),
        }
        numbered.counts.received += 1;
    }

    /// Remembers the flags of the sample that comes next.
    pub(super) fn flags(&mut self, at: Ticks, flags: &ImuFlags) {
        self.has_reason = Some(at).filter(|_| flags.after_loss || flags.first);
    }

    /// Checks that the board explains a silence before a sample.
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
        // The sample that had the reason may be among those that are missing, which are counted.
        let fault = if has_reason || steps > 1 {
            Fault::ImuGap(silence)
        } else {
            Fault::ImuGapUnexplained(silence)
        };
        findings.add(&fault, Some(at));
    }

    pub(super) const fn damaged_frames(&self) -> u64 {
        self.damaged_frames
    }

    /// Returns the counts by the streams' names.
    pub(super) fn finish(mut self, findings: &mut Findings) -> BTreeMap<&'static str, StreamCheck> {
        self.share_drops();
        for (stream, name) in self.streams.iter().zip(Stream::ALL) {
            let StreamCheck {
                missing,
                dropped_by_board: dropped,
                ..
            } = stream.counts;
            if missing > 0 {
                let fault = Fault::MessagesMissing {
                    stream: name,
                    missing,
                    dropped,
                };
                findings.add_many(&fault, None, missing);
            }
        }
        let streams = Stream::ALL.iter().zip(&self.streams);
        streams
            .filter(|(stream, _)| **stream != Stream::Filler)
            .map(|(stream, numbered)| (stream.name(), numbered.counts))
            .collect()
    }

    /// Attributes missing messages to the board as far as its counters of drops say so. The
    /// board counts pulses per second with those of the auxiliary outputs.
    fn share_drops(&mut self) {
        let Some((first, last)) = self.statuses else {
            return;
        };
        let mut left_of_outputs = 0;
        for (numbered, stream) in self.streams.iter_mut().zip(Stream::ALL) {
            let counted =
                |status: BoardCounters| stream.dropped(&status.dropped).unwrap_or_default();
            let dropped = match stream {
                Stream::Pps => left_of_outputs,
                _ => u64::from(counted(last).wrapping_sub(counted(first))),
            };
            let counts = &mut numbered.counts;
            counts.dropped_by_board = dropped.min(counts.missing);
            if stream == Stream::Outputs {
                left_of_outputs = dropped - counts.dropped_by_board;
            }
        }
    }
}
