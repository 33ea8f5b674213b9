//! Messages that wait to be sent to the host.
//!
//! Producers never wait: each stream has a queue of its own, and a message that finds no
//! place there is dropped and counted. The sender takes answers first, then
//! pulses, pulses of the auxiliary outputs, captures, IMU samples and status, so that
//! a flood of one stream never delays what matters more.
//!
//! While no host is linked everything is dropped and counted, so that a host
//! that comes gets nothing stale. Sequence numbers are given by the producers:
//! every drop shows as a gap too.

use heapless::Deque;
use protocol::{Capture, DeviceToHost, Dropped, ImuSample, Pps, Pulse, Status};

use crate::config;

/// The queues.
#[derive(Debug, Default)]
pub struct Outbox {
    linked: bool,
    /// In all queues: the sender looks at this several times a message.
    waiting: usize,
    answers: Deque<DeviceToHost, { config::ANSWERS }>,
    pulses: Deque<Pulse, { config::PULSES }>,
    /// Pulses of the auxiliary outputs and pulses per second, in their order.
    outputs: Deque<OutputMessage, { config::OUTPUT_PULSES }>,
    captures: Deque<Capture, { config::CAPTURES }>,
    imu: Deque<ImuSample, { config::IMU_SAMPLES }>,
    status: Deque<Status, { config::STATUSES }>,
    dropped: Dropped,
}

/// A message of the auxiliary outputs.
#[derive(Clone, Copy, Debug)]
enum OutputMessage {
    Pulse(Pulse),
    Pps(Pps),
}

/// The place where messages of a stream are counted.
pub type Counter = fn(&mut Dropped) -> &mut u32;

/// Where a message counts if it is lost; filler nowhere.
#[must_use]
#[inline(always)]
pub fn counter_of(message: &DeviceToHost) -> Option<Counter> {
    Some(match message {
        DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => |dropped| &mut dropped.pulses,
        DeviceToHost::Pulse(_) | DeviceToHost::Pps(_) => |dropped| &mut dropped.outputs,
        DeviceToHost::Capture(_) => |dropped| &mut dropped.captures,
        DeviceToHost::Imu(_) => |dropped| &mut dropped.imu,
        DeviceToHost::Status(_) => |dropped| &mut dropped.status,
        DeviceToHost::Hello(_) | DeviceToHost::Answer(_) | DeviceToHost::Arrived(_) => {
            |dropped| &mut dropped.answers
        }
        DeviceToHost::Filler(_) => return None,
    })
}

/// Empties `queue` and counts what was in it.
fn clear<T, const N: usize>(queue: &mut Deque<T, N>, dropped: &mut u32) {
    *dropped = dropped.saturating_add(queue.len() as u32);
    queue.clear();
}

