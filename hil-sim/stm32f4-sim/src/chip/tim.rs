//! TIM1 to TIM5: up-counting timers with output compare and input capture
//! (RM0090 chapters 17 and 18).
//!
//! The counter is never stepped. Its value follows from the time that passed
//! since an anchor, and [`Tim::sync`] does what happened in between: flags,
//! output changes, update events with their preloads. The board calls it at
//! the exact time of every match that anything can see (an interrupt or a
//! pin), and on every register access.
//!
//! An output changes at the time at which the counter takes the compare
//! value. An edge of an input passes the synchroniser and the filter before it
//! latches the counter ([`input`]). A match or capture whose DMA request is enabled
//! raises it; it stays until a transfer acknowledges it (RM0090 10.3.2). Of the slave
//! modes there is the trigger mode on another timer's start: the slave starts
//! [`SLAVE_DELAY`] of its clocks later. Not modelled: down- and centre-aligned
//! counting, the other slave modes, encoder mode, filters that sample more slowly than
//! the timer's clock, complementary outputs and dead time, update requests and DMA
//! bursts.

pub(crate) mod input;
mod registers;

use crate::clock::{Clock, Rate};
use crate::time::SimTime;
use input::Input;

/// Clocks of a slave from its master's start to its own. The reference manual tells
/// of a resynchronisation and not of its length (RM0090 17.3.20).
pub(crate) const SLAVE_DELAY: u64 = 2;

/// Channels of each timer.
const CHANNELS: usize = 4;

const CR1_CEN: u32 = 1 << 0;
const CR1_UDIS: u32 = 1 << 1;
const CR1_URS: u32 = 1 << 2;
const CR1_OPM: u32 = 1 << 3;
const CR1_ARPE: u32 = 1 << 7;
const SR_UIF: u32 = 1 << 0;
const BDTR_MOE: u32 = 1 << 15;

/// Direction of a channel by `CCxS`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Output,
    /// Captures from input `TI(n+1)`.
    Input(usize),
    /// Captures from the trigger input, which is not modelled.
    Trigger,
}

/// One timer.
#[derive(Debug)]
pub(crate) struct Tim {
    mask: u32,
    advanced: bool,
    clock: Clock,
    cr1: u32,
    cr2: u32,
    smcr: u32,
    dier: u32,
    sr: u32,
    ccmr: [u32; 2],
    ccer: u32,
    psc: u32,
    psc_next: u32,
    arr: u32,
    arr_next: u32,
    ccr: [u32; 4],
    ccr_next: [u32; 4],
    bdtr: u32,
    /// Edge of the kernel clock at which the counter took `base_count`.
    base_edge: u64,
    base_count: u32,
    /// OCxREF.
    reference: [bool; 4],
    /// Captures seen since the last one taken, for the input prescaler.
    prescaled: [u8; 4],
    inputs: [Input; 4],
    /// Clocks of the inputs' synchroniser.
    synchroniser: u64,
    /// DMA requests that nobody has acknowledged, a bit a channel.
    requests: u8,
}

impl Tim {
    /// A 32-bit (`wide`) or 16-bit timer.
    pub(crate) fn new(wide: bool, advanced: bool, synchroniser: u64) -> Self {
        let mask = if wide { u32::MAX } else { 0xffff };
        Self {
            mask,
            advanced,
            clock: Clock::new(Rate::hz(16_000_000), SimTime::ZERO, 0),
            cr1: 0,
            cr2: 0,
            smcr: 0,
            dier: 0,
            sr: 0,
            ccmr: [0; 2],
            ccer: 0,
            psc: 0,
            psc_next: 0,
            arr: mask,
            arr_next: mask,
            ccr: [0; 4],
            ccr_next: [0; 4],
            bdtr: 0,
            base_edge: 0,
            base_count: 0,
            reference: [false; 4],
            prescaled: [0; 4],
            inputs: Default::default(),
            synchroniser,
            requests: 0,
        }
    }

