//! The messages of a recording: whether they agree with each other.
//!
//! Everything is followed message by message; nothing but a few states is kept,
//! so hours of recording need no memory.

mod counters;
mod pulses;
mod topics;

use std::collections::VecDeque;
use std::path::Path;

use protocol::{DeviceToHost, PROTOCOL_VERSION, Status, Ticks, decode_frame, hello_version};

use counters::Counters;
use pulses::Pulses;
use topics::Topics;

use super::{FORM, Findings, Grade, Report, StreamReport};
use board::Stream;
use recording::messages::{BoardRun, Header, LinkFrame};
use recording::reader::ticks_of_nanos;
use recording::session_file::{self, SessionFile};
use recording::walk::{Event, FileReport, Message};
use recording::{Item, Topic};

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

/// The checks while they run.
pub(crate) struct Content {
    /// Later runs as the session file has them.
    runs_in_file: Vec<session_file::BoardRun>,
    /// The protocol that the board spoke.
    protocol: u16,
    /// Recorded ticks less the board's in this run.
    shift: u64,
    imu_interval: Option<u64>,
    topics: Topics,
    streams: [Numbers; STREAMS],
    epoch: Option<u32>,
    runs: u64,
    damaged_frames: u64,
    /// There are frames of a version that is not read.
    unread: bool,
    in_step: bool,
    counters: Counters,
    pulses: Pulses,
    last_imu: Option<(Ticks, u32)>,
    markers: u64,
    /// Something is missing in the file here.
    after_gap: bool,
    gaps: u64,
}

impl Content {
    /// Before the first message.
    pub(crate) fn new(session: Option<&SessionFile>) -> Self {
        Self {
            runs_in_file: session.map_or_else(Vec::new, |session| session.runs.clone()),
            protocol: session
                .and_then(|session| session.board.as_ref())
                .map_or(PROTOCOL_VERSION, |board| board.protocol),
            shift: 0,
            imu_interval: session
                .and_then(|session| session.imu.as_ref())
                .map(|imu| u64::from(imu.setup.interval)),
            topics: Topics::default(),
            streams: Default::default(),
            epoch: None,
            runs: 1,
            damaged_frames: 0,
            unread: false,
            in_step: false,
            counters: Counters::default(),
            pulses: Pulses::new(session),
            last_imu: None,
            markers: 0,
            after_gap: false,
            gaps: 0,
        }
    }

