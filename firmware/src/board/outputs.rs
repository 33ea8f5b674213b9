//! TIM1: the pulse per second and the trigger outputs 2 to 4; TIM5 wakes it.
//!
//! | channel | pin | what |
//! |---|---|---|
//! | 1 | PE9 | pulse per second |
//! | 2 | PE11 | trigger output 2 |
//! | 3 | PE13 | trigger output 3 |
//! | 4 | PE14 | trigger output 4 |
//!
//! Both timers are started by TIM2's start, in hardware (trigger mode on ITR1
//! and ITR0, RM0090 tables 93 and 97), so their counts have a constant relation to
//! TIM2's for ever: TIM1, at 96 MHz, stands at `2 · TIM2 − OUTPUT_START_DELAY`, to
//! the clock. TIM1 has 16 bits and comes round every 0.68 ms, so an edge is armed
//! on it only when it is less than that ahead. TIM5 has 32 bits, the same rate as
//! TIM2 and no pins: a match of it, 0.4 ms before the edge, calls the handler that
//! arms TIM1. A handler may so be 0.4 ms late without any harm to a rising edge;
//! the falling edge of a short pulse is armed by the handler of its rising edge,
//! hence [`protocol::MIN_OUTPUT_WIDTH`].
//!
//! The handlers run at priority 1: only the camera trigger goes before them. They
//! hand over through a lock-free queue of their own to [`super::events`].

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt;
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::vals::{Moder, Ospeedr, Pupdr};
use embassy_stm32::pac::timer::regs::{SrAdv, SrGp16};
use embassy_stm32::pac::timer::vals::{Ocm, Sms, Ts};
use firmware::config;
use firmware::pulser::{Action, Captured, CompareOutput, Pulsed, Pulser};
use firmware::timebase::Timebase;
use firmware::trigger::Limits;
use heapless::spsc::Producer;
use protocol::{AlignPlan, Output, OutputAlign, OutputStatus, Refusal, TickDelta};

use crate::board::events::{self, OutputEvent};
use crate::board::tim2::{self, TIMEBASE};
use crate::board::urgent::UrgentMutex;

const TIM1: pac::timer::TimAdv = pac::TIM1;
const TIM5: pac::timer::TimGp32 = pac::TIM5;

/// Channels of TIM1 and TIM5.
pub(crate) const CHANNELS: usize = 4;

/// Pins on port E, by channel; all on alternate function 1 (data sheet, table 9).
const PINS: [usize; CHANNELS] = [9, 11, 13, 14];
const ALTERNATE_FUNCTION: u8 = 1;

pub(crate) const PPS: usize = 0;

pub(crate) const fn channel_of(output: Output) -> usize {
    match output {
        Output::Two => 1,
        Output::Three => 2,
        Output::Four => 3,
    }
}

/// What handlers and tasks share.
struct Shared {
    pulsers: [Pulser; CHANNELS],
    channels: [Channel; CHANNELS],
    events: events::Sender<OutputEvent>,
    pps_seq: u32,
    pulse_seq: u32,
    lost: u32,
    latency: u32,
}

static SHARED: UrgentMutex<RefCell<Shared>> = UrgentMutex::new(RefCell::new(Shared {
    pulsers: [Pulser::new(Limits::OUTPUT); CHANNELS],
    channels: [
        Channel::new(0),
        Channel::new(1),
        Channel::new(2),
        Channel::new(3),
    ],
    events: None,
    pps_seq: 0,
    pulse_seq: 0,
    lost: 0,
    latency: 0,
}));

/// Sets the timers up to be started by TIM2's start, which must come after this.
/// `events` takes what the handlers have to say.
pub(crate) fn init(events: Producer<'static, OutputEvent>) {
    TIM1.psc().write_value(0);
    TIM1.arr().write(|w| w.set_arr(u16::MAX));
    TIM1.egr().write(|w| w.set_ug(true));
    for channel in 0..CHANNELS {
        TIM1.ccmr_output(channel / 2)
            .modify(|w| w.set_ocm(channel % 2, Ocm::FORCE_INACTIVE));
        TIM1.ccer().modify(|w| w.set_cce(channel, true));
    }
    TIM1.bdtr().modify(|w| w.set_moe(true));
    TIM1.smcr().modify(|w| {
        w.set_ts(Ts::ITR1);
        w.set_sms(Sms::TRIGGER_MODE);
    });
    TIM1.sr().write_value(SrAdv(0));

    TIM5.psc().write_value(0);
    TIM5.arr().write_value(u32::MAX);
    TIM5.egr().write(|w| w.set_ug(true));
    TIM5.smcr().modify(|w| {
        w.set_ts(Ts::ITR0);
        w.set_sms(Sms::TRIGGER_MODE);
    });
    TIM5.sr().write_value(SrGp16(0));

    for pin in PINS {
        pac::GPIOE
            .afr(pin / 8)
            .modify(|w| w.set_afr(pin % 8, ALTERNATE_FUNCTION));
        pac::GPIOE
            .pupdr()
            .modify(|w| w.set_pupdr(pin, Pupdr::FLOATING));
        pac::GPIOE
            .ospeedr()
            .modify(|w| w.set_ospeedr(pin, Ospeedr::HIGH_SPEED));
        pac::GPIOE
            .moder()
            .modify(|w| w.set_moder(pin, Moder::ALTERNATE));
    }

    SHARED.lock(|shared| shared.borrow_mut().events = Some(events));
    enable_handlers();
}

