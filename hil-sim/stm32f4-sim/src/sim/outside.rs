//! Actions on the board from outside: the USB host, the I2C bus and the pins.

use std::collections::BTreeSet;

use super::{Sim, SimError};
use crate::chip::Soc;
use crate::clock::Rate;
use crate::pin::{Drive, Level, Pin};
use crate::time::{SimDuration, SimTime};
use crate::usb::{DeviceInfo, Handshake, Token, UsbCut, UsbHost, UsbState};

impl Sim {
    // ---- USB ------------------------------------------------------------------------

    /// Progress of the USB host.
    #[must_use]
    pub fn usb_state(&self) -> UsbState {
        self.with_chip(|s| s.usb.state())
    }

    /// Description that the device gave of itself.
    #[must_use]
    pub fn usb_device(&self) -> DeviceInfo {
        self.with_chip(|s| s.usb.device().clone())
    }

    /// Observations of the USB host, with their times.
    #[must_use]
    pub fn usb_log(&self) -> Vec<(SimTime, String)> {
        self.with_chip(|s| s.usb.log().to_vec())
    }

    /// Runs until the serial port can be used, for at most `limit`. Returns whether it can.
    ///
    /// # Errors
    ///
    /// If the firmware fails and that is not tolerated.
    pub fn run_until_usb_ready(&mut self, limit: SimDuration) -> Result<bool, SimError> {
        self.run_until(limit, |sim| sim.usb_state() == UsbState::Ready)
    }

    /// Queues bytes for the serial port.
    pub fn usb_write(&mut self, bytes: &[u8]) {
        self.with_chip(|s| s.usb_write(bytes));
    }

    /// Bytes queued that have not gone over the bus.
    #[must_use]
    pub fn usb_unsent(&self) -> usize {
        self.with_chip(|s| s.usb.unsent())
    }

    /// Takes the bytes that have come from the serial port.
    pub fn usb_read(&mut self) -> Vec<u8> {
        self.with_chip(Soc::usb_read)
    }

    /// Pulls the USB cable out. The board stays powered.
    pub fn usb_unplug(&mut self) {
        self.with_chip(Soc::unplug);
    }

    /// Plugs the USB cable in.
    pub fn usb_plug(&mut self) {
        self.with_chip(Soc::plug);
    }

    /// Resets the USB bus at once, as the host does, and enumerates the device again.
    pub fn usb_reset_bus(&mut self) {
        self.with_chip(Soc::reset_bus);
    }

    /// Stops all USB traffic for a time, as in a computer's sleep, and then resets the bus.
    pub fn usb_suspend(&mut self, length: SimDuration) {
        self.with_chip(|s| s.suspend_bus(length));
    }

    /// The core's transmitter answers no token until the next bus reset.
    pub fn usb_wedge_transmit(&mut self) {
        self.with_chip(|s| s.otg.wedge());
    }

    /// Opens or closes the port at the host (DTR and RTS).
    pub fn usb_open(&mut self, open: bool) {
        self.with_chip(|s| s.usb_configure(|u| u.set_open(open)));
    }

    /// Has the host clear the halts of the bulk endpoints when it opens the port, as FreeBSD does.
    pub fn usb_clear_halts_on_open(&mut self) {
        self.with_chip(|s| s.usb_configure(|u| u.set_clears_halts(true)));
    }

    /// Has the host set the configuration again.
    pub fn usb_configure_again(&mut self) {
        self.with_chip(|s| s.usb_configure(|u| u.configure_again()));
    }

    /// Has the host end a control transfer: after this number of further transactions of control
    /// transfers, and then a time.
    pub fn usb_cut(&mut self, what: UsbCut, transactions: u32, delay: SimDuration) {
        self.with_chip(|s| s.usb_configure(|u| u.cut(what, transactions, delay)));
    }

    /// Lets the host ask for data, or hang.
    pub fn usb_set_reading(&mut self, reading: bool) {
        self.with_chip(|s| s.usb_configure(|u| u.set_reading(reading)));
    }

    /// The host stops asking for data while this many bytes wait to be taken.
    pub fn usb_set_buffer_limit(&mut self, bytes: usize) {
        self.with_chip(|s| s.usb_configure(|u| u.set_buffer_limit(bytes)));
    }

    /// Flips a bit in this number of a million bytes on their way (0 for none).
    pub fn usb_corrupt(&mut self, from_device_ppm: u32, to_device_ppm: u32) {
        self.with_chip(|s| s.usb_configure(|u| u.set_corruption(from_device_ppm, to_device_ppm)));
    }

    // ---- USB, by another host than the simulated one --------------------------------

    /// Takes the bus from the simulated host, until the cable is pulled.
    pub fn usb_take_over(&mut self) {
        self.with_chip(|s| s.usb_configure(UsbHost::leave));
    }

    /// True if the device shows its pull-up.
    #[must_use]
    pub fn usb_is_attached(&self) -> bool {
        self.with_chip(|s| s.otg.attached())
    }

