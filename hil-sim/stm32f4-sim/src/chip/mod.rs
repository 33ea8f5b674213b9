//! The STM32F407 without its core: buses, peripherals, pins and their events.
//!
//! A peripheral does nothing between two events that something could notice.
//! Each says when its next event is; [`Soc`] keeps the earliest, and the core
//! runs (or sleeps) up to it. An access of the core to a peripheral first does
//! what is due by then, so that every register reads as of its very cycle.

pub(crate) mod dma;
pub(crate) mod exti;
pub(crate) mod gpio;
pub(crate) mod i2c;
pub(crate) mod iwdg;
pub(crate) mod map;
pub(crate) mod memory;
pub(crate) mod otg;
pub(crate) mod pins;
pub(crate) mod rcc;
pub(crate) mod tim;
pub(crate) mod uart;

use std::collections::BTreeMap;

use crate::clock::{Clock, Rate};
use crate::cpu::exec::Bus;
use crate::i2c_bus::I2cBus;
use crate::model::{RigIo, RigModel};
use crate::pin::{Drive, Level, Pin};
use crate::random::{Random, Seed};
use crate::time::SimTime;
use crate::usb::UsbHost;

use dma::Dma;
use exti::Exti;
use gpio::Gpio;
use i2c::I2c;
use iwdg::Iwdg;
use memory::Memory;
use otg::Otg;
use rcc::{Clocks, Rcc, ResetCause};
use tim::Tim;
use uart::Uart;

/// Timers of the model, by index.
pub(crate) const TIM1: usize = 0;
pub(crate) const TIM2: usize = 1;
pub(crate) const TIM3: usize = 2;
pub(crate) const TIM4: usize = 3;
pub(crate) const TIM5: usize = 4;
const TIMERS: usize = 5;

/// Sources of events, in the order in which those of one time are done.
const EV_TIM: usize = 0;
const EV_I2C: usize = TIMERS;
const EV_UART: usize = TIMERS + 1;
const EV_USB: usize = TIMERS + 2;
const EV_IWDG: usize = TIMERS + 3;
/// A clock that changes without a register access (an oscillator gets ready).
const EV_CLOCK: usize = TIMERS + 4;
const EV_MODELS: usize = TIMERS + 5;
const EVENTS: usize = TIMERS + 6;

/// Who is told of edges besides the models.
pub(crate) type EdgeLog = Vec<(Pin, Level, SimTime)>;

/// The chip and what is wired to its pins.
pub(crate) struct Soc {
    pub(crate) mem: Memory,
    now: SimTime,
    core_clock: Clock,
    clocks: Clocks,
    rcc: Rcc,
    pub(crate) gpio: Gpio,
    exti: Exti,
    tim: [Tim; TIMERS],
    dma: [Dma; 2],
    i2c: I2c,
    pub(crate) i2c_bus: I2cBus,
    iwdg: Iwdg,
    uart: Uart,
    pub(crate) otg: Otg,
    pub(crate) usb: UsbHost,
    /// Registers without behaviour, by address.
    plain: BTreeMap<u32, u32>,
    uid: [u32; 3],
    events: [SimTime; EVENTS],
    next_event: SimTime,
    /// The rig's models; taken out while they are called.
    models: Vec<Model>,
    watchers: [u64; Pin::PORTS * 16],
    edge_queue: Vec<(Pin, bool, SimTime)>,
    delivering: bool,
    mco_told: Option<Rate>,
    /// Pins of which edges are logged, a word a port.
    logged: [u16; Pin::PORTS],
    pub(crate) edge_log: EdgeLog,
    pub(crate) edge_counts: [u64; Pin::PORTS * 16],
    /// Interrupt requests, a bit each.
    pub(crate) irq: u128,
    /// A request came that the core has not seen.
    pub(crate) attention: bool,
    request_cycle: [u64; 128],
    /// Core cycle at which the present slice ends.
    slice_end: u64,
    event_cycle: u64,
    cycle: u64,
    /// A reset that a peripheral asks for.
    pub(crate) reset_request: Option<ResetCause>,
}

struct Model {
    model: Box<dyn RigModel>,
    next: SimTime,
}

impl core::fmt::Debug for Soc {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Soc(at {})", self.now)
    }
}

