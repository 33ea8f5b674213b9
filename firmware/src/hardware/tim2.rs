//! TIM2: the timebase, the trigger and the captures.
//!
//! The handlers run at the highest priority and are never masked by a critical
//! section ([`super::critical_section`]). Tasks that look at or change the train
//! mask all interrupts (PRIMASK) for a few microseconds, and wait until no edge
//! is due in that time; everything that needs division is worked out on a copy.
//!
//! | channel | pin | direction |
//! |---|---|---|
//! | 1 | PA5 | trigger: output compare, turns over at each match; [`falling_edges`] loads the second |
//! | 2 | PA1 | data-ready of the IMU: capture of rising edges |
//! | 3 | PA2 | strobe: capture of both edges |
//! | 4 | PA3 | read-back of the trigger: capture of rising edges, no interrupt |
//!
//! The HAL sets up timers and pins. The rest is by hand: the HAL's captures wake tasks from within
//! critical sections, its outputs make periods and not single edges, and its DMA is awaited.
//!
//! Inputs are filtered, which delays them by a constant ([`flash::input_delay`]), and
//! pulled down, so that one with nothing wired to it is silent.

use core::cell::RefCell;
use core::mem::forget;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use cortex_m::interrupt::{Mutex, free as with_all_masked};
use cortex_m::peripheral::NVIC;
use embassy_stm32::gpio::{OutputType, Pull, Speed};
use embassy_stm32::pac::timer::regs::SrGp16;
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, FilterValue, Mms, Ocm};
use embassy_stm32::peripherals::TIM2;
use embassy_stm32::timer::input_capture::CapturePin;
use embassy_stm32::timer::low_level::Timer;
use embassy_stm32::timer::simple_pwm::{PwmPin, PwmPinConfig};
use embassy_stm32::timer::{Ch1, Ch2, Ch3, Ch4};
use embassy_stm32::{interrupt, pac};
use firmware::capture::{Bucket, direction};
use firmware::config;
use firmware::pulser::{Action, Captured, CompareOutput, Pulser};
use firmware::timebase::Timebase;
use firmware::trigger::Limits;
use heapless::spsc::Producer;
use protocol::{Capture, CaptureChannel, Output, Ticks};

use crate::hardware::cycles::TRIGGER_TIME;
use crate::hardware::events::{self, DataReady, Event, Input};
use crate::hardware::resources::Trigger;
use crate::hardware::{falling_edges, flash, masked};

const TIM: pac::timer::TimGp32 = pac::TIM2;

/// Index of the channels in the registers, from 0.
const TRIGGER: usize = 0;
const DATA_READY: usize = 1;
const STROBE: usize = 2;
const READBACK: usize = 3;

/// Properties of a pin that makes edges.
pub(super) const OUTPUT_PIN: PwmPinConfig = PwmPinConfig {
    output_type: OutputType::PushPull,
    speed: Speed::High,
    pull: Pull::None,
};

/// The strobe's pin on port A.
const STROBE_PIN: usize = 2;

pub(super) static TIMEBASE: Timebase = Timebase::new();
static SHARED: Mutex<RefCell<Shared>> = Mutex::new(RefCell::new(Shared::new()));

/// Inputs that are to be switched on again, as bits of [`Input`].
static UNMUTE: AtomicU8 = AtomicU8::new(0);

/// Delay that a self test adds to the trigger's handler, in core cycles.
static SLOWED: AtomicU32 = AtomicU32::new(0);

/// Makes the trigger's handler slow, to try out what notices it.
pub(crate) fn slow_down() {
    SLOWED.store(config::SLOW_HANDLER_CYCLES, Ordering::Relaxed);
}

/// Counters of the handler since reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Counters {
    /// Longest time from a trigger edge to the end of its handling, in ticks.
    pub(crate) latency: u32,
    pub(crate) strobe_overcaptures: u32,
    pub(crate) strobe_floods: u32,
    pub(crate) data_ready_overcaptures: u32,
    /// Pulses that found no place in the queue to the handler below.
    pub(crate) lost_pulses: u32,
    /// The same of captures.
    pub(crate) lost_captures: u32,
    /// The same of data-ready edges.
    pub(crate) lost_data_ready: u32,
}

struct InputState {
    bucket: Bucket,
    /// Bucket for edges close together.
    close: Bucket,
    after_loss: bool,
    overcaptures: u32,
    floods: u32,
}

impl InputState {
    const fn new(bucket: Bucket, close: Bucket) -> Self {
        Self {
            bucket,
            close,
            after_loss: false,
            overcaptures: 0,
            floods: 0,
        }
    }
}

