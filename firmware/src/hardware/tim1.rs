//! TIM1 makes the edges of four lines; TIM5 calls the handler on the way to them.
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
//! TIM2's for ever: TIM1, at 96 MHz, stands at `2 · TIM2 − flash::start_delay()`, to
//! the clock. TIM1 has 16 bits and comes round every 0.68 ms, so it reaches only
//! [`config::OUTPUT_REACH`] ahead. TIM5 has 32 bits, the rate of TIM2 and no pins: its
//! channel of the same number makes [`Action::Wake`].

use core::mem::forget;

use embassy_stm32::pac;
use embassy_stm32::pac::timer::regs::{SrAdv, SrGp16};
use embassy_stm32::pac::timer::vals::{Ocm, Sms, Ts};
use embassy_stm32::timer::low_level::Timer;

use firmware::config;
use firmware::pulser::{Action, Captured, CompareOutput};

use crate::hardware::resources::Outputs;
use crate::hardware::{flash, tim2};
#[cfg(feature = "discovery")]
use {
    crate::hardware::tim2::OUTPUT_PIN,
    embassy_stm32::peripherals,
    embassy_stm32::timer::simple_pwm::PwmPin,
    embassy_stm32::timer::{Ch1, Ch2, Ch3, Ch4},
};

#[cfg(feature = "discovery")]
type Pin<C> = PwmPin<'static, peripherals::TIM1, C>;

const TIM1: pac::timer::TimAdv = pac::TIM1;
const TIM5: pac::timer::TimGp32 = pac::TIM5;

/// Sets the timers up to be started by TIM2's start, which must come after this.
pub(super) fn init(owned: Outputs) {
    // Reset, with their whole range and no prescaler. What is dropped is given back.
    forget((Timer::new(owned.edges), Timer::new(owned.wakes)));
    for channel in 0..4 {
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

    TIM5.smcr().modify(|w| {
        w.set_ts(Ts::ITR0);
        w.set_sms(Sms::TRIGGER_MODE);
    });
    TIM5.sr().write_value(SrGp16(0));

    #[cfg(feature = "discovery")]
    forget((
        Pin::<Ch1>::new_with_config(owned.pps, OUTPUT_PIN),
        Pin::<Ch2>::new_with_config(owned.second, OUTPUT_PIN),
        Pin::<Ch3>::new_with_config(owned.third, OUTPUT_PIN),
        Pin::<Ch4>::new_with_config(owned.fourth, OUTPUT_PIN),
    ));
}

/// Bit of a channel's compare flag and interrupt, in both timers.
const fn flag(channel: usize) -> u32 {
    1 << (channel + 1)
}

/// Clears flags; writing 1 leaves the others alone.
fn clear_edge(bits: u32) {
    TIM1.sr().write_value(SrAdv(!bits));
}

fn clear_wake(bits: u32) {
    TIM5.sr().write_value(SrGp16(!bits));
}

/// A match that calls the handler.
pub(super) enum Match {
    /// An edge at this tick of TIM2.
    Edge(u32),
    Wake,
}

/// One channel of both timers. At most one of the two is armed.
pub(super) struct Channel {
    index: usize,
    /// The match that was armed last, as TIM2 counts.
    at: u32,
    /// TIM1's flag means that match.
    in_time: bool,
}

impl Channel {
    pub(super) const fn new(index: usize) -> Self {
        Self {
            index,
            at: 0,
            in_time: false,
        }
    }

    /// Takes the edge that has come.
    pub(super) fn take_edge(&self) -> Option<Match> {
        let bits = TIM1.sr().read().0 & TIM1.dier().read().0 & flag(self.index);
        (bits != 0).then(|| {
            clear_edge(bits);
            Match::Edge(self.at)
        })
    }

    /// Takes the call on the way that has come.
    pub(super) fn take_wake(&self) -> Option<Match> {
        let bits = TIM5.sr().read().0 & TIM5.dier().read().0 & flag(self.index);
        (bits != 0).then(|| {
            clear_wake(bits);
            TIM5.dier().modify(|w| w.set_ccie(self.index, false));
            Match::Wake
        })
    }

    /// Sets the pin's polarity, from high to low at a rising edge if `inverted`; to be called
    /// while the channel is idle.
    pub(super) fn set_inverted(&self, inverted: bool) {
        TIM1.ccer().modify(|w| w.set_ccp(self.index, inverted));
    }

    fn set_mode(&self, mode: Ocm) {
        TIM1.ccmr_output(self.index / 2)
            .modify(|w| w.set_ocm(self.index % 2, mode));
    }

    /// No match of either timer calls a handler.
    fn disarm(&mut self) {
        self.in_time = false;
        TIM1.dier().modify(|w| w.set_ccie(self.index, false));
        TIM5.dier().modify(|w| w.set_ccie(self.index, false));
    }

    fn arm_wake(&self) {
        TIM5.ccr(self.index).write_value(self.at);
        clear_wake(flag(self.index));
        TIM5.dier().modify(|w| w.set_ccie(self.index, true));
    }

    fn arm_edge(&mut self, mode: Ocm) {
        let compare = (self.at)
            .wrapping_mul(config::TIM1_CLOCKS_PER_TICK)
            .wrapping_sub(flash::start_delay());
        TIM1.ccr(self.index).write(|w| w.set_ccr(compare as u16));
        clear_edge(flag(self.index));
        self.set_mode(mode);
        // A match that came before the mode was set has moved nothing: it is
        // not taken for one, and the edge is armed again, late.
        self.in_time = TIM1.sr().read().0 & flag(self.index) == 0;
        TIM1.dier().modify(|w| w.set_ccie(self.index, true));
    }
}

impl CompareOutput for Channel {
    fn makes_whole_pulses(&self) -> bool {
        false
    }

    fn reach(&self) -> u32 {
        config::OUTPUT_REACH
    }

    fn counter(&self) -> u32 {
        tim2::counter()
    }

    fn arm(&mut self, at: u32, action: Action) {
        self.disarm();
        // The level stays, whatever matches.
        self.set_mode(Ocm::FROZEN);
        self.at = at;
        match action {
            Action::Wake => self.arm_wake(),
            Action::Rise => self.arm_edge(Ocm::ACTIVE_ON_MATCH),
            Action::Fall => self.arm_edge(Ocm::INACTIVE_ON_MATCH),
            Action::Pulse { .. } => defmt::unreachable!("see `makes_whole_pulses`"),
        }
    }

    fn has_matched(&self) -> bool {
        self.in_time && TIM1.sr().read().0 & flag(self.index) != 0
    }

    fn force_low(&mut self) {
        self.disarm();
        self.set_mode(Ocm::FORCE_INACTIVE);
        clear_edge(flag(self.index));
    }

    fn take_readback(&mut self) -> Option<Captured> {
        None
    }
}