    /// What came of it, of `recording` whose bytes are `file`.
    pub(crate) fn finish(
        mut self,
        recording: &Path,
        file: FileReport,
        session: Option<&SessionFile>,
        mut findings: Findings,
    ) -> Report {
        self.counters
            .close_run(self.missing(), self.gaps > 0, &mut findings);
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
            self.compare_with(session, &mut findings);
        }
        let seconds = |nanos| ticks_of_nanos(nanos).as_secs_f64();
        Report {
            form: FORM,
            recording: recording.display().to_string(),
            verdict: findings.verdict(),
            file,
            board_time_s: self.topics.span().map(|span| span.map(seconds)),
            board_runs: self.runs,
            damaged_frames: self.damaged_frames,
            grid: self.pulses.report(),
            streams: Stream::ALL
                .iter()
                .zip(&self.streams)
                .filter(|(of, _)| topic_of(**of).is_some())
                .map(|(of, stream)| (of.name(), stream.report))
                .collect(),
            topics: self.topics.reports(),
            findings: findings.0,
        }
    }

    /// What the session counted against what is in the file.
    fn compare_with(&self, session: &SessionFile, findings: &mut Findings) {
        if session.markers.len() as u64 != self.markers {
            findings.add(Grade::Error, "markers_differ", None, || {
                format!(
                    "the session file has {} marks, the recording {}",
                    session.markers.len(),
                    self.markers
                )
            });
        }
        let missing: u64 = self.missing().iter().sum();
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

    /// A frame of the link: decoded again.
    fn frame(&mut self, frame: &LinkFrame, at: Ticks, findings: &mut Findings) {
        self.protocol = hello_version(&frame.data).unwrap_or(self.protocol);
        let version = self.protocol;
        if version != PROTOCOL_VERSION {
            if !std::mem::replace(&mut self.unread, true) {
                findings.add(Grade::Warning, "frames_not_read", Some(at), || {
                    format!(
                        "the board spoke protocol version {version}; this program reads the \
                         frames of {PROTOCOL_VERSION}, so its numbers are not checked"
                    )
                });
            }
            return;
        }
        match decode_frame(&frame.data) {
            Ok(message) => {
                self.in_step = true;
                self.link_message(message, findings);
            }
            Err(error) if self.in_step => {
                self.damaged_frames += 1;
                findings.add(Grade::Warning, "frame_damaged", Some(at), || {
                    format!("a frame of the link was damaged when it came: {error}")
                });
            }
            // The stream is joined in the middle of a frame.
            Err(_) => {}
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
            self.status(&status, findings);
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
                let (grade, kind, why) = if told {
                    (Grade::Warning, "imu_gap", "as the board itself says")
                } else {
                    let why = "and the board does not say why";
                    (Grade::Error, "imu_gap_unexplained", why)
                };
                findings.add(grade, kind, Some(at), || {
                    let silence = distance as f64 / 48_000.0;
                    format!("{silence:.1} ms without IMU samples, {why}")
                });
            }
        }
        self.last_imu = Some((at, seq));
    }

    fn status(&mut self, status: &Status, findings: &mut Findings) {
        let imu = self
            .streams
            .get(Stream::Imu as usize)
            .and_then(|stream| stream.expected);
        self.counters.take(status, imu, self.missing());
        if !self.after_gap {
            self.pulses.count(status, findings);
        }
    }

    fn missing(&self) -> [u64; STREAMS] {
        self.streams.each_ref().map(|stream| stream.report.missing)
    }

    /// Of what is missing, what the board dropped itself. Pulses per second are
    /// counted with the further outputs.
    fn share_drops(&mut self) {
        let mut left_of_outputs = 0;
        for ((numbers, of), dropped) in self
            .streams
            .iter_mut()
            .zip(Stream::ALL)
            .zip(self.counters.dropped)
        {
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
        let mut runs = self.runs_in_file.iter();
        let run = runs.find(|run| run.shift == mark.shift_ticks);
        self.pulses.realign(run.and_then(|run| run.anchor));
    }

    /// The board may have been reset since the last message.
    fn run(&mut self, epoch: u32, findings: &mut Findings) {
        if self.epoch.is_some_and(|known| known != epoch) {
            self.counters
                .close_run(self.missing(), self.gaps > 0, findings);
            self.runs += 1;
            findings.add(Grade::Warning, "board_reset", None, || {
                String::from("the board was reset within the recording")
            });
            for stream in &mut self.streams {
                stream.expected = None;
                stream.pending.clear();
            }
            self.topics.begin_run();
            self.pulses.begin_run();
            self.last_imu = None;
            self.shift = 0;
        }
        self.epoch = Some(epoch);
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

    /// What a message says, against the frames of the link and the ones before it.
    fn item(&mut self, item: &Item, at: u64, findings: &mut Findings) {
        let ticks = ticks_of_nanos(at);
        match item {
            Item::Link(frame) => self.frame(frame, ticks, findings),
            Item::Imu(imu) => {
                self.in_own_frame(Stream::Imu, &imu.header, at, findings);
                if imu.angular_velocity.iter().any(|rate| !rate.is_finite()) {
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
                self.pulses.pulse(pulse, findings);
            }
            Item::Capture(capture) => {
                self.in_own_frame(Stream::Captures, &capture.header, at, findings);
                if capture.after_loss {
                    findings.add(Grade::Warning, "captures_lost", Some(ticks), || {
                        String::from("an edge on the strobe input was lost, as the board says")
                    });
                }
            }
            Item::Status(status) => self.in_own_frame(Stream::Status, &status.header, at, findings),
            Item::Output(pulse) => self.in_own_frame(Stream::Outputs, &pulse.header, at, findings),
            Item::Gnss(pulse) => self.in_own_frame(Stream::Pps, &pulse.header, at, findings),
            Item::Run(mark) => self.recorded_run(mark, findings),
            Item::Period(period) => self.pulses.follow(period),
            Item::Marker(_) => self.markers += 1,
            Item::Temperature(_)
            | Item::Clock(_)
            | Item::PhoneClock(_)
            | Item::Log(_)
            | Item::Trigger(_)
            | Item::Strobe(_)
            | Item::Exchange(_)
            | Item::HostTime(_) => {}
        }
    }

    /// A message that came in a frame of its own.
    fn in_own_frame(&mut self, of: Stream, header: &Header, at: u64, findings: &mut Findings) {
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

impl Content {
    /// Takes what was read of the file.
    pub(crate) fn take(&mut self, event: Event<'_>, findings: &mut Findings) {
        match event {
            Event::Message(message) => self.message(&message, findings),
            Event::Damage(damage) => {
                findings.add_damage(&damage);
                if damage.is_gap() {
                    self.gap();
                }
            }
            Event::Schema(..) | Event::Channel(_) | Event::EndOfChunk | Event::Attachment(_) => {}
        }
    }

    fn message(&mut self, message: &Message<'_>, findings: &mut Findings) {
        let (topic, name) = (message.channel.known, &message.channel.described.topic);
        match message.item() {
            Some(Ok(item)) => self.item(&item, message.header.log_time, findings),
            Some(Err(error)) => {
                findings.add(Grade::Error, "message_damaged", Some(message.at()), || {
                    format!("a message of {name} cannot be read: {error}")
                });
            }
            None => {}
        }
        self.topics.place(name, topic, &message.header, findings);
        self.after_gap &= matches!(topic, Some(Topic::Link | Topic::Log));
    }

    /// Something is missing in the file here.
    fn gap(&mut self) {
        self.after_gap = true;
        self.gaps += 1;
        for stream in &mut self.streams {
            stream.pending.clear();
            stream.seen = false;
        }
        self.pulses.forget();
        self.last_imu = None;
        self.counters.forget();
    }
}