/// State that handlers and tasks share.
struct Shared {
    pulser: Pulser,
    events: events::Sender,
    pulse_seq: u32,
    capture_seq: u32,
    data_ready: InputState,
    strobe: InputState,
    counters: Counters,
}

/// Starts the counter, 32 bit, 48 MHz, free running, and the channels. `events` receives the
/// handler's events.
///
/// TIM1 and TIM5 must have been set up: this start starts them too.
pub(crate) fn init(owned: Trigger, events: Producer<'static, Event>) {
    // Reset, with its whole range and no prescaler. What is dropped is given back.
    forget(Timer::new(owned.timer));
    TIM.cr2().modify(|w| w.set_mms(Mms::ENABLE));
    TIM.ccmr_output(0)
        .modify(|w| w.set_ocm(0, Ocm::FORCE_INACTIVE));
    // IC2 on TI2, IC3 on TI3, IC4 on TI4: value 1 in each field.
    TIM.ccmr_input(0).modify(|w| {
        w.set_ccs(1, CcmrInputCcs::TI4);
        w.set_icf(1, FilterValue::FCK_INT_N8);
    });
    TIM.ccmr_input(1).modify(|w| {
        for input in [0, 1] {
            w.set_ccs(input, CcmrInputCcs::TI4);
            w.set_icf(input, FilterValue::FCK_INT_N8);
        }
    });
    TIM.ccer().modify(|w| {
        // Both edges of the strobe.
        w.set_ccp(STROBE, true);
        w.set_ccnp(STROBE, true);
        for channel in [TRIGGER, DATA_READY, STROBE, READBACK] {
            w.set_cce(channel, true);
        }
    });

    forget((
        PwmPin::<TIM2, Ch1>::new_with_config(owned.trigger, OUTPUT_PIN),
        CapturePin::<TIM2, Ch2>::new(owned.data_ready, Pull::Down),
        CapturePin::<TIM2, Ch3>::new(owned.strobe, Pull::Down),
        CapturePin::<TIM2, Ch4>::new(owned.readback, Pull::Down),
    ));

    TIM.sr().write_value(SrGp16(0));
    TIM.dier().modify(|w| {
        w.set_ccie(DATA_READY, true);
        w.set_ccie(STROBE, true);
    });
    falling_edges::init(TIM.ccr(TRIGGER).as_ptr().cast());
    with_all_masked(|token| SHARED.borrow(token).borrow_mut().events = Some(events));
    TIM.cr1().write(|w| w.set_cen(true));
    enable_handlers();
}

#[allow(unsafe_code, reason = "unmasks the interrupts")]
fn enable_handlers() {
    // SAFETY: what the handlers touch is set up.
    unsafe {
        NVIC::unmask(pac::Interrupt::TIM2);
        NVIC::unmask(falling_edges::INTERRUPT);
    }
}

#[inline]
pub(crate) fn counter() -> u32 {
    TIM.cnt().read()
}

pub(crate) fn now() -> Ticks {
    TIMEBASE.refresh(counter())
}

/// Calls `work`, which must be short, on the state that the handler shares, with all interrupts
/// masked. Waits while an edge of the trigger is due soon or being made: for some 40 µs at most,
/// as edges are apart.
fn with_shared<R>(work: impl FnOnce(&mut Shared) -> R) -> R {
    let mut work = Some(work);
    loop {
        let result = with_all_masked(|token| {
            let mut shared = SHARED.borrow(token).borrow_mut();
            let now = TIMEBASE.extend(counter());
            if shared.pulser.is_busy(now, config::QUIET_MARGIN) {
                return None;
            }
            work.take()
                .map(|work| masked::ALL.measure(|| work(&mut shared)))
        });
        if let Some(result) = result {
            return result;
        }
    }
}

/// Calls `work` on the camera's trigger, as [`with_shared`] does.
pub(crate) fn with_pulser<R>(work: impl FnOnce(&mut Pulser, &mut Channel, &Timebase) -> R) -> R {
    with_shared(|shared| work(&mut shared.pulser, &mut Channel, &TIMEBASE))
}

pub(crate) fn counters() -> Counters {
    with_shared(|shared| Counters {
        strobe_overcaptures: shared.strobe.overcaptures,
        strobe_floods: shared.strobe.floods,
        data_ready_overcaptures: shared.data_ready.overcaptures,
        ..shared.counters
    })
}

/// Switches an input on again that was switched off by a flood.
pub(crate) fn unmute(input: Input) {
    UNMUTE.fetch_or(input as u8, Ordering::Relaxed);
    NVIC::pend(pac::Interrupt::TIM2);
}