impl Outbox {
    /// Empty, with no host.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            linked: false,
            waiting: 0,
            answers: Deque::new(),
            pulses: Deque::new(),
            outputs: Deque::new(),
            captures: Deque::new(),
            imu: Deque::new(),
            status: Deque::new(),
            dropped: Dropped {
                answers: 0,
                pulses: 0,
                captures: 0,
                imu: 0,
                status: 0,
                outputs: 0,
            },
        }
    }

    /// A host has come or gone. What was waiting is dropped and counted.
    pub fn set_linked(&mut self, linked: bool) {
        self.linked = linked;
        self.waiting = 0;
        clear(&mut self.answers, &mut self.dropped.answers);
        clear(&mut self.pulses, &mut self.dropped.pulses);
        clear(&mut self.outputs, &mut self.dropped.outputs);
        clear(&mut self.captures, &mut self.dropped.captures);
        clear(&mut self.imu, &mut self.dropped.imu);
        clear(&mut self.status, &mut self.dropped.status);
    }

    /// Returns true if there is a host.
    #[must_use]
    pub const fn is_linked(&self) -> bool {
        self.linked
    }

    /// Returns true if the answers of one more command will find a place. Without a host they are
    /// dropped, which is no reason to wait.
    #[must_use]
    pub fn has_room_for_command(&self) -> bool {
        !self.linked || self.answers.capacity() - self.answers.len() >= config::ANSWERS_PER_COMMAND
    }

    /// Queues a message if there is a host, or counts it as dropped.
    ///
    /// Inlined, as is what it calls, because each caller knows the kind of its message: neither
    /// the choice of the queue nor a copy of the largest kind of message is left there.
    #[inline(always)]
    pub fn send(&mut self, message: DeviceToHost) {
        let counter = counter_of(&message);
        if self.linked && self.queue(message) {
            self.waiting = self.waiting.saturating_add(1);
        } else if let Some(counter) = counter {
            self.lose(counter);
        }
    }

    /// Returns false if there is no place.
    #[inline(always)]
    fn queue(&mut self, message: DeviceToHost) -> bool {
        match message {
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => {
                self.pulses.push_back(pulse).is_ok()
            }
            DeviceToHost::Pulse(pulse) => {
                let message = OutputMessage::Pulse(pulse);
                self.outputs.push_back(message).is_ok()
            }
            DeviceToHost::Pps(pps) => self.outputs.push_back(OutputMessage::Pps(pps)).is_ok(),
            DeviceToHost::Capture(capture) => self.captures.push_back(capture).is_ok(),
            DeviceToHost::Imu(sample) => self.imu.push_back(sample).is_ok(),
            DeviceToHost::Status(status) => self.status.push_back(status).is_ok(),
            message => self.answers.push_back(message).is_ok(),
        }
    }

    /// Returns the counts of messages dropped since reset.
    #[must_use]
    pub const fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Counts a message that was taken to be sent and was not.
    pub fn lose(&mut self, counter: Counter) {
        let dropped = counter(&mut self.dropped);
        *dropped = dropped.saturating_add(1);
    }

    /// Returns true if no message waits.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.waiting == 0
    }

    /// Removes and returns the message that is to be sent next.
    pub fn pop(&mut self) -> Option<DeviceToHost> {
        self.waiting = self.waiting.checked_sub(1)?;
        if let Some(message) = self.answers.pop_front() {
            return Some(message);
        }
        if let Some(pulse) = self.pulses.pop_front() {
            return Some(DeviceToHost::Pulse(pulse));
        }
        if let Some(message) = self.outputs.pop_front() {
            return Some(match message {
                OutputMessage::Pulse(pulse) => DeviceToHost::Pulse(pulse),
                OutputMessage::Pps(pps) => DeviceToHost::Pps(pps),
            });
        }
        if let Some(capture) = self.captures.pop_front() {
            return Some(DeviceToHost::Capture(capture));
        }
        if let Some(sample) = self.imu.pop_front() {
            return Some(DeviceToHost::Imu(sample));
        }
        self.status.pop_front().map(DeviceToHost::Status)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{Answer, Output, Reply};

    fn answer(id: u32) -> DeviceToHost {
        let result = Ok(Reply::SayHello(()));
        DeviceToHost::Answer(Answer { id, result })
    }

    fn sample(seq: u32) -> DeviceToHost {
        DeviceToHost::Imu(ImuSample {
            seq,
            ..ImuSample::default()
        })
    }

    fn pulse(seq: u32) -> DeviceToHost {
        pulse_of(Output::Camera, seq)
    }

    fn pulse_of(output: Output, seq: u32) -> DeviceToHost {
        DeviceToHost::Pulse(Pulse {
            output,
            seq,
            ..Pulse::default()
        })
    }

    fn linked() -> Outbox {
        let mut outbox = Outbox::new();
        outbox.set_linked(true);
        outbox
    }

    #[test]
    fn answers_go_first_then_pulses_captures_samples() {
        let mut outbox = linked();
        let capture = DeviceToHost::Capture(Capture::default());
        outbox.send(sample(0));
        outbox.send(capture.clone());
        outbox.send(pulse(0));
        outbox.send(pulse(1));
        outbox.send(answer(7));
        assert_eq!(outbox.pop(), Some(answer(7)));
        assert_eq!(outbox.pop(), Some(pulse(0)));
        outbox.send(answer(8));
        assert_eq!(outbox.pop(), Some(answer(8)));
        assert_eq!(outbox.pop(), Some(pulse(1)));
        assert_eq!(outbox.pop(), Some(capture));
        assert_eq!(outbox.pop(), Some(sample(0)));
        assert_eq!(outbox.pop(), None);
        assert!(outbox.is_empty());
    }

    #[test]
    fn pulses_of_the_camera_go_before_those_of_the_auxiliary_outputs() {
        let mut outbox = linked();
        let auxiliary = Output::AUXILIARY.map(|output| pulse_of(output, 9));
        for pulse in auxiliary.clone() {
            outbox.send(pulse);
        }
        outbox.send(pulse(0));
        for expected in [pulse(0)].into_iter().chain(auxiliary) {
            assert_eq!(outbox.pop(), Some(expected));
        }
        for _ in 0..1_000 {
            outbox.send(pulse_of(Output::Two, 9));
        }
        assert_eq!(outbox.dropped().pulses, 0);
        assert!(outbox.dropped().outputs > 0);
    }

    #[test]
    fn a_full_queue_drops_the_newest_and_counts_it_for_that_stream_alone() {
        let mut outbox = linked();
        for seq in 0..100 {
            outbox.send(sample(seq));
        }
        outbox.send(pulse(0));
        let lost = 100 - config::IMU_SAMPLES as u32;
        let expected = Dropped {
            imu: lost,
            ..Dropped::default()
        };
        assert_eq!(outbox.dropped(), expected);
        assert_eq!(outbox.pop(), Some(pulse(0)));
        for seq in 0..config::IMU_SAMPLES as u32 {
            assert_eq!(outbox.pop(), Some(sample(seq)));
        }
        assert_eq!(outbox.pop(), None);
    }

    #[test]
    fn without_a_host_everything_is_dropped_and_a_new_host_gets_nothing_old() {
        let mut outbox = Outbox::new();
        outbox.send(pulse(0));
        outbox.send(answer(1));
        assert!(outbox.is_empty());
        assert!(outbox.has_room_for_command());
        outbox.set_linked(true);
        outbox.send(pulse(1));
        outbox.send(pulse(2));
        outbox.set_linked(true);
        assert!(outbox.is_empty());
        assert_eq!(outbox.dropped().pulses, 3);
        assert_eq!(outbox.dropped().answers, 1);
    }

    #[test]
    fn commands_wait_while_their_answers_have_no_room() {
        let mut outbox = linked();
        let mut taken = 0;
        while outbox.has_room_for_command() {
            outbox.send(answer(taken));
            taken += 1;
        }
        assert_eq!(
            taken as usize,
            config::ANSWERS - config::ANSWERS_PER_COMMAND + 1
        );
        outbox.pop();
        assert!(outbox.has_room_for_command());
        assert_eq!(outbox.dropped(), Dropped::default());
    }
}
