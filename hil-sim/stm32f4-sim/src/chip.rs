//! The STM32F407 without its core: buses, peripherals, pins and their events.
//!
//! A peripheral does nothing between two events that something could notice.
//! Each says when its next event is; [`Soc`] keeps the earliest, and the core
//! runs (or sleeps) up to it. An access of the core to a peripheral first does
//! what is due by then, so that every register reads as of its very cycle.

pub(crate) mod adc;
pub(crate) mod cells;
mod clock_tree;
pub(crate) mod dma;
mod events;
mod flash;
pub(crate) mod gpio;
pub(crate) mod i2c;
pub(crate) mod iwdg;
pub(crate) mod map;
pub(crate) mod memory;
mod models;
mod names;
pub(crate) mod otg;
pub(crate) mod part;
pub(crate) mod pins;
pub(crate) mod rcc;
pub(crate) mod rng;
pub(crate) mod rules;
mod serial;
pub(crate) mod tim;
mod tim_dma;
pub(crate) mod uart;
mod waits;

use crate::bus::Bus;
use crate::clock::{Clock, Rate};
use crate::i2c_bus::I2cBus;
use crate::pin::{Drive, Level, Pin};
use crate::random::{BUS_ERROR_STREAM, RNG_STREAM, Random, Seed};
use crate::time::{SimDuration, SimTime};
use crate::usb::UsbHost;

use adc::{Adc, Die};
use cells::Cells;
use dma::Dma;
use events::{Events, Source};
use flash::FlashControl;
use gpio::Gpio;
use i2c::{BusErrors, I2c};
use iwdg::Iwdg;
use memory::Memory;
use models::Model;
use otg::Otg;
use part::Part;
use rcc::{Clocks, Rcc, ResetCause};
use rng::Rng;
use rules::End;
use tim::Tim;
use uart::Uart;
use waits::Waits;

/// Timers of the model, by index.
pub(crate) const TIM1: usize = 0;
pub(crate) const TIM2: usize = 1;
pub(crate) const TIM3: usize = 2;
pub(crate) const TIM4: usize = 3;
pub(crate) const TIM5: usize = 4;
const TIMERS: usize = 5;

/// Number of the specimen, in the system memory: it says what it is, so that nobody takes a
/// simulated recording for one of a real board.
const UNIQUE_ID: [u32; 3] = [
    u32::from_le_bytes(*b"SIMU"),
    u32::from_le_bytes(*b"LATE"),
    u32::from_le_bytes(*b"D 01"),
];

/// Where an I2C bus is wired to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct I2cWires {
    pub(crate) scl: Pin,
    pub(crate) sda: Pin,
}

/// Surroundings of the chip, and properties that differ from one specimen to the next.
#[derive(Clone, Copy, Debug)]
pub struct ChipConfig {
    /// Which chip it is.
    pub part: Part,
    /// Frequency of the crystal; without one the external oscillator never starts.
    pub crystal: Option<Rate>,
    /// Wires of I2C1's bus.
    pub(crate) i2c: Option<I2cWires>,
    /// Probability that the I2C reports a bus error without one, for each byte (ES0182 2.10.1).
    pub bus_errors: f64,
    /// Clocks that the synchroniser of a timer's input takes.
    pub synchroniser: u64,
    /// Revision of the chip.
    pub revision: Revision,
    /// The random number generator reports a seed error.
    pub broken_rng: bool,
    /// Temperature and supply.
    pub die: Die,
    /// Time without its USB pull-up before which the chip is not seen when it comes back. Drivers
    /// that know of none work on most chips; some were not enumerated (Zephyr #108825).
    pub shortest_detach: SimDuration,
}

/// Revision of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Revision {
    /// The first: its flash accelerator cannot prefetch, and it gives the STM32F2's
    /// device ID (ES0182).
    A,
    /// The revision of current chips.
    Y,
}

impl Revision {
    /// DBGMCU_IDCODE.
    fn id(self) -> u32 {
        match self {
            Self::A => 0x2000_6411,
            Self::Y => 0x100f_6413,
        }
    }
}

/// Receivers of edges besides the models.
pub(crate) type EdgeLog = Vec<(Pin, Level, SimTime)>;

