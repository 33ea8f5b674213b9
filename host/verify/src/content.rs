//! The messages of a recording: whether they agree with each other.
//!
//! Everything is followed message by message; nothing but a few states is kept,
//! so hours of recording need no memory.

use std::collections::{BTreeMap, VecDeque};

use mcap::records::MessageHeader;
use protocol::{Decoder, DeviceToHost, Period, Status, Ticks};

use super::file::Sink;
use super::{FileReport, Findings, Grade, GridReport, StreamReport, TopicReport};
use board::session::Stream;
use recording::messages::{BoardRun, Header, LinkFrame, Pulse};
use recording::reader::ticks_of_nanos;
use recording::session_file::{self, Alignment, SessionFile};
use recording::{Item, RecordingError, Topic};

/// How many streams the board numbers.
const STREAMS: usize = Stream::ALL.len();

/// The topic in which each message of a stream has one of its own.
const fn topic_of(stream: Stream) -> Option<Topic> {
    match stream {
        Stream::Status => Some(Topic::Status),
        Stream::Pulses => Some(Topic::Pulse),
        Stream::Captures => Some(Topic::Capture),
        Stream::Imu => Some(Topic::Imu),
        Stream::Outputs => Some(Topic::Output),
        Stream::Pps => Some(Topic::Gnss),
        // It says nothing, and is in the frames of the link alone.
        Stream::Filler => None,
    }
}

/// Whether messages of a topic come in the order of their times. Pulses of several
/// outputs may fall on one tick.
const fn in_order(topic: Topic) -> bool {
    matches!(
        topic,
        Topic::Imu
            | Topic::Temperature
            | Topic::Pulse
            | Topic::Capture
            | Topic::Status
            | Topic::Gnss
    )
}

/// How many messages may be under way between a status and the streams that it
/// counts: the queues of the board hold at most a few.
const UNDER_WAY: u64 = 8;

/// The most topics that are counted one by one.
const MAX_TOPICS: usize = 1_000;

/// What the messages say.
pub struct Outcome {
    /// First and last board time, ns.
    pub span: Option<(u64, u64)>,
    /// Runs of the board.
    pub runs: u64,
    /// Frames that are no message.
    pub damaged_frames: u64,
    /// See [`super::Report`].
    pub streams: BTreeMap<&'static str, StreamReport>,
    /// See [`super::Report`].
    pub topics: BTreeMap<String, TopicReport>,
    /// See [`super::Report`].
    pub grid: Option<GridReport>,
}

/// One numbered stream in the frames of the link, and its topic.
#[derive(Default)]
struct Numbers {
    expected: Option<u32>,
    report: StreamReport,
    /// Times of frames whose message has not come yet.
    pending: VecDeque<Ticks>,
    /// A frame of it has been seen, so that from here on each message has one.
    seen: bool,
}

/// The board's counters at its first and its last status of a run.
#[derive(Clone)]
struct Counters {
    first: Status,
    first_imu: u64,
    last: Status,
    last_imu: u64,
    missing_at_first: [u64; STREAMS],
}

/// The last pulse.
#[derive(Clone, Copy)]
struct LastPulse {
    train: u32,
    number: u64,
    at: Ticks,
    aligned: bool,
}

/// Time from an edge to its being counted, at most: far longer than an interrupt waits.
const COUNTED_WITHIN: u64 = protocol::TICK_HZ as u64 / 1000;

impl LastPulse {
    /// Whether a status of `at` that counts `made` pulses should have counted this one.
    /// Pulses are sent before a status that waits, so one that came first may be younger
    /// than it.
    const fn is_uncounted(&self, made: u64, at: Ticks) -> bool {
        self.number >= made && self.at.0.saturating_add(COUNTED_WITHIN) <= at.0
    }
}

/// A topic's running number and time.
#[derive(Default)]
struct TopicState {
    report: TopicReport,
    expected: Option<u32>,
    last: Option<u64>,
}