    /// Back to the state after a reset; the clock goes on.
    pub(crate) fn reset(&mut self, now: SimTime) {
        let clock = self.clock;
        let wide = self.mask == u32::MAX;
        *self = Self::new(wide, self.advanced, self.synchroniser);
        self.clock = clock;
        self.base_edge = clock.edge_at(now);
    }

    /// The kernel clock runs at another rate from now on.
    pub(crate) fn set_clock(&mut self, rate: Rate, now: SimTime) {
        self.sync(now);
        self.clock = self.clock.re_rated(rate, now);
    }

    fn running(&self) -> bool {
        self.cr1 & CR1_CEN != 0
    }

    /// True if its start is its trigger output (MMS is "enable").
    pub(crate) fn start_is_output(&self) -> bool {
        (self.cr2 >> 4) & 7 == 1
    }

    /// When it was started, if it runs since then without a sync.
    pub(crate) fn start(&self) -> Option<SimTime> {
        self.running().then(|| self.clock.time_of(self.base_edge))
    }

    /// The internal trigger input that starts it, if it waits for one.
    pub(crate) fn awaits(&self) -> Option<usize> {
        let trigger_mode = self.smcr & 7 == 6;
        let input = ((self.smcr >> 4) & 7) as usize;
        (trigger_mode && input < 4 && !self.running()).then_some(input)
    }

    /// Its master started at `at`.
    pub(crate) fn trigger(&mut self, at: SimTime) {
        self.cr1 |= CR1_CEN;
        self.base_edge = self.clock.edge_at(at) + SLAVE_DELAY;
    }

    fn channel(&self, ch: usize) -> Channel {
        match (self.ccmr[ch / 2] >> ((ch % 2) * 8)) & 3 {
            0 => Channel::Output,
            1 => Channel::Input(ch),
            2 => Channel::Input(ch ^ 1),
            _ => Channel::Trigger,
        }
    }

    fn mode(&self, ch: usize) -> u32 {
        (self.ccmr[ch / 2] >> ((ch % 2) * 8 + 4)) & 7
    }

    fn preloaded(&self, ch: usize) -> bool {
        self.ccmr[ch / 2] & (1 << ((ch % 2) * 8 + 3)) != 0
    }

    fn enabled(&self, ch: usize) -> bool {
        self.ccer & (1 << (ch * 4)) != 0
    }

    /// Counter steps from the counter's value to the next wrap to zero.
    fn steps_to_wrap(&self) -> u64 {
        if self.base_count <= self.arr {
            u64::from(self.arr) - u64::from(self.base_count) + 1
        } else {
            // Above the reload value the counter runs on to its width.
            u64::from(self.mask) - u64::from(self.base_count) + 1
        }
    }

    /// Does everything that happened up to and including `now`.
    pub(crate) fn sync(&mut self, now: SimTime) {
        while let Some(at) = self.next_capture()
            && at <= now
        {
            self.count_to(at);
            for ti in 0..CHANNELS {
                let through = self.through(ti);
                while let Some(rising) = self.inputs[ti].pop(self.clock.edge_at(at), through) {
                    self.capture(ti, rising);
                }
            }
        }
        self.count_to(now);
    }

    /// Counts up to and including `now`.
    fn count_to(&mut self, now: SimTime) {
        if !self.running() {
            self.base_edge = self.clock.edge_at(now);
            return;
        }
        let edge = self.clock.edge_at(now);
        loop {
            let div = u64::from(self.psc) + 1;
            let steps = edge.saturating_sub(self.base_edge) / div;
            if steps == 0 {
                return;
            }
            let wrap = self.steps_to_wrap();
            if steps < wrap {
                self.pass(steps as u32);
                self.base_edge += steps * div;
                self.base_count += steps as u32;
                return;
            }
            // To the wrap, then the update event.
            self.pass((wrap - 1) as u32);
            self.base_edge += wrap * div;
            self.base_count = 0;
            self.update_event(true);
            for ch in 0..CHANNELS {
                if self.ccr[ch] == 0 {
                    self.compare(ch);
                }
            }
            if !self.running() {
                self.base_edge = edge;
                return;
            }
        }
    }