/// The chip and what is wired to its pins.
pub(crate) struct Soc {
    pub(crate) mem: Memory,
    now: SimTime,
    core_clock: Clock,
    clocks: Clocks,
    waits: Waits,
    /// Where rsemu's present instruction is, and for how many clocks its accesses wait.
    pub(crate) instruction: u32,
    pub(crate) waited: u64,
    rcc: Rcc,
    pub(crate) gpio: Gpio,
    tim: [Tim; TIMERS],
    dma: [Dma; 2],
    i2c: I2c,
    pub(crate) i2c_bus: I2cBus,
    iwdg: Iwdg,
    uart: Uart,
    pub(crate) rng: Rng,
    pub(crate) adc: Adc,
    flash: FlashControl,
    part: Part,
    revision: Revision,
    pub(crate) otg: Otg,
    pub(crate) usb: UsbHost,
    cells: Cells,
    /// Reason to end the run, independent of what is tolerated.
    pub(crate) end: Option<End>,
    /// Where the I2C bus is wired to, if it is.
    i2c_wires: Option<I2cWires>,
    uid: [u32; 3],
    events: Events,
    /// The models; taken out while they are called.
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
    /// The chip asks for the NMI.
    pub(crate) nmi: bool,
    /// A request came that the core has not seen.
    pub(crate) attention: bool,
    /// Core cycle at which the present slice ends.
    slice_end: u64,
    event_cycle: u64,
    cycle: u64,
    /// A reset that a peripheral asks for.
    pub(crate) reset_request: Option<ResetCause>,
}

impl core::fmt::Debug for Soc {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Soc(at {})", self.now)
    }
}

impl Soc {
    /// The chip at power-on.
    pub(crate) fn new(seed: Seed, config: &ChipConfig) -> Self {
        let rcc = Rcc::new(config.crystal);
        let clocks = rcc.clocks(SimTime::ZERO);
        let mut soc = Self {
            mem: config.part.memory(),
            part: config.part,
            now: SimTime::ZERO,
            core_clock: Clock::new(clocks.hclk, SimTime::ZERO, 0),
            clocks,
            waits: Waits::default(),
            instruction: 0,
            waited: 0,
            rcc,
            gpio: Gpio::new(),
            tim: [
                Tim::new(false, true, config.synchroniser),
                Tim::new(true, false, config.synchroniser),
                Tim::new(false, false, config.synchroniser),
                Tim::new(false, false, config.synchroniser),
                Tim::new(true, false, config.synchroniser),
            ],
            dma: [Dma::default(), Dma::default()],
            i2c: I2c::new(BusErrors {
                random: seed.stream(BUS_ERROR_STREAM),
                probability: config.bus_errors,
            }),
            i2c_bus: I2cBus::default(),
            iwdg: Iwdg::new(),
            uart: Uart::new(),
            rng: Rng::new(seed.stream(RNG_STREAM)),
            adc: Adc::new(config.die, config.part.temperature_channel()),
            flash: FlashControl::default(),
            revision: config.revision,
            otg: Otg::new(),
            usb: UsbHost::new(seed),
            cells: Cells::default(),
            end: None,
            i2c_wires: config.i2c,
            uid: UNIQUE_ID,
            events: Events::new(),
            models: Vec::new(),
            watchers: [0; Pin::PORTS * 16],
            edge_queue: Vec::new(),
            delivering: false,
            mco_told: None,
            logged: [0; Pin::PORTS],
            edge_log: Vec::new(),
            edge_counts: [0; Pin::PORTS * 16],
            irq: 0,
            nmi: false,
            attention: false,
            slice_end: 0,
            event_cycle: u64::MAX,
            cycle: 0,
            reset_request: None,
        };
        soc.rng.broken = config.broken_rng;
        soc.usb.shortest_detach = config.shortest_detach;
        if let Some(wires) = config.i2c {
            // An I2C bus has pull-ups.
            soc.gpio.drive(wires.scl, Drive::PullUp);
            soc.gpio.drive(wires.sda, Drive::PullUp);
        }
        soc.after_reset();
        soc
    }