#[interrupt]
fn TIM2() {
    TRIGGER_TIME.measure(|| {
        with_all_masked(|token| SHARED.borrow(token).borrow_mut().handle());
    });
}

/// The end of a whole pulse.
#[interrupt]
fn DMA1_STREAM5() {
    TRIGGER_TIME.measure(|| {
        with_all_masked(|token| {
            TIMEBASE.refresh(counter());
            // The stream also calls when it is switched off.
            if let Some(fell) = falling_edges::take_end() {
                SHARED.borrow(token).borrow_mut().trigger(fell);
            }
        });
    });
}

fn level_of(pin: usize) -> bool {
    pac::GPIOA.idr().read().idr(pin).to_bits() != 0
}

/// Clears flags of the status register: those bits are cleared by writing 0,
/// and writing 1 leaves the others alone.
fn clear(bits: u32) {
    TIM.sr().write_value(SrGp16(!bits));
}

/// The counter's value when the edge that a channel captured was at its pin.
fn capture_of(channel: usize) -> u32 {
    TIM.ccr(channel).read().wrapping_sub(flash::input_delay())
}

/// Bit of a channel's capture or compare flag.
const fn flag(channel: usize) -> u32 {
    1 << (channel + 1)
}

/// Bit of a channel's over-capture flag.
const fn over_flag(channel: usize) -> u32 {
    1 << (channel + 9)
}

impl Shared {
    const fn new() -> Self {
        Self {
            pulser: Pulser::new(Limits::CAMERA),
            events: None,
            pulse_seq: 0,
            capture_seq: 0,
            data_ready: InputState::new(
                Bucket::new(config::DATA_READY_BURST, config::DATA_READY_REFILL),
                Bucket::new(config::STROBE_CLOSE, config::STROBE_CLOSE_REFILL),
            ),
            strobe: InputState::new(
                Bucket::new(config::STROBE_BURST, config::STROBE_REFILL),
                Bucket::new(config::STROBE_CLOSE, config::STROBE_CLOSE_REFILL),
            ),
            counters: Counters {
                latency: 0,
                strobe_overcaptures: 0,
                strobe_floods: 0,
                data_ready_overcaptures: 0,
                lost_pulses: 0,
                lost_captures: 0,
                lost_data_ready: 0,
            },
        }
    }

    fn handle(&mut self) {
        TIMEBASE.refresh(counter());
        loop {
            // Only what has its interrupt on. The trigger, on its way to an edge far
            // ahead, goes first.
            let pending = TIM.sr().read().0 & TIM.dier().read().0;
            if pending & flag(TRIGGER) != 0 {
                clear(flag(TRIGGER));
                self.trigger(TIM.ccr(TRIGGER).read());
            } else if pending & flag(DATA_READY) != 0 {
                self.data_ready();
            } else if pending & flag(STROBE) != 0 {
                self.strobe();
            } else {
                break;
            }
        }
        let unmute = UNMUTE.swap(0, Ordering::Relaxed);
        if unmute & Input::DataReady as u8 != 0 {
            self.data_ready.listen(DATA_READY);
        }
        if unmute & Input::Strobe as u8 != 0 {
            self.strobe.listen(STROBE);
        }
    }

    /// Handles the match of the trigger's channel at `edge`.
    fn trigger(&mut self, edge: u32) {
        let pulsed = self.pulser.on_match(&mut Channel, &TIMEBASE);
        if let Some(pulsed) = pulsed {
            let seq = self.pulse_seq;
            self.pulse_seq = seq.wrapping_add(1);
            let event = Event::Pulse(Some(Output::Camera), seq, pulsed);
            if !events::send(&mut self.events, event) {
                self.counters.lost_pulses = self.counters.lost_pulses.saturating_add(1);
            }
        }
        let slowed = SLOWED.load(Ordering::Relaxed);
        if slowed > 0 {
            cortex_m::asm::delay(slowed);
        }
        let latency = counter().wrapping_sub(edge);
        self.counters.latency = self.counters.latency.max(latency);
    }

    fn data_ready(&mut self) {
        let (captured, after_loss, flood) = self.data_ready.read_capture(DATA_READY);
        let at = TIMEBASE.extend(captured);
        let edge = DataReady { at, after_loss };
        if !events::send(&mut self.events, Event::DataReady(edge)) {
            self.counters.lost_data_ready = self.counters.lost_data_ready.saturating_add(1);
        }
        if flood {
            events::send(&mut self.events, Event::Flooded(Input::DataReady));
        }
    }