/// The checks while they run.
pub struct Content {
    alignment: Option<Alignment>,
    recorded_to: Option<Ticks>,
    /// The same as the session file has it.
    session_to: Option<Ticks>,
    /// Later runs as the session file has them.
    runs_in_file: Vec<session_file::BoardRun>,
    /// Recorded ticks less the board's in this run.
    shift: u64,
    imu_interval: Option<u64>,
    topics: BTreeMap<String, TopicState>,
    streams: [Numbers; STREAMS],
    epoch: Option<u32>,
    runs: u64,
    damaged_frames: u64,
    in_step: bool,
    counters: Option<Counters>,
    dropped: [u64; STREAMS],
    pulse: Option<LastPulse>,
    steps: Option<(u64, u64)>,
    last_imu: Option<(Ticks, u32)>,
    grid: GridReport,
    markers: u64,
    span: Option<(u64, u64)>,
    /// Something is missing in the file here.
    after_gap: bool,
    gaps: u64,
}

impl Content {
    /// Before the first message.
    #[must_use]
    pub fn new(session: Option<&SessionFile>) -> Self {
        let finished = session.is_some_and(|session| session.outcome.is_some());
        let recorded_to = session
            .filter(|_| finished)
            .and_then(|session| session.recorded)
            .map(|span| span.to);
        Self {
            alignment: session.and_then(|session| session.alignment),
            recorded_to,
            session_to: recorded_to,
            runs_in_file: session.map_or_else(Vec::new, |session| session.runs.clone()),
            shift: 0,
            imu_interval: session
                .and_then(|session| session.imu.as_ref())
                .map(|imu| u64::from(imu.setup.interval)),
            topics: BTreeMap::new(),
            streams: Default::default(),
            epoch: None,
            runs: 1,
            damaged_frames: 0,
            in_step: false,
            counters: None,
            dropped: [0; STREAMS],
            pulse: None,
            steps: None,
            last_imu: None,
            grid: GridReport::default(),
            markers: 0,
            span: None,
            after_gap: false,
            gaps: 0,
        }
    }

    /// What came of it.
    #[must_use]
    pub fn finish(
        mut self,
        file: &FileReport,
        session: Option<&SessionFile>,
        findings: &mut Findings,
    ) -> Outcome {
        self.close_run(findings);
        let whole = file.closed && self.gaps == 0;
        for (numbers, stream) in self.streams.iter().zip(Stream::ALL) {
            let left = numbers.pending.len() as u64;
            if whole && left > 0 {
                findings.add_many(Grade::Error, "frame_without_message", None, left, || {
                    let name = stream.name();
                    format!("the last frames of {name} have no message of their own")
                });
            }
        }
        self.share_drops();
        for (stream, of) in self.streams.iter_mut().zip(Stream::ALL) {
            let name = of.name();
            let lost = stream.report.missing - stream.report.dropped_by_board;
            if stream.report.missing > 0 {
                let missing = stream.report.missing;
                findings.add_many(Grade::Warning, "messages_missing", None, missing, || {
                    format!(
                        "{missing} messages of {name} are missing by the board's numbers: {} the \
                         board dropped itself, {lost} were lost on the link or with a damaged part",
                        stream.report.dropped_by_board
                    )
                });
            }
        }
        if let Some(session) = session.filter(|_| whole) {
            if session.markers.len() as u64 != self.markers {
                findings.add(Grade::Error, "markers_differ", None, || {
                    format!(
                        "the session file has {} marks, the recording {}",
                        session.markers.len(),
                        self.markers
                    )
                });
            }
            let missing: u64 = self.streams.iter().map(|s| s.report.missing).sum();
            if session.counts.lost() > missing {
                findings.add(Grade::Error, "losses_differ", None, || {
                    format!(
                        "the session counted {} lost messages, but by the board's numbers {missing} \
                         are missing",
                        session.counts.lost()
                    )
                });
            }
        }
        Outcome {
            span: self.span,
            runs: self.runs,
            damaged_frames: self.damaged_frames,
            streams: Stream::ALL
                .iter()
                .zip(&self.streams)
                .filter(|(of, _)| topic_of(**of).is_some())
                .map(|(of, stream)| (of.name(), stream.report))
                .collect(),
            topics: self
                .topics
                .into_iter()
                .map(|(name, state)| (name, state.report))
                .collect(),
            grid: self.alignment.map(|_| self.grid),
        }
    }