impl Soc {
    /// The chip at power-on.
    pub(crate) fn new(seed: Seed, lsi: Rate, uid: [u32; 3]) -> Self {
        let rcc = Rcc::new();
        let clocks = rcc.clocks(SimTime::ZERO);
        let mut soc = Self {
            mem: Memory::new(),
            now: SimTime::ZERO,
            core_clock: Clock::new(clocks.hclk, SimTime::ZERO, 0),
            clocks,
            rcc,
            gpio: Gpio::new(),
            exti: Exti::default(),
            tim: [
                Tim::new(false, 4, true),
                Tim::new(true, 4, false),
                Tim::new(false, 4, false),
                Tim::new(false, 4, false),
                Tim::new(true, 4, false),
            ],
            dma: [Dma::default(), Dma::default()],
            i2c: I2c::new(),
            i2c_bus: I2cBus::new(),
            iwdg: Iwdg::new(lsi),
            uart: Uart::new(),
            otg: Otg::new(),
            usb: UsbHost::new(seed),
            plain: BTreeMap::new(),
            uid,
            events: [SimTime::NEVER; EVENTS],
            next_event: SimTime::NEVER,
            models: Vec::new(),
            watchers: [0; Pin::PORTS * 16],
            edge_queue: Vec::new(),
            delivering: false,
            mco_told: None,
            logged: [0; Pin::PORTS],
            edge_log: Vec::new(),
            edge_counts: [0; Pin::PORTS * 16],
            irq: 0,
            attention: false,
            request_cycle: [0; 128],
            slice_end: 0,
            event_cycle: u64::MAX,
            cycle: 0,
            reset_request: None,
        };
        // The bus has pull-ups on the board.
        soc.gpio.drive(Pin::PB6, Drive::PullUp);
        soc.gpio.drive(Pin::PB7, Drive::PullUp);
        soc.after_reset();
        soc
    }

    /// Everything but memory, the outside and time goes back to its reset state.
    pub(crate) fn reset(&mut self, cause: ResetCause) {
        self.rcc.reset(cause);
        self.gpio.reset();
        self.exti = Exti::default();
        for tim in &mut self.tim {
            tim.reset(self.now);
        }
        self.dma = [Dma::default(), Dma::default()];
        self.i2c.reset();
        self.iwdg.reset();
        self.uart.reset();
        self.otg.reset();
        self.plain.clear();
        self.irq = 0;
        self.attention = false;
        self.after_reset();
    }

    fn after_reset(&mut self) {
        self.apply_clocks();
        for port in 0..Pin::PORTS {
            self.update_port(port, 0xffff);
        }
        self.after_usb();
        for n in 0..TIMERS {
            self.reschedule_tim(n);
        }
        self.set_event(EV_I2C, self.i2c.next_event());
        self.set_event(EV_IWDG, self.iwdg.next_event());
        self.set_event(EV_UART, self.uart.next_event());
    }

    /// Adds a model and lets it drive its idle levels.
    pub(crate) fn add_model(&mut self, mut model: Box<dyn RigModel>) {
        let index = self.models.len();
        for pin in model.watched_pins() {
            if index < 64 {
                self.watchers[pin.index()] |= 1 << index;
            }
        }
        let mut drives = Vec::new();
        let mut io = RigIo::new(self.now, &self.gpio.levels, &mut drives);
        model.power_on(&mut io);
        let next = model.next_event().unwrap_or(SimTime::NEVER);
        self.models.push(Model { model, next });
        for (pin, drive) in drives {
            self.drive(pin, drive);
        }
        self.reschedule_models();
    }

    /// Logs the edges of a pin from now on.
    pub(crate) fn log_pin(&mut self, pin: Pin) {
        self.logged[pin.port()] |= 1 << pin.number();
    }

    // ---- time --------------------------------------------------------------

    pub(crate) fn now(&self) -> SimTime {
        self.now
    }

    /// The core stands at `cycle`.
    pub(crate) fn at_cycle(&mut self, cycle: u64) {
        self.cycle = cycle;
        self.advance_to(self.core_clock.time_of(cycle));
    }

    /// The first core cycle that does not begin before `at`.
    pub(crate) fn cycle_at(&self, at: SimTime) -> u64 {
        if at == SimTime::NEVER {
            return u64::MAX;
        }
        let edge = self.core_clock.edge_at(at);
        if self.core_clock.time_of(edge) < at {
            edge + 1
        } else {
            edge
        }
    }