    fn strobe(&mut self) {
        let (captured, after_loss, flood) = self.strobe.read_capture(STROBE);
        // The level that this capture, or the one after it, led to. An edge shows at
        // the pin at once and in the flag only after the filter: both count if they
        // stay for as long as that takes. An input that never does is a flood; its
        // captures are marked as incomplete by what they overrun.
        let mut seen = (level_of(STROBE_PIN), TIM.sr().read().ccif(STROBE));
        for _ in 0..3 {
            let from = counter();
            while counter().wrapping_sub(from) < config::CAPTURE_DELAY {}
            let before = core::mem::replace(
                &mut seen,
                (level_of(STROBE_PIN), TIM.sr().read().ccif(STROBE)),
            );
            if before == seen {
                break;
            }
        }
        let (level, more) = seen;
        // Two edges since this one was taken: the level is that of neither. The flag stays
        // for the next, which is marked too.
        let after_loss = after_loss || TIM.sr().read().ccof(STROBE);
        let capture = Capture {
            seq: self.capture_seq,
            channel: CaptureChannel::Strobe,
            edge: direction(level, more),
            at: TIMEBASE.extend(captured),
            after_loss,
        };
        self.capture_seq = self.capture_seq.wrapping_add(1);
        if !events::send(&mut self.events, Event::Capture(capture)) {
            self.counters.lost_captures = self.counters.lost_captures.saturating_add(1);
        }
        if flood {
            events::send(&mut self.events, Event::Flooded(Input::Strobe));
        }
    }
}

impl InputState {
    /// Reads the captured edge of `channel`. Returns its counter value, true if an edge was lost
    /// before it, and true if the input was now switched off.
    fn read_capture(&mut self, channel: usize) -> (u32, bool, bool) {
        // Reading the value clears its flag.
        let captured = capture_of(channel);
        let over = TIM.sr().read().ccof(channel);
        if over {
            clear(over_flag(channel));
            self.overcaptures = self.overcaptures.saturating_add(1);
        }
        // The lost edge may lie before this value or after it: mark both.
        let after_loss = core::mem::replace(&mut self.after_loss, over) || over;
        let flood = !self.bucket.take(captured) | !self.close.take(captured);
        if flood {
            self.floods = self.floods.saturating_add(1);
            TIM.dier().modify(|w| w.set_ccie(channel, false));
        }
        (captured, after_loss, flood)
    }

    /// Switches the input on again. What came meanwhile is lost.
    fn listen(&mut self, channel: usize) {
        let _ = TIM.ccr(channel).read();
        clear(over_flag(channel));
        self.after_loss = true;
        TIM.dier().modify(|w| w.set_ccie(channel, true));
    }
}

/// Channel 1, and channel 4 that reads it back.
pub(crate) struct Channel;

impl CompareOutput for Channel {
    fn makes_whole_pulses(&self) -> bool {
        true
    }

    fn reach(&self) -> u32 {
        config::MAX_ARM_AHEAD
    }

    fn counter(&self) -> u32 {
        counter()
    }

    fn arm(&mut self, at: u32, action: Action) {
        // Low from here on, whatever came before: the old compare value has passed and
        // matches nothing. The flag is cleared before the new value is written, so that
        // its match is kept.
        self.force_low();
        if let Action::Pulse { fall } = action {
            TIM.ccmr_output(0)
                .modify(|w| w.set_ocm(TRIGGER, Ocm::TOGGLE));
            falling_edges::arm(at, fall);
            TIM.dier().modify(|w| w.set_ccde(TRIGGER, true));
            TIM.ccr(TRIGGER).write_value(at);
        } else {
            TIM.ccr(TRIGGER).write_value(at);
            TIM.dier().modify(|w| w.set_ccie(TRIGGER, true));
        }
    }

    fn has_matched(&self) -> bool {
        TIM.sr().read().ccif(TRIGGER)
    }

    fn force_low(&mut self) {
        TIM.dier().modify(|w| {
            w.set_ccie(TRIGGER, false);
            w.set_ccde(TRIGGER, false);
        });
        falling_edges::disarm();
        TIM.ccmr_output(0)
            .modify(|w| w.set_ocm(TRIGGER, Ocm::FORCE_INACTIVE));
        clear(flag(TRIGGER));
    }

    fn take_readback(&mut self) -> Option<Captured> {
        let status = TIM.sr().read();
        if !status.ccif(READBACK) {
            return None;
        }
        let at = capture_of(READBACK);
        clear(over_flag(READBACK));
        Some(Captured {
            at,
            more: status.ccof(READBACK),
        })
    }
}