    /// The number of a message in its topic, and its time.
    fn place(
        &mut self,
        name: &str,
        topic: Option<Topic>,
        header: &MessageHeader,
        findings: &mut Findings,
    ) {
        let at = header.log_time;
        if self.topics.len() >= MAX_TOPICS && !self.topics.contains_key(name) {
            return;
        }
        let state = self.topics.entry(name.to_owned()).or_default();
        state.report.messages += 1;
        if let Some(expected) = state.expected {
            let missing = header.sequence.wrapping_sub(expected);
            if missing > u32::MAX / 2 {
                findings.add(Grade::Error, "order", Some(ticks_of_nanos(at)), || {
                    format!(
                        "message {} of {name} comes twice or too late",
                        header.sequence
                    )
                });
            } else if missing > 0 {
                state.report.missing += u64::from(missing);
                findings.add_many(
                    Grade::Error,
                    "messages_cut_out",
                    Some(ticks_of_nanos(at)),
                    u64::from(missing),
                    || format!("{missing} messages of {name} are gone from the file"),
                );
            }
        }
        state.expected = Some(header.sequence.wrapping_add(1));
        if topic.is_some_and(in_order) {
            if let Some(last) = state.last
                && at <= last
            {
                findings.add(
                    Grade::Error,
                    "time_not_monotonic",
                    Some(ticks_of_nanos(at)),
                    || {
                        format!(
                            "a message of {name} is {:.6} s older than the one before it",
                            (last - at) as f64 * 1e-9
                        )
                    },
                );
            }
            state.last = Some(at);
            self.span = Some(
                self.span
                    .map_or((at, at), |(from, to)| (from.min(at), to.max(at))),
            );
        }
    }

    /// A frame of the link: decoded again.
    fn frame(&mut self, frame: &LinkFrame, at: Ticks, findings: &mut Findings) {
        let mut decoder = Decoder::<DeviceToHost>::new();
        let mut bytes = frame.data.clone();
        bytes.push(0);
        let mut rest = bytes.as_slice();
        match decoder.next(&mut rest) {
            Some(Ok(message)) => {
                self.in_step = true;
                self.link_message(message, findings);
            }
            Some(Err(error)) if self.in_step => {
                self.damaged_frames += 1;
                findings.add(Grade::Warning, "frame_damaged", Some(at), || {
                    format!("a frame of the link was damaged when it came: {error}")
                });
            }
            // The stream is joined in the middle of a frame.
            _ => {}
        }
    }

    fn link_message(&mut self, message: DeviceToHost, findings: &mut Findings) {
        match &message {
            DeviceToHost::Hello(hello) => self.run(hello.epoch, findings),
            DeviceToHost::Status(status) => self.run(status.epoch, findings),
            DeviceToHost::Imu(sample) => {
                self.imu_frame(sample.at, sample.seq, sample.flags, findings);
            }
            _ => {}
        }
        let Some((of, seq, at)) = Stream::of(&message) else {
            return;
        };
        let at = Ticks(at.0.saturating_add(self.shift));
        if let Some(stream) = self.streams.get_mut(of as usize) {
            let gap = stream
                .expected
                .map_or(0, |expected| seq.wrapping_sub(expected));
            if gap > u32::MAX / 2 {
                findings.add(Grade::Error, "number_backwards", Some(at), || {
                    format!("the board's numbers go back to {seq}")
                });
            } else {
                stream.report.missing += u64::from(gap);
            }
            stream.expected = Some(seq.wrapping_add(1));
            stream.report.received += 1;
            if topic_of(of).is_some() {
                stream.seen = true;
                stream.pending.push_back(at);
            }
            if stream.pending.len() > 64 {
                stream.pending.pop_front();
                findings.add(Grade::Error, "frame_without_message", Some(at), || {
                    String::from("a frame of the link has no message of its own")
                });
            }
        }
        if let DeviceToHost::Status(status) = message {
            self.status(status, findings);
        }
    }

    /// Silence between samples must have a reason.
    fn imu_frame(
        &mut self,
        at: Ticks,
        seq: u32,
        flags: protocol::ImuFlags,
        findings: &mut Findings,
    ) {
        let told =
            flags.has(protocol::ImuFlags::AFTER_LOSS) || flags.has(protocol::ImuFlags::FIRST);
        if let (Some((last, number)), Some(interval)) = (self.last_imu, self.imu_interval) {
            let steps = u64::from(seq.wrapping_sub(number));
            let distance = at.0.saturating_sub(last.0);
            if distance > interval.saturating_mul(steps) + interval / 2 && !self.after_gap {
                let grade = if told { Grade::Warning } else { Grade::Error };
                let kind = if told {
                    "imu_gap"
                } else {
                    "imu_gap_unexplained"
                };
                findings.add(grade, kind, Some(at), || {
                    format!(
                        "{:.1} ms without IMU samples{}",
                        distance as f64 / 48_000.0,
                        if told {
                            ", as the board itself says"
                        } else {
                            ", and the board does not say why"
                        }
                    )
                });
            }
        }
        self.last_imu = Some((at, seq));
    }