    /// The counter passes `steps` values without a wrap.
    fn pass(&mut self, steps: u32) {
        for ch in 0..CHANNELS {
            let ahead = self.ccr[ch].wrapping_sub(self.base_count);
            if self.ccr[ch] > self.base_count && ahead <= steps {
                self.compare(ch);
            }
        }
    }

    /// The counter took the compare value of a channel.
    fn compare(&mut self, ch: usize) {
        if self.channel(ch) != Channel::Output {
            return;
        }
        self.flag(ch);
        match self.mode(ch) {
            1 => self.reference[ch] = true,
            2 => self.reference[ch] = false,
            3 => self.reference[ch] = !self.reference[ch],
            6 => self.reference[ch] = false,
            7 => self.reference[ch] = true,
            _ => {}
        }
    }

    /// A channel matched or captured.
    fn flag(&mut self, ch: usize) {
        self.sr |= 2 << ch;
        if self.dier & (0x200 << ch) != 0 {
            self.requests |= 1 << ch;
        }
    }

    /// Channels that ask the DMA for a transfer, a bit each.
    pub(crate) fn requests(&self) -> u8 {
        self.requests
    }

    /// The DMA serves a channel.
    pub(crate) fn acknowledge(&mut self, ch: usize) {
        self.requests &= !(1 << ch);
    }

    fn update_event(&mut self, overflow: bool) {
        if self.cr1 & CR1_UDIS == 0 {
            self.psc = self.psc_next;
            self.arr = self.arr_next;
            for ch in 0..4 {
                self.ccr[ch] = self.ccr_next[ch];
            }
            if overflow || self.cr1 & CR1_URS == 0 {
                self.sr |= SR_UIF;
            }
        }
        for ch in 0..CHANNELS {
            self.pwm_level(ch);
        }
        if overflow && self.cr1 & CR1_OPM != 0 {
            self.cr1 &= !CR1_CEN;
        }
    }

    /// The level of a PWM or forced output for the counter's present value.
    fn pwm_level(&mut self, ch: usize) {
        if self.channel(ch) != Channel::Output {
            return;
        }
        match self.mode(ch) {
            4 => self.reference[ch] = false,
            5 => self.reference[ch] = true,
            6 => self.reference[ch] = self.base_count < self.ccr[ch],
            7 => self.reference[ch] = self.base_count >= self.ccr[ch],
            _ => {}
        }
    }

    /// Level that channel `ch` drives on its pin, or nothing if it drives none.
    pub(crate) fn output(&self, ch: usize) -> Option<bool> {
        if !self.enabled(ch) || self.channel(ch) != Channel::Output {
            return None;
        }
        if self.advanced && self.bdtr & BDTR_MOE == 0 {
            return None;
        }
        let inverted = self.ccer & (2 << (ch * 4)) != 0;
        Some(self.reference[ch] != inverted)
    }

    /// The filter of input `TI(ti+1)`, as ICxF; none while its channel is an output.
    fn filter(&self, ti: usize) -> u32 {
        match self.channel(ti) {
            Channel::Output => 0,
            _ => (self.ccmr[ti / 2] >> ((ti % 2) * 8 + 4)) & 0xf,
        }
    }

    /// Clocks from an edge of input `TI(ti+1)` to its capture.
    fn through(&self, ti: usize) -> u64 {
        self.synchroniser + input::filter_clocks(self.filter(ti))
    }

    /// An edge on input `TI(ti+1)`.
    pub(crate) fn input_edge(&mut self, ti: usize, rising: bool, now: SimTime) {
        if self.ccer & 0x1111 == 0 {
            return;
        }
        self.sync(now);
        let samples = input::filter_clocks(self.filter(ti));
        self.inputs[ti].edge(self.clock.edge_at(now), rising, samples);
        // Without any delay it is captured at once.
        self.sync(now);
    }

    /// When the next edge that is on its way through an input is captured.
    fn next_capture(&self) -> Option<SimTime> {
        (0..CHANNELS)
            .filter_map(|ti| self.inputs[ti].next(self.through(ti)))
            .min()
            .map(|edge| self.clock.time_of(edge))
    }