    /// Everything but memory, the outside and time goes back to its reset state.
    pub(crate) fn reset(&mut self, cause: ResetCause) {
        self.rcc.reset(cause);
        self.gpio.reset();
        for tim in &mut self.tim {
            tim.reset(self.now);
        }
        self.dma = [Dma::default(), Dma::default()];
        self.set_event(Source::TimDma, SimTime::NEVER);
        self.i2c.reset();
        self.iwdg.reset();
        self.uart.reset();
        self.rng.reset();
        self.adc.reset();
        self.flash = FlashControl::default();
        self.otg.reset();
        self.cells.clear();
        self.irq = 0;
        self.nmi = false;
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
        self.set_event(Source::I2c, self.i2c.next_event());
        self.set_event(Source::Watchdog, self.iwdg.next_event());
        self.set_event(Source::Uart, self.uart.next_event());
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

    /// End of the present slice, at which the core's attention is due.
    pub(crate) fn slice_limit(&self) -> u64 {
        if self.reset_request.is_some() || self.end.is_some() {
            0
        } else {
            self.slice_end.min(self.event_cycle)
        }
    }

    fn set_event(&mut self, source: Source, at: SimTime) {
        if self.events.set(source, at) {
            self.event_cycle = self.cycle_at(self.events.next());
        }
    }

    /// Does everything that is due up to `now`.
    pub(crate) fn advance_to(&mut self, now: SimTime) {
        while self.events.next() <= now {
            let at = self.events.next();
            self.now = self.now.max(at);
            match self.events.first() {
                Source::Tim(n) => {
                    self.tim[n].sync(at);
                    self.after_tim(n);
                }
                Source::TimDma => self.serve_timers(),
                Source::I2c => self.step_i2c(at),
                Source::Uart => {
                    self.uart.advance(at);
                    self.after_uart();
                }
                Source::Usb => {
                    self.usb.step(at, &mut self.otg);
                    self.after_usb();
                }
                Source::Watchdog => {
                    self.iwdg.reset();
                    self.set_event(Source::Watchdog, SimTime::NEVER);
                    self.reset_request = Some(ResetCause::IndependentWatchdog);
                }
                Source::Clock => {
                    self.set_event(Source::Clock, SimTime::NEVER);
                    self.apply_clocks();
                }
                Source::Models => self.step_models(at),
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
            }
        } else {
            self.irq &= !bit;
        }
    }

    // ---- after something changed ----------------------------------------------

    fn after_tim(&mut self, n: usize) {
        self.set_timer_irqs(n);
        self.update_timer_pins(n);
        self.reschedule_tim(n);
        self.ask_for_timers();
    }

    /// After a capture, which does not change the timer's pins.
    fn after_capture(&mut self, n: usize) {
        self.set_timer_irqs(n);
        self.reschedule_tim(n);
        self.ask_for_timers();
    }

    fn set_timer_irqs(&mut self, n: usize) {
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
    }

    fn reschedule_tim(&mut self, n: usize) {
        let at = self.tim[n].next_event();
        self.set_event(Source::Tim(n), at);
    }

    fn after_usb(&mut self) {
        if self.otg.changed {
            self.usb.step(self.now, &mut self.otg);
        }
        if self.otg.attached() {
            self.require_pins(&[Pin::PA11, Pin::PA12], 10, "OTG_FS");
        }
        self.set_irq(67, self.otg.irq());
        let at = self.usb.next_event();
        self.set_event(Source::Usb, at);
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

    // ---- the USB host -------------------------------------------------------------------

    pub(crate) fn plug(&mut self) {
        self.usb.plug(self.now, &mut self.otg);
        self.after_usb();
    }

    pub(crate) fn unplug(&mut self) {
        self.usb.unplug(self.now, &mut self.otg);
        self.after_usb();
    }

    pub(crate) fn reset_bus(&mut self) {
        self.usb.reset_bus(self.now, &mut self.otg);
        self.after_usb();
    }

    pub(crate) fn suspend_bus(&mut self, length: SimDuration) {
        self.usb.suspend(self.now, length, &mut self.otg);
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

    /// The crystal stops, or swings again.
    pub(crate) fn set_crystal(&mut self, swings: bool) {
        match self.rcc.set_crystal(swings) {
            Some(true) => (self.nmi, self.attention) = (true, true),
            Some(false) => self.forbid(rules::Rule::UnwatchedCrystal),
            None => {}
        }
        self.apply_clocks();
    }

    /// The chip as the ROM's bootloader leaves it after a download.
    pub(crate) fn leave_as_rom(&mut self) {
        self.rcc.leave_as_rom(self.now);
        // One wait state, prefetch and caches.
        self.cells.write(rules::FLASH_ACR, 0x601);
        self.flash.leave_unlocked();
        self.otg.leave_as_rom();
        self.gpio.leave_usb();
        self.after_reset();
    }

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
    fn io_waits(&self, addr: u32) -> u64 {
        self.waits.at(addr)
    }

    #[inline]
    fn flash_waits(&self) -> u64 {
        self.waits.flash
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