    fn status(&mut self, status: Status, findings: &mut Findings) {
        let imu = self
            .streams
            .get(Stream::Imu as usize)
            .and_then(|stream| stream.expected)
            .map_or(0, u64::from);
        let missing = self.missing();
        match &mut self.counters {
            None => {
                self.counters = Some(Counters {
                    first: status.clone(),
                    first_imu: imu,
                    last: status.clone(),
                    last_imu: imu,
                    missing_at_first: missing,
                });
            }
            Some(counters) => {
                counters.last = status.clone();
                counters.last_imu = imu;
            }
        }
        // The pulses that were made against those that came.
        if let Some(pulse) = self.pulse
            && pulse.train == status.trigger.train
            && !self.after_gap
        {
            let made = status.trigger.pulses;
            if pulse.is_uncounted(made, status.at) {
                findings.add(Grade::Error, "pulse_count", Some(status.at), || {
                    format!("pulse {} came, but the board counts {made}", pulse.number)
                });
            }
        }
    }

    fn missing(&self) -> [u64; STREAMS] {
        self.streams.each_ref().map(|stream| stream.report.missing)
    }

    /// Of what is missing, what the board dropped itself. Pulses per second are
    /// counted with the further outputs.
    fn share_drops(&mut self) {
        let mut left_of_outputs = 0;
        for ((numbers, of), dropped) in self.streams.iter_mut().zip(Stream::ALL).zip(self.dropped) {
            let dropped = match of {
                Stream::Pps => left_of_outputs,
                _ => dropped,
            };
            let report = &mut numbers.report;
            report.dropped_by_board = dropped.min(report.missing);
            if of == Stream::Outputs {
                left_of_outputs = dropped - report.dropped_by_board;
            }
        }
    }

    /// A later run of the board, which goes on in recorded time.
    fn recorded_run(&mut self, mark: &BoardRun, findings: &mut Findings) {
        self.run(mark.epoch, findings);
        self.shift = mark.shift_ticks;
        // Its grid begins anew, with the session file's word for it.
        self.recorded_to = self.session_to;
        let anchor = self
            .runs_in_file
            .iter()
            .find(|run| run.shift == mark.shift_ticks)
            .and_then(|run| run.anchor);
        if let (Some(alignment), Some(anchor)) = (&mut self.alignment, anchor) {
            alignment.anchor = anchor;
            alignment.arrival = Some(anchor);
        } else {
            self.recorded_to = Some(Ticks(0));
        }
    }

    /// The board may have been reset since the last message.
    fn run(&mut self, epoch: u32, findings: &mut Findings) {
        if self.epoch.is_some_and(|known| known != epoch) {
            self.close_run(findings);
            self.runs += 1;
            findings.add(Grade::Warning, "board_reset", None, || {
                String::from("the board was reset within the recording")
            });
            for stream in &mut self.streams {
                stream.expected = None;
                stream.pending.clear();
            }
            for state in self.topics.values_mut() {
                state.last = None;
            }
            self.counters = None;
            self.pulse = None;
            self.steps = None;
            self.last_imu = None;
            // The alignment in the session file is of one run only.
            self.shift = 0;
            self.recorded_to = Some(Ticks(0));
        }
        self.epoch = Some(epoch);
    }