    /// An edge of input `TI(ti+1)` has come through.
    fn capture(&mut self, ti: usize, rising: bool) {
        for ch in 0..CHANNELS {
            if self.channel(ch) != Channel::Input(ti) || !self.enabled(ch) {
                continue;
            }
            // CCxNP and CCxP: rising, falling, (reserved), both.
            let wanted = match (self.ccer >> (ch * 4 + 1)) & 5 {
                0 => rising,
                1 => !rising,
                5 => true,
                _ => false,
            };
            if !wanted {
                continue;
            }
            let divide = 1u8 << ((self.ccmr[ch / 2] >> ((ch % 2) * 8 + 2)) & 3);
            self.prescaled[ch] += 1;
            if self.prescaled[ch] < divide {
                continue;
            }
            self.prescaled[ch] = 0;
            self.latch(ch);
        }
    }

    /// A channel captures the counter, by an edge or by software (RM0090 18.4.6).
    fn latch(&mut self, ch: usize) {
        if self.sr & (2 << ch) != 0 {
            self.sr |= 0x200 << ch;
        }
        self.ccr[ch] = self.base_count;
        self.ccr_next[ch] = self.base_count;
        self.flag(ch);
    }

    /// Interrupt requests: all of a general-purpose timer's on the first; an
    /// advanced timer's update on the first and compare on the second.
    pub(crate) fn irq(&self) -> (bool, bool) {
        let active = self.sr & self.dier & 0x5f;
        if self.advanced {
            (active & 1 != 0, active & 0x1e != 0)
        } else {
            (active != 0, false)
        }
    }

    /// When something happens next that an interrupt or a pin can see.
    pub(crate) fn next_event(&self) -> SimTime {
        let capture = self.next_capture().unwrap_or(SimTime::NEVER);
        self.next_match().min(capture)
    }

    fn next_match(&self) -> SimTime {
        if !self.running() {
            return SimTime::NEVER;
        }
        let wrap = self.steps_to_wrap();
        let mut steps = u64::MAX;
        let mut pwm = false;
        for ch in 0..CHANNELS {
            if self.channel(ch) != Channel::Output {
                continue;
            }
            let waits = self.dier & (2 << ch) != 0 && self.sr & (2 << ch) == 0
                || self.dier & (0x200 << ch) != 0;
            let mode = self.mode(ch);
            let drives = self.enabled(ch) && matches!(mode, 1 | 2 | 3 | 6 | 7);
            pwm |= drives && mode >= 6;
            if !waits && !drives {
                continue;
            }
            let ahead = if self.ccr[ch] > self.base_count {
                u64::from(self.ccr[ch] - self.base_count)
            } else {
                wrap + u64::from(self.ccr[ch])
            };
            // A compare value above the reload value is never met.
            if ahead < wrap || self.ccr[ch] <= self.arr_next {
                steps = steps.min(ahead);
            }
        }
        let waits = self.dier & 1 != 0 && self.sr & SR_UIF == 0;
        if waits || pwm || self.cr1 & CR1_OPM != 0 {
            steps = steps.min(wrap);
        }
        if steps == u64::MAX {
            return SimTime::NEVER;
        }
        // Beyond a wrap the prescaler may change: look again there.
        if steps > wrap && self.psc != self.psc_next {
            steps = wrap;
        }
        let div = u64::from(self.psc) + 1;
        self.clock.time_of(self.base_edge + steps * div)
    }

    /// Time of the last edge of the kernel clock, undivided, at or before `now`.
    pub(crate) fn tick_began(&self, now: SimTime) -> SimTime {
        self.clock.time_of(self.clock.edge_at(now))
    }

    /// The counter's value, without any effect.
    pub(crate) fn count(&self, now: SimTime) -> u32 {
        if !self.running() {
            return self.base_count;
        }
        let div = u64::from(self.psc) + 1;
        let steps = self.clock.edge_at(now).saturating_sub(self.base_edge) / div;
        if steps < self.steps_to_wrap() {
            self.base_count + steps as u32
        } else {
            let past = steps - self.steps_to_wrap();
            (past % (u64::from(self.arr_next) + 1)) as u32
        }
    }
}

#[cfg(test)]
mod tests;