#[allow(unsafe_code, reason = "unmasks the interrupts")]
fn enable_handlers() {
    // SAFETY: what the handlers touch is set up.
    unsafe {
        NVIC::unmask(pac::Interrupt::TIM1_CC);
        NVIC::unmask(pac::Interrupt::TIM5);
    }
}

/// Works on one channel while no edge of any is due soon: to be kept short.
pub(crate) fn with_channel<R>(
    channel: usize,
    work: impl FnOnce(&mut Pulser, &mut Channel, &Timebase) -> R,
) -> Option<R> {
    let mut work = Some(work);
    loop {
        let result = SHARED.lock(|shared| {
            let shared = &mut *shared.borrow_mut();
            let now = TIMEBASE.extend(tim2::counter());
            let margin = config::OUTPUT_QUIET_MARGIN;
            if shared
                .pulsers
                .iter()
                .any(|pulser| pulser.is_busy(now, margin))
            {
                return None;
            }
            let pulser = shared.pulsers.get_mut(channel);
            let output = shared.channels.get_mut(channel);
            Some(match (pulser, output, work.take()) {
                (Some(pulser), Some(output), Some(work)) => Some(work(pulser, output, &TIMEBASE)),
                _ => None,
            })
        });
        if let Some(result) = result {
            return result;
        }
    }
}

/// Works on a trigger output, as [`with_channel`].
pub(crate) fn with_output<R>(
    output: Output,
    work: impl FnOnce(&mut Pulser, &mut Channel, &Timebase) -> Result<R, Refusal>,
) -> Result<R, Refusal> {
    // Every output has a channel.
    with_channel(channel_of(output), work).unwrap_or(Err(Refusal::TriggerStopped))
}

/// Plans an align of an output and puts it into force.
///
/// # Errors
///
/// As [`firmware::trigger::Train::align`]; no train runs.
pub(crate) fn align(output: Output, command: u32, to: &OutputAlign) -> Result<AlignPlan, Refusal> {
    loop {
        let train = with_output(output, |pulser, _, _| {
            pulser.running().copied().ok_or(Refusal::TriggerStopped)
        })?;
        let alignment = train.align(command, to, tim2::now())?;
        if with_output(output, |pulser, _, _| pulser.adopt(&alignment))? {
            return Ok(alignment.plan);
        }
    }
}

/// A copy of a channel's pulser, to be looked at with interrupts on.
pub(crate) fn pulser(channel: usize) -> Pulser {
    with_channel(channel, |pulser, _, _| *pulser).unwrap_or(Pulser::new(Limits::OUTPUT))
}

pub(crate) fn summaries() -> [OutputStatus; CHANNELS] {
    let mut pulsers = [Pulser::new(Limits::OUTPUT); CHANNELS];
    for (channel, copy) in pulsers.iter_mut().enumerate() {
        *copy = pulser(channel);
    }
    let now = tim2::now();
    pulsers.map(|pulser| pulser.summary(now))
}

/// Whether an edge is overdue by more than `by`.
pub(crate) fn is_overdue(by: TickDelta) -> bool {
    let now = tim2::now();
    (0..CHANNELS).any(|channel| pulser(channel).is_overdue(now, by))
}

/// Pulses that found no place in the queue to the handler below, and the longest
/// time from an edge to the end of its handling, in ticks, since reset.
pub(crate) fn counters() -> (u32, u32) {
    SHARED.lock(|shared| {
        let shared = shared.borrow();
        (shared.lost, shared.latency)
    })
}

/// Whether the pulse per second goes from high to low. While it is stopped.
pub(crate) fn set_pps_inverted(inverted: bool) {
    SHARED.lock(|_| TIM1.ccer().modify(|w| w.set_ccp(PPS, inverted)));
}

#[interrupt]
fn TIM1_CC() {
    SHARED.lock(|shared| shared.borrow_mut().handle());
}

#[interrupt]
fn TIM5() {
    SHARED.lock(|shared| shared.borrow_mut().handle());
}

/// Bit of a channel's compare flag and interrupt.
const fn flag(channel: usize) -> u32 {
    1 << (channel + 1)
}

/// Clears flags of TIM1; writing 1 leaves the others alone.
fn clear_tim1(bits: u32) {
    TIM1.sr().write_value(SrAdv(!bits));
}

/// The same of TIM5.
fn clear_tim5(bits: u32) {
    TIM5.sr().write_value(SrGp16(!bits));
}