    /// The board's own counters over a run against what is missing.
    fn close_run(&mut self, findings: &mut Findings) {
        let Some(counters) = self.counters.take() else {
            return;
        };
        let grown =
            |f: fn(&Status) -> u32| u64::from(f(&counters.last).wrapping_sub(f(&counters.first)));
        let dropped = Stream::ALL.map(|stream| {
            let of = |status: &Status| stream.dropped(&status.dropped).unwrap_or_default();
            u64::from(of(&counters.last).wrapping_sub(of(&counters.first)))
        });
        let missing = self.missing();
        for index in 0..dropped.len() {
            let (Some(&dropped), Some(total), Some(&missing), Some(&before), Some(of)) = (
                dropped.get(index),
                self.dropped.get_mut(index),
                missing.get(index),
                counters.missing_at_first.get(index),
                Stream::ALL.get(index),
            ) else {
                continue;
            };
            *total += dropped;
            let here = missing - before;
            // What was dropped last shows with the stream's next message only.
            if dropped > here + 1 && self.gaps == 0 && here > 0 {
                findings.add(Grade::Note, "drops_not_seen", None, || {
                    let name = of.name();
                    format!("the board dropped {dropped} {name}, of which {here} show as a gap")
                });
            }
        }
        let made = grown(|status| status.imu.samples);
        let numbered = counters.last_imu.wrapping_sub(counters.first_imu) & u64::from(u32::MAX);
        if self.gaps == 0 && made.abs_diff(numbered) > UNDER_WAY {
            findings.add(Grade::Error, "imu_count", Some(counters.last.at), || {
                format!(
                    "the board read {made} IMU samples between its first and last status, but their \
                     numbers grew by {numbered}"
                )
            });
        }
    }

    /// A message must have a frame of its own, in order.
    fn came_of(&mut self, of: Stream, at: Ticks, findings: &mut Findings) {
        let after_gap = self.after_gap;
        let Some(stream) = self.streams.get_mut(of as usize) else {
            return;
        };
        match stream.pending.pop_front() {
            Some(expected) if expected == at => {}
            Some(expected) => {
                stream.pending.clear();
                if !after_gap {
                    findings.add(Grade::Error, "message_differs", Some(at), || {
                        format!(
                            "a message is at tick {} where its frame on the link says {}",
                            at.0, expected.0
                        )
                    });
                }
            }
            None if stream.seen && !after_gap => {
                findings.add(Grade::Error, "message_without_frame", Some(at), || {
                    String::from("a message has no frame of the link that it came in")
                });
            }
            None => {}
        }
    }

    fn pulse(&mut self, pulse: &Pulse, findings: &mut Findings) {
        let at = Ticks(pulse.ticks);
        let now = LastPulse {
            train: pulse.train,
            number: pulse.number,
            at,
            aligned: pulse.aligned,
        };
        if let Some(last) = self.pulse.replace(now)
            && last.train == pulse.train
        {
            let step = pulse.number.wrapping_sub(last.number);
            if step == 0 || step > u64::MAX / 2 {
                findings.add(Grade::Error, "pulse_twice", Some(at), || {
                    format!("pulse {} comes after {}", pulse.number, last.number)
                });
            } else if step > 1 {
                findings.add_many(Grade::Warning, "pulses_missing", Some(at), step - 1, || {
                    format!(
                        "{} pulses are missing before pulse {}",
                        step - 1,
                        pulse.number
                    )
                });
            }
            self.step(last, now, step, findings);
        } else {
            self.steps = None;
        }
        self.hold_against_grid(pulse, at, findings);
    }

    /// Without a known grid: steps of a train on its grid differ by a tick at most.
    fn step(&mut self, last: LastPulse, now: LastPulse, step: u64, findings: &mut Findings) {
        if self.alignment.is_some() || step != 1 || !last.aligned || !now.aligned {
            self.steps = None;
            return;
        }
        let length = now.at.0.saturating_sub(last.at.0);
        let (low, high) = self.steps.map_or((length, length), |(low, high)| {
            (low.min(length), high.max(length))
        });
        if high - low > 1 {
            findings.add(Grade::Error, "grid", Some(now.at), || {
                format!(
                    "pulse {} comes {length} ticks after the one before, others {low} to {high}",
                    now.number
                )
            });
            self.steps = None;
        } else {
            self.steps = Some((low, high));
        }
    }

    fn hold_against_grid(&mut self, pulse: &Pulse, at: Ticks, findings: &mut Findings) {
        let Some(alignment) = self.alignment else {
            return;
        };
        let arrived = alignment.arrival.unwrap_or(alignment.anchor);
        if at < arrived || self.recorded_to.is_some_and(|to| at > to) {
            return;
        }
        let off = Period(alignment.period_q32)
            .phase_error(alignment.anchor, at)
            .0
            .unsigned_abs();
        self.grid.checked += 1;
        if off != 0 {
            self.grid.off += 1;
            self.grid.worst_ticks = self.grid.worst_ticks.max(off);
            findings.add(Grade::Error, "off_grid", Some(at), || {
                format!(
                    "pulse {} is {off} ticks off the grid of the alignment",
                    pulse.number
                )
            });
        }
    }