    /// Present rate of the core clock.
    pub(crate) fn core_rate(&self) -> Rate {
        self.clocks.hclk
    }

    /// Lets the core run up to `cycle`, or the next event if that is earlier.
    pub(crate) fn set_slice_end(&mut self, cycle: u64) {
        self.slice_end = cycle;
    }

    /// Where the present slice ends, whatever wants the core's attention.
    pub(crate) fn slice_limit(&self) -> u64 {
        if self.reset_request.is_some() {
            0
        } else {
            self.slice_end.min(self.event_cycle)
        }
    }

    fn set_event(&mut self, source: usize, at: SimTime) {
        if self.events[source] == at {
            return;
        }
        self.events[source] = at;
        let next = self.events.iter().copied().min().unwrap_or(SimTime::NEVER);
        if next != self.next_event {
            self.next_event = next;
            self.event_cycle = self.cycle_at(next);
        }
    }

    /// Does everything that is due up to `now`.
    pub(crate) fn advance_to(&mut self, now: SimTime) {
        while self.next_event <= now {
            let at = self.next_event;
            self.now = self.now.max(at);
            let source = self
                .events
                .iter()
                .position(|e| *e == at)
                .unwrap_or(EV_MODELS);
            match source {
                EV_I2C => self.step_i2c(at),
                EV_UART => {
                    self.uart.advance(at);
                    self.after_uart();
                }
                EV_USB => {
                    self.usb.step(at, &mut self.otg);
                    self.after_usb();
                }
                EV_IWDG => {
                    self.iwdg.reset();
                    self.set_event(EV_IWDG, SimTime::NEVER);
                    self.reset_request = Some(ResetCause::IndependentWatchdog);
                }
                EV_CLOCK => {
                    self.set_event(EV_CLOCK, SimTime::NEVER);
                    self.apply_clocks();
                }
                EV_MODELS => self.step_models(at),
                n => {
                    self.tim[n - EV_TIM].sync(at);
                    self.after_tim(n - EV_TIM);
                }
            }
        }
        self.now = self.now.max(now);
    }

    // ---- interrupts ----------------------------------------------------------

    fn set_irq(&mut self, n: usize, on: bool) {
        let bit = 1u128 << n;
        if on {
            if self.irq & bit == 0 {
                self.irq |= bit;
                self.attention = true;
                self.request_cycle[n] = self.cycle_at(self.now);
            }
        } else {
            self.irq &= !bit;
        }
    }

    /// Core cycle of the request of interrupt `n` that has not been taken yet.
    pub(crate) fn take_request_cycle(&mut self, n: usize) -> Option<u64> {
        let since = self.request_cycle.get_mut(n)?;
        (*since != 0).then(|| std::mem::take(since))
    }

    // ---- after something changed ----------------------------------------------

    fn after_tim(&mut self, n: usize) {
        let (first, second) = self.tim[n].irq();
        match n {
            TIM1 => {
                self.set_irq(25, first);
                self.set_irq(27, second);
            }
            TIM2 => self.set_irq(28, first),
            TIM3 => self.set_irq(29, first),
            TIM4 => self.set_irq(30, first),
            _ => self.set_irq(50, first),
        }
        self.update_timer_pins(n);
        self.reschedule_tim(n);
    }

    fn reschedule_tim(&mut self, n: usize) {
        let at = self.tim[n].next_event();
        self.set_event(EV_TIM + n, at);
    }

    fn after_i2c(&mut self) {
        self.serve_i2c_dma();
        let (event, error) = self.i2c.irq();
        self.set_irq(31, event);
        self.set_irq(32, error);
        let at = self.i2c.next_event();
        self.set_event(EV_I2C, at);
    }

    fn after_uart(&mut self) {
        while self.uart.wants_tx() && self.dma[0].armed(7, 4) {
            let t = self.dma[0].transfer(7);
            let byte = self.mem.read8(t.memory).unwrap_or(0);
            self.dma[0].item_done(7);
            self.uart.write_dr(byte, self.now);
        }
        self.after_dma();
        self.set_irq(53, self.uart.irq());
        let at = self.uart.next_event();
        self.set_event(EV_UART, at);
        self.update_pin(Pin::PC12);
    }

