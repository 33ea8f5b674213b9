//! The lines that [`tim1`] makes: the pulse per second and the trigger outputs 2 to 4.
//!
//! The handlers run at priority 1: only the camera trigger goes before them. They
//! hand over through a lock-free queue of their own to [`super::events`]. The handler of
//! a rising edge arms the falling one, hence [`protocol::MIN_OUTPUT_WIDTH`].

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use embassy_stm32::{interrupt, pac};
use firmware::config;
use firmware::pulser::{CompareOutput, Pulsed, Pulser};
use firmware::timebase::Timebase;
use firmware::trigger::Limits;
use heapless::spsc::Producer;
use protocol::Output;

use crate::hardware::cycles::OUTPUTS_TIME;
use crate::hardware::events::{self, Event};
use crate::hardware::irq_priority::IrqPriorityMutex;
use crate::hardware::masked;
use crate::hardware::resources::Outputs;
use crate::hardware::tim1::{self, Channel, Match};
use crate::hardware::tim2::{self, TIMEBASE};

/// A line, in the order of the channels. The camera's output is none of them.
#[derive(Clone, Copy)]
pub(crate) enum Line {
    Pps,
    Two,
    Three,
    Four,
}

impl Line {
    const fn output(self) -> Option<Output> {
        match self {
            Self::Pps => None,
            Self::Two => Some(Output::Two),
            Self::Three => Some(Output::Three),
            Self::Four => Some(Output::Four),
        }
    }
}

/// A line's train and its channel.
struct Driven {
    line: Line,
    pulser: Pulser,
    channel: Channel,
}

impl Driven {
    const fn new(line: Line) -> Self {
        Self {
            line,
            pulser: Pulser::new(Limits::OUTPUT),
            channel: Channel::new(line as usize),
        }
    }
}

/// State that handlers and tasks share.
struct Shared {
    lines: [Driven; 4],
    events: events::Sender,
    pps_seq: u32,
    pulse_seq: u32,
    lost: u32,
    latency: u32,
}

static SHARED: IrqPriorityMutex<RefCell<Shared>> = IrqPriorityMutex::new(RefCell::new(Shared {
    lines: [
        Driven::new(Line::Pps),
        Driven::new(Line::Two),
        Driven::new(Line::Three),
        Driven::new(Line::Four),
    ],
    events: None,
    pps_seq: 0,
    pulse_seq: 0,
    lost: 0,
    latency: 0,
}));

/// Sets the timers up to be started by TIM2's start, which must come after this.
/// `events` receives the handlers' events.
#[allow(unsafe_code, reason = "unmasks the interrupts")]
pub(crate) fn init(owned: Outputs, events: Producer<'static, Event>) {
    tim1::init(owned);
    SHARED.lock(|shared| shared.borrow_mut().events = Some(events));
    // SAFETY: what the handlers touch is set up.
    unsafe {
        NVIC::unmask(pac::Interrupt::TIM1_CC);
        NVIC::unmask(pac::Interrupt::TIM5);
    }
}

/// Calls `work`, which must be short, on a line while no edge of any line is due soon.
pub(crate) fn with_line<R>(
    line: Line,
    work: impl FnOnce(&mut Pulser, &mut dyn CompareOutput, &Timebase) -> R,
) -> R {
    let mut work = Some(work);
    loop {
        let result = SHARED.lock(|shared| {
            let shared = &mut *shared.borrow_mut();
            let now = TIMEBASE.extend(tim2::counter());
            let margin = config::OUTPUT_QUIET_MARGIN;
            let busy = |driven: &Driven| driven.pulser.is_busy(now, margin);
            if shared.lines.iter().any(busy) {
                return None;
            }
            let Driven {
                pulser, channel, ..
            } = shared.line(line);
            work.take()
                .map(|work| masked::BELOW_TRIGGER.measure(|| work(pulser, channel, &TIMEBASE)))
        });
        if let Some(result) = result {
            return result;
        }
    }
}

/// Pulses that found no place in the queue to the handler below, and the longest
/// time from an edge to the end of its handling, in ticks, since reset.
pub(crate) fn counters() -> (u32, u32) {
    SHARED.lock(|shared| {
        let shared = shared.borrow();
        (shared.lost, shared.latency)
    })
}

/// Sets the polarity of the pulse per second, from high to low if `inverted`; to be called while
/// it is stopped.
pub(crate) fn set_pps_inverted(inverted: bool) {
    SHARED.lock(|shared| {
        let mut shared = shared.borrow_mut();
        shared.line(Line::Pps).channel.set_inverted(inverted);
    });
}

#[interrupt]
fn TIM1_CC() {
    OUTPUTS_TIME.measure(|| SHARED.lock(|shared| shared.borrow_mut().handle()));
}

#[interrupt]
fn TIM5() {
    OUTPUTS_TIME.measure(|| SHARED.lock(|shared| shared.borrow_mut().handle()));
}

impl Shared {
    fn line(&mut self, line: Line) -> &mut Driven {
        &mut self.lines[line as usize]
    }

    fn handle(&mut self) {
        TIMEBASE.refresh(tim2::counter());
        while let Some((line, came)) = self.next_match() {
            let Driven {
                pulser, channel, ..
            } = self.line(line);
            let pulsed = pulser.on_match(channel, &TIMEBASE);
            if let Match::Edge(at) = came {
                let latency = tim2::counter().wrapping_sub(at);
                self.latency = self.latency.max(latency);
            }
            if let Some(pulsed) = pulsed {
                self.publish(line, pulsed);
            }
        }
    }

    /// Takes the next match. Edges first: a falling edge may have to be armed soon.
    fn next_match(&self) -> Option<(Line, Match)> {
        let first = |take: fn(&Channel) -> Option<Match>| {
            let mut lines = self.lines.iter();
            lines.find_map(|driven| Some((driven.line, take(&driven.channel)?)))
        };
        first(Channel::take_edge).or_else(|| first(Channel::take_wake))
    }

    /// Queues a pulse for the handler of lower priority.
    fn publish(&mut self, line: Line, pulsed: Pulsed) {
        let output = line.output();
        let counter = match output {
            Some(_) => &mut self.pulse_seq,
            None => &mut self.pps_seq,
        };
        let seq = *counter;
        *counter = seq.wrapping_add(1);
        if !events::send(&mut self.events, Event::Pulse(output, seq, pulsed)) {
            self.lost = self.lost.saturating_add(1);
        }
    }
}