    /// What a message says, against the frames of the link and the ones before it.
    fn item(&mut self, item: &Item, at: u64, findings: &mut Findings) {
        let ticks = ticks_of_nanos(at);
        match item {
            Item::Link(frame) => self.frame(frame, ticks, findings),
            Item::Imu(imu) => {
                self.from_link(Stream::Imu, &imu.header, at, findings);
                let values: [f64; 3] = imu.angular_velocity.into();
                if values.iter().any(|value| !value.is_finite()) {
                    findings.add(Grade::Error, "not_a_number", Some(ticks), || {
                        String::from("an IMU sample is not a number")
                    });
                }
            }
            Item::Pulse(pulse) => {
                stamped(at, &pulse.header, findings);
                if ticks != Ticks(pulse.ticks) {
                    findings.add(Grade::Error, "stamp_differs", Some(ticks), || {
                        format!(
                            "a pulse of tick {} is logged at tick {}",
                            pulse.ticks, ticks.0
                        )
                    });
                }
                self.came_of(Stream::Pulses, ticks, findings);
                self.pulse(pulse, findings);
            }
            Item::Capture(capture) => {
                self.from_link(Stream::Captures, &capture.header, at, findings);
                if capture.after_loss {
                    findings.add(Grade::Warning, "captures_lost", Some(ticks), || {
                        String::from("an edge on the strobe input was lost, as the board says")
                    });
                }
            }
            Item::Status(status) => self.from_link(Stream::Status, &status.header, at, findings),
            Item::Output(pulse) => self.from_link(Stream::Outputs, &pulse.header, at, findings),
            Item::Gnss(pulse) => self.from_link(Stream::Pps, &pulse.header, at, findings),
            Item::Run(mark) => self.recorded_run(mark, findings),
            Item::Marker(_) => self.markers += 1,
            Item::Temperature(_)
            | Item::Clock(_)
            | Item::PhoneClock(_)
            | Item::Log(_)
            | Item::Trigger(_)
            | Item::Strobe(_)
            | Item::HostTime(_) => {}
        }
    }

    /// A message that came in a frame of its own.
    fn from_link(&mut self, of: Stream, header: &Header, at: u64, findings: &mut Findings) {
        stamped(at, header, findings);
        self.came_of(of, ticks_of_nanos(at), findings);
    }
}

fn stamped(at: u64, header: &Header, findings: &mut Findings) {
    let stamp = header.stamp.nanos();
    if i64::try_from(at) != Ok(stamp) {
        findings.add(
            Grade::Error,
            "stamp_differs",
            Some(ticks_of_nanos(at)),
            || format!("a message of {at} ns has a header of {stamp} ns"),
        );
    }
}

impl Sink for Content {
    fn message(
        &mut self,
        name: &str,
        header: &MessageHeader,
        data: &[u8],
        findings: &mut Findings,
    ) -> Result<(), RecordingError> {
        let topic = Topic::of(name);
        match topic.map(|topic| topic.read(data)) {
            Some(Ok(item)) => self.item(&item, header.log_time, findings),
            Some(Err(error)) => {
                let at = ticks_of_nanos(header.log_time);
                findings.add(Grade::Error, "message_damaged", Some(at), || {
                    format!("a message of {name} cannot be read: {error}")
                });
            }
            None => {}
        }
        self.place(name, topic, header, findings);
        self.after_gap &= matches!(topic, Some(Topic::Link | Topic::Log));
        Ok(())
    }

    fn gap(&mut self) {
        self.after_gap = true;
        self.gaps += 1;
        for stream in &mut self.streams {
            stream.pending.clear();
            stream.seen = false;
        }
        self.pulse = None;
        self.steps = None;
        self.last_imu = None;
        self.counters = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_younger_than_the_status_behind_it_need_not_be_counted() {
        let pulse = LastPulse {
            train: 1,
            number: 2_203,
            at: Ticks(480_000),
            aligned: true,
        };
        let later = Ticks(480_000 + COUNTED_WITHIN);
        assert!(pulse.is_uncounted(2_203, later));
        assert!(!pulse.is_uncounted(2_204, later));
        assert!(!pulse.is_uncounted(2_203, Ticks(479_999)));
    }
}