    /// Begins a reset of the bus, or ends it.
    pub fn usb_drive_reset(&mut self, begins: bool) {
        self.with_chip(|s| {
            if begins {
                s.otg.bus_reset();
            } else {
                s.otg.enumerated();
            }
            s.usb_configure(|_| {});
        });
    }

    /// Makes a transaction.
    pub fn usb_transact(&mut self, token: Token<'_>) -> Handshake {
        self.with_chip(|s| {
            let answer = match token {
                Token::Setup(setup) => s.otg.setup(setup),
                Token::In(endpoint) => s.otg.take_in(endpoint.into()),
                Token::Out(endpoint, data, toggle) => s.otg.out(endpoint.into(), data, toggle),
            };
            s.usb_configure(|_| {});
            answer
        })
    }

    /// Data toggle of the next packet of an IN endpoint.
    #[must_use]
    pub fn usb_in_toggle(&self, endpoint: u8) -> bool {
        self.with_chip(|s| s.otg.in_toggle(endpoint.into()))
    }

    // ---- the I2C bus -----------------------------------------------------------------

    /// Holds SDA of the I2C bus low, or lets it go. Clock pulses do not free it.
    pub fn hold_sda(&mut self, held: bool) {
        self.with_chip(|s| {
            s.i2c_bus.hold_sda(held);
            s.i2c_bus_changed();
        });
    }

    // ---- pins --------------------------------------------------------------------------

    /// Drives a pin from outside.
    pub fn drive(&mut self, pin: Pin, drive: Drive) {
        self.with_chip(|s| s.drive(pin, drive));
    }

    /// Level of a pin.
    #[must_use]
    pub fn level(&self, pin: Pin) -> Level {
        Level::from(self.with_chip(|s| s.gpio.level(pin)))
    }

    /// True if the chip pulls a pin up or down.
    #[must_use]
    pub fn is_pulled(&self, pin: Pin) -> bool {
        self.with_chip(|s| s.gpio.is_pulled(pin))
    }

    /// Logs the edges of a pin from now on, for [`Sim::take_edges`].
    pub fn log_pin(&mut self, pin: Pin) {
        self.with_chip(|s| s.log_pin(pin));
    }

    /// Takes the edges of the logged pins in the order of their time.
    pub fn take_edges(&mut self) -> Vec<(Pin, Level, SimTime)> {
        self.with_chip(|s| std::mem::take(&mut s.edge_log))
    }

    /// Edges that a pin has made since power-on.
    #[must_use]
    pub fn edge_count(&self, pin: Pin) -> u64 {
        self.with_chip(|s| s.edge_counts[pin.index()])
    }

    /// Rate of the clock on PA8 (MCO1), if it carries one.
    #[must_use]
    pub fn clock_output(&self) -> Option<Rate> {
        self.with_chip(|s| s.mco1())
    }

    /// A stored register ([`stored_registers`](super::stored_registers)) as it was written.
    #[must_use]
    pub fn stored_register(&self, address: u32) -> Option<u32> {
        self.with_chip(|s| s.stored(address))
    }

    /// Names of the stored registers that the firmware wrote since their reset.
    #[must_use]
    pub fn stored_writes(&self) -> BTreeSet<&'static str> {
        self.with_chip(|s| s.stored_writes().collect())
    }

    /// Number of bus errors that the I2C peripheral reported where there was none
    /// ([`SimBuilder::spurious_bus_errors`](super::SimBuilder::spurious_bus_errors)).
    #[must_use]
    pub fn spurious_bus_errors(&self) -> u64 {
        self.with_chip(|s| s.spurious_bus_errors())
    }

    /// The number that the chip's random number generator gave last.
    #[must_use]
    pub fn random_number(&self) -> Option<u32> {
        self.with_chip(|s| s.rng.last)
    }

    /// Stops the crystal, or lets it swing again.
    pub fn set_crystal(&mut self, swings: bool) {
        self.with_chip(|s| s.set_crystal(swings));
    }

    /// Sets the chip's supply from now on, in V.
    pub fn set_supply(&mut self, volts: f64) {
        self.with_chip(|s| s.adc.set_supply(volts));
    }

    /// Takes a debug probe off, which leaves the debug unit off (probe-rs clears DEMCR).
    pub fn detach_probe(&mut self) {
        self.cpu.detach_probe();
    }

    /// Leaves debugging and its catch of faults on, as st-flash may: from the next reset on, a
    /// fault halts the core unless the program takes the catch back.
    pub fn leave_fault_catch(&mut self) {
        self.cpu.leave_fault_catch();
    }

    /// Halts the core, as a debugger does, and lets it go on. Clocks, timers and DMA
    /// run on.
    pub fn halt_core(&mut self, length: SimDuration) {
        let end = self.now() + length;
        let cycle = self.with_chip(|s| s.cycle_at(end));
        self.cpu.sleep_until(cycle);
        self.with_chip(|s| s.at_cycle(cycle));
    }

    /// Models that changed when they want to be called outside of their own
    /// calls (a test that works on one) have to be asked again.
    pub fn models_changed(&mut self) {
        self.with_chip(Soc::reschedule_models);
    }
}
