//! GPIO ports and the pins' levels (RM0090 chapter 8).

use crate::pin::{Drive, Pin};

/// Function of a pin as its MODER says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    Input,
    Output,
    /// Alternate function of the given number.
    Alternate(u8),
    Analog,
}

#[derive(Clone, Copy, Debug, Default)]
struct Port {
    moder: u32,
    otyper: u32,
    pupdr: u32,
    odr: u32,
    afr: [u32; 2],
}

/// All ports and what is driven from outside on their pins.
#[derive(Debug)]
pub(crate) struct Gpio {
    ports: [Port; Pin::PORTS],
    outside: [[Drive; 16]; Pin::PORTS],
    /// Voltage of a high level from outside, in V, where it is not the supply's.
    pub(crate) volts: [Option<f64>; Pin::PORTS * 16],
    /// Levels as last computed, a word a port.
    pub(crate) levels: [u16; Pin::PORTS],
}

impl Gpio {
    pub(crate) fn new() -> Self {
        let mut gpio = Self {
            ports: [Port::default(); Pin::PORTS],
            outside: [[Drive::Floating; 16]; Pin::PORTS],
            volts: [None; Pin::PORTS * 16],
            levels: [0; Pin::PORTS],
        };
        gpio.reset();
        gpio
    }

    /// Registers after a reset; what drives the pins stays.
    pub(crate) fn reset(&mut self) {
        for port in 0..Pin::PORTS {
            self.reset_port(port);
        }
    }

    /// Registers of one port after a reset.
    pub(crate) fn reset_port(&mut self, port: usize) {
        // The debug pins start as alternate functions (RM0090 8.4.1 to 8.4.4).
        let (moder, pupdr) = match port {
            0 => (0xa800_0000, 0x6400_0000),
            1 => (0x0000_0280, 0x0000_0100),
            _ => (0, 0),
        };
        self.ports[port] = Port {
            moder,
            pupdr,
            ..Port::default()
        };
    }

    /// PA11 and PA12 are left to the USB core.
    pub(crate) fn leave_usb(&mut self) {
        let port = &mut self.ports[0];
        port.moder |= 0xa << 22;
        port.afr[1] |= 0xaa << 12;
    }

    pub(crate) fn drive(&mut self, pin: Pin, drive: Drive) {
        self.outside[pin.port()][pin.number()] = drive;
    }

    pub(crate) fn outside(&self, pin: Pin) -> Drive {
        self.outside[pin.port()][pin.number()]
    }

    pub(crate) fn mode(&self, pin: Pin) -> Mode {
        let port = &self.ports[pin.port()];
        let n = pin.number();
        match (port.moder >> (n * 2)) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => Mode::Alternate(((port.afr[n / 8] >> ((n % 8) * 4)) & 0xf) as u8),
            _ => Mode::Analog,
        }
    }

    /// True if the chip pulls the pin up or down.
    pub(crate) fn is_pulled(&self, pin: Pin) -> bool {
        (self.ports[pin.port()].pupdr >> (pin.number() * 2)) & 3 != 0
    }

    pub(crate) fn is_open_drain(&self, pin: Pin) -> bool {
        self.ports[pin.port()].otyper & (1 << pin.number()) != 0
    }

    pub(crate) fn odr(&self, pin: Pin) -> bool {
        self.ports[pin.port()].odr & (1 << pin.number()) != 0
    }

    /// Level of a pin when the microcontroller itself drives `own` on it.
    pub(crate) fn resolve(&self, pin: Pin, own: Option<bool>) -> bool {
        match own {
            Some(false) => false,
            Some(true) if !self.is_open_drain(pin) => true,
            _ => match self.outside(pin) {
                Drive::High | Drive::PullUp => true,
                Drive::Low | Drive::PullDown => false,
                Drive::Floating => (self.ports[pin.port()].pupdr >> (pin.number() * 2)) & 3 == 1,
            },
        }
    }

    pub(crate) fn set_level(&mut self, pin: Pin, high: bool) -> bool {
        let bit = 1 << pin.number();
        let word = &mut self.levels[pin.port()];
        let was = *word & bit != 0;
        if high {
            *word |= bit;
        } else {
            *word &= !bit;
        }
        was != high
    }

    pub(crate) fn level(&self, pin: Pin) -> bool {
        self.levels[pin.port()] & (1 << pin.number()) != 0
    }

    pub(crate) fn read(&self, port: usize, offset: u32) -> Option<u32> {
        let p = &self.ports[port];
        Some(match offset {
            0x00 => p.moder,
            0x04 => p.otyper,
            0x0c => p.pupdr,
            0x10 => u32::from(self.levels[port]),
            0x14 => p.odr,
            0x18 => 0,
            0x20 => p.afr[0],
            0x24 => p.afr[1],
            _ => return None,
        })
    }

    /// Writes a register and returns the pins (a bit each) that it may have changed.
    pub(crate) fn write(&mut self, port: usize, offset: u32, value: u32) -> Option<u16> {
        let p = &mut self.ports[port];
        // Pins of which a field of `width` bits changed.
        let changed = |old: u32, new: u32, width: u32| -> u16 {
            let diff = old ^ new;
            let mut pins = 0;
            for n in 0..(32 / width) {
                if (diff >> (n * width)) & ((1 << width) - 1) != 0 {
                    pins |= 1 << n;
                }
            }
            pins
        };
        Some(match offset {
            0x00 => {
                let c = changed(p.moder, value, 2);
                p.moder = value;
                c
            }
            0x04 => {
                let c = (p.otyper ^ value) as u16;
                p.otyper = value & 0xffff;
                c
            }
            0x0c => {
                let c = changed(p.pupdr, value, 2);
                p.pupdr = value;
                c
            }
            0x14 => {
                let c = (p.odr ^ value) as u16;
                p.odr = value & 0xffff;
                c
            }
            0x18 => {
                let new = (p.odr & !(value >> 16)) | (value & 0xffff);
                let c = (p.odr ^ new) as u16;
                p.odr = new;
                c
            }
            0x20 | 0x24 => {
                let half = ((offset - 0x20) / 4) as usize;
                let c = changed(p.afr[half], value, 4);
                p.afr[half] = value;
                c << (half * 8)
            }
            _ => return None,
        })
    }
}