    fn after_usb(&mut self) {
        if self.otg.changed {
            self.usb.step(self.now, &mut self.otg);
        }
        self.set_irq(67, self.otg.irq());
        let at = self.usb.next_event();
        self.set_event(EV_USB, at);
    }

    fn after_dma(&mut self) {
        const IRQ: [[usize; 8]; 2] = [
            [11, 12, 13, 14, 15, 16, 17, 47],
            [56, 57, 58, 59, 60, 68, 69, 70],
        ];
        for (d, irqs) in IRQ.iter().enumerate() {
            for (s, irq) in irqs.iter().enumerate() {
                let on = self.dma[d].irq(s);
                self.set_irq(*irq, on);
            }
        }
    }

    fn after_exti(&mut self) {
        let active = self.exti.active();
        for n in 0..5 {
            self.set_irq(6 + n, active & (1 << n) != 0);
        }
        self.set_irq(23, active & 0x03e0 != 0);
        self.set_irq(40, active & 0xfc00 != 0);
    }

    // ---- I2C and its DMA --------------------------------------------------------

    /// Streams of DMA1 that serve I2C1 (RM0090 table 42, channel 1).
    fn i2c_stream(&self, receive: bool) -> Option<usize> {
        let streams = if receive { [0, 5] } else { [6, 7] };
        streams.into_iter().find(|s| self.dma[0].armed(*s, 1))
    }

    fn step_i2c(&mut self, at: SimTime) {
        let remaining = match self.i2c_stream(true) {
            Some(s) => self.dma[0].remaining(s),
            None => u32::MAX,
        };
        self.i2c.advance(at, &mut self.i2c_bus, remaining);
        self.after_i2c();
        // A target may want to change a pin, such as its interrupt.
        if !self.models.is_empty() {
            self.reschedule_models();
        }
    }

    fn serve_i2c_dma(&mut self) {
        let mut served = false;
        for _ in 0..4 {
            if self.i2c.wants_rx()
                && let Some(s) = self.i2c_stream(true)
            {
                let t = self.dma[0].transfer(s);
                let byte = self.i2c.dma_read(self.now, &mut self.i2c_bus);
                self.mem.write8(t.memory, u32::from(byte));
                self.dma[0].item_done(s);
            } else if self.i2c.wants_tx()
                && let Some(s) = self.i2c_stream(false)
            {
                let t = self.dma[0].transfer(s);
                let byte = self.mem.read8(t.memory).unwrap_or(0);
                self.dma[0].item_done(s);
                self.i2c.write_dr(byte as u8, self.now);
            } else {
                break;
            }
            served = true;
        }
        if served {
            self.after_dma();
        }
    }

    /// The I2C bus was touched from outside (a fault was put on or taken off).
    pub(crate) fn i2c_bus_changed(&mut self) {
        if !self.i2c_bus.is_stuck() {
            self.i2c.bus_released(self.now);
        }
        self.after_i2c();
        self.update_pin(Pin::PB7);
    }

    // ---- clocks -------------------------------------------------------------------

    fn apply_clocks(&mut self) {
        let clocks = self.rcc.clocks(self.now);
        if clocks.hclk != self.clocks.hclk {
            // The present cycle is the first of the new rate.
            self.core_clock =
                Clock::new(clocks.hclk, self.core_clock.time_of(self.cycle), self.cycle);
            self.event_cycle = self.cycle_at(self.next_event);
        }
        let before = std::mem::replace(&mut self.clocks, clocks);
        for n in 0..TIMERS {
            let (old, rate) = if n == TIM1 {
                (before.timers2, clocks.timers2)
            } else {
                (before.timers1, clocks.timers1)
            };
            // A clock that goes on keeps its phase.
            if rate != old {
                self.tim[n].set_clock(rate, self.now);
            }
            self.reschedule_tim(n);
        }
        self.i2c.set_clock(clocks.pclk1);
        self.uart.set_clock(clocks.pclk1);
        self.update_mco();
    }

    /// Rate of the clock that PA8 carries.
    pub(crate) fn mco1(&self) -> Option<Rate> {
        (self.gpio.mode(Pin::PA8) == gpio::Mode::Alternate(0))
            .then_some(self.clocks.mco1)
            .flatten()
    }