impl Shared {
    fn handle(&mut self) {
        TIMEBASE.refresh(tim2::counter());
        loop {
            // Edges first: a falling edge may have to be armed soon.
            let matched = TIM1.sr().read().0 & TIM1.dier().read().0;
            let woken = TIM5.sr().read().0 & TIM5.dier().read().0;
            if let Some(channel) = (0..CHANNELS).find(|&n| matched & flag(n) != 0) {
                self.edge(channel);
            } else if let Some(channel) = (0..CHANNELS).find(|&n| woken & flag(n) != 0) {
                self.wake(channel);
            } else {
                break;
            }
        }
    }

    fn edge(&mut self, channel: usize) {
        clear_tim1(flag(channel));
        let Some((pulser, output)) = self.parts(channel) else {
            return;
        };
        let edge = output.at;
        let pulsed = pulser.on_match(output, &TIMEBASE);
        let latency = tim2::counter().wrapping_sub(edge);
        self.latency = self.latency.max(latency);
        self.tell(channel, pulsed);
    }

    fn wake(&mut self, channel: usize) {
        clear_tim5(flag(channel));
        TIM5.dier().modify(|w| w.set_ccie(channel, false));
        let Some((pulser, output)) = self.parts(channel) else {
            return;
        };
        let pulsed = pulser.rearm(output, &TIMEBASE);
        self.tell(channel, pulsed);
    }

    fn parts(&mut self, channel: usize) -> Option<(&mut Pulser, &mut Channel)> {
        let pulser = self.pulsers.get_mut(channel)?;
        let output = self.channels.get_mut(channel)?;
        Some((pulser, output))
    }

    /// Hands a pulse over to the handler below.
    fn tell(&mut self, channel: usize, pulsed: Option<Pulsed>) {
        let Some(pulsed) = pulsed else {
            return;
        };
        let counter = if channel == PPS {
            &mut self.pps_seq
        } else {
            &mut self.pulse_seq
        };
        let seq = *counter;
        *counter = seq.wrapping_add(1);
        let event = OutputEvent {
            channel,
            seq,
            pulsed,
        };
        if !events::send(&mut self.events, event) {
            self.lost = self.lost.saturating_add(1);
        }
    }
}

/// One channel of TIM1, with the one of TIM5 that wakes it.
pub(crate) struct Channel {
    index: usize,
    /// The match that was armed last, as TIM2 counts.
    at: u32,
    /// TIM1 is armed, and its flag means that match.
    near: bool,
}

impl Channel {
    const fn new(index: usize) -> Self {
        Self {
            index,
            at: 0,
            near: false,
        }
    }

    fn set_mode(&self, mode: Ocm) {
        TIM1.ccmr_output(self.index / 2)
            .modify(|w| w.set_ocm(self.index % 2, mode));
    }

    /// No match of either timer calls a handler or moves the pin.
    fn disarm(&mut self) {
        self.near = false;
        TIM1.dier().modify(|w| w.set_ccie(self.index, false));
        TIM5.dier().modify(|w| w.set_ccie(self.index, false));
    }
}

impl CompareOutput for Channel {
    fn makes_whole_pulses(&self) -> bool {
        false
    }

    fn counter(&self) -> u32 {
        tim2::counter()
    }

    fn arm(&mut self, at: u32, action: Action) {
        self.disarm();
        // The level stays, whatever matches.
        self.set_mode(Ocm::FROZEN);
        self.at = at;
        let ahead = at.wrapping_sub(tim2::counter());
        // Past is far ahead in this sense, but TIM5 would only come a wrap later.
        if ahead > config::OUTPUT_NEAR && ahead < 1 << 31 {
            let wake = at.wrapping_sub(config::OUTPUT_LEAD);
            TIM5.ccr(self.index).write_value(wake);
            clear_tim5(flag(self.index));
            TIM5.dier().modify(|w| w.set_ccie(self.index, true));
            return;
        }
        let compare = at
            .wrapping_mul(config::TIM1_CLOCKS_PER_TICK)
            .wrapping_sub(config::OUTPUT_START_DELAY);
        TIM1.ccr(self.index).write(|w| w.set_ccr(compare as u16));
        clear_tim1(flag(self.index));
        match action {
            Action::Wake => {}
            Action::Rise => self.set_mode(Ocm::ACTIVE_ON_MATCH),
            Action::Fall => self.set_mode(Ocm::INACTIVE_ON_MATCH),
            // Never asked for: `makes_whole_pulses`.
            Action::Pulse { .. } => {}
        }
        // A match that came before the mode was set has moved nothing: it is
        // not taken for one, and the edge is armed again, late.
        self.near = TIM1.sr().read().0 & flag(self.index) == 0;
        TIM1.dier().modify(|w| w.set_ccie(self.index, true));
    }

    fn has_matched(&self) -> bool {
        self.near && TIM1.sr().read().0 & flag(self.index) != 0
    }

    fn force_low(&mut self) {
        self.disarm();
        self.set_mode(Ocm::FORCE_INACTIVE);
        clear_tim1(flag(self.index));
    }

    fn take_readback(&mut self) -> Option<Captured> {
        None
    }
}