    fn update_mco(&mut self) {
        let rate = self.mco1();
        if rate == self.mco_told {
            return;
        }
        self.mco_told = rate;
        for index in 0..self.models.len() {
            if self.watchers[Pin::PA8.index()] & (1 << index) != 0 {
                self.call_model(index, self.now, |model, io| {
                    model.on_clock(Pin::PA8, rate, io)
                });
            }
        }
    }

    // ---- models --------------------------------------------------------------------

    fn call_model(
        &mut self,
        index: usize,
        at: SimTime,
        f: impl FnOnce(&mut dyn RigModel, &mut RigIo<'_>),
    ) {
        let mut drives = Vec::new();
        let levels = self.gpio.levels;
        if let Some(m) = self.models.get_mut(index) {
            let mut io = RigIo::new(at, &levels, &mut drives);
            f(m.model.as_mut(), &mut io);
            m.next = m.model.next_event().unwrap_or(SimTime::NEVER).max(at);
        }
        for (pin, drive) in drives {
            self.drive(pin, drive);
        }
        self.schedule_models();
    }

    fn schedule_models(&mut self) {
        let at = self
            .models
            .iter()
            .map(|m| m.next)
            .min()
            .unwrap_or(SimTime::NEVER);
        self.set_event(EV_MODELS, at);
    }

    /// Asks every model again when it wants to be called.
    pub(crate) fn reschedule_models(&mut self) {
        let now = self.now;
        for m in &mut self.models {
            m.next = m.model.next_event().unwrap_or(SimTime::NEVER).max(now);
        }
        self.schedule_models();
    }

    fn step_models(&mut self, at: SimTime) {
        for index in 0..self.models.len() {
            if self.models.get(index).is_some_and(|m| m.next <= at) {
                self.call_model(index, at, |model, io| model.advance(io));
                // A model that asks for the same time again without an end
                // must not stop the board's time.
                let stuck = self.models.get(index).is_some_and(|m| m.next <= at);
                if stuck && let Some(m) = self.models.get_mut(index) {
                    m.next = SimTime::from_units(at.units() + 1);
                }
            }
        }
        self.schedule_models();
    }

    // ---- the USB host -------------------------------------------------------------------

    pub(crate) fn plug(&mut self) {
        self.usb.plug(self.now, &mut self.otg);
        self.after_usb();
    }

    pub(crate) fn unplug(&mut self) {
        self.usb.unplug(self.now, &mut self.otg);
        self.after_usb();
    }

    pub(crate) fn usb_write(&mut self, bytes: &[u8]) {
        self.usb.write(bytes);
        self.usb_configure(|_| {});
    }

    pub(crate) fn usb_read(&mut self) -> Vec<u8> {
        let bytes = self.usb.take();
        if !bytes.is_empty() {
            self.usb_configure(|_| {});
        }
        bytes
    }

    /// Changes something at the host, which then looks at the bus again.
    pub(crate) fn usb_configure(&mut self, f: impl FnOnce(&mut UsbHost)) {
        f(&mut self.usb);
        self.otg.changed = true;
        self.after_usb();
    }

    // ---- reset ------------------------------------------------------------------------

    /// Fills the RAM with noise, as it is at power-on.
    pub(crate) fn fill_ram(&mut self, random: &mut Random) {
        random.fill(&mut self.mem.sram);
        random.fill(&mut self.mem.ccm);
    }
}

impl Bus for Soc {
    #[inline(always)]
    fn memory(&mut self) -> &mut Memory {
        &mut self.mem
    }

    fn io_read(&mut self, addr: u32, bytes: u32, cycle: u64) -> Option<u32> {
        self.at_cycle(cycle);
        let word = self.read_register(addr & !3)?;
        let shift = (addr & 3) * 8;
        Some(match bytes {
            4 => word,
            2 => (word >> shift) & 0xffff,
            _ => (word >> shift) & 0xff,
        })
    }

    fn io_write(&mut self, addr: u32, bytes: u32, value: u32, cycle: u64) -> bool {
        self.at_cycle(cycle);
        let _ = bytes;
        self.write_register(addr & !3, value << ((addr & 3) * 8))
    }

    #[inline]
    fn limit(&self) -> u64 {
        if self.attention {
            0
        } else {
            self.slice_limit()
        }
    }
}
