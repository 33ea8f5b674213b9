//! Pins of the STM32F407 as the rig sees them.

use core::fmt;

/// One pin of the microcontroller: port A to I, number 0 to 15.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pin(u8);

impl Pin {
    /// Ports that exist (A to I).
    pub const PORTS: usize = 9;

    /// Pin `number` (0 to 15) of port `port` (0 is A), or nothing if there is no such pin.
    #[must_use]
    pub const fn new(port: u8, number: u8) -> Option<Pin> {
        if (port as usize) < Self::PORTS && number < 16 {
            Some(Pin(port * 16 + number))
        } else {
            None
        }
    }

    /// Port index; 0 is A.
    #[must_use]
    pub const fn port(self) -> usize {
        (self.0 / 16) as usize
    }

    /// Number within the port.
    #[must_use]
    pub const fn number(self) -> usize {
        (self.0 % 16) as usize
    }

    /// Index over all ports: port · 16 + number.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

macro_rules! pins {
    ($($(#[$doc:meta])* $name:ident = $port:expr, $number:expr;)*) => {
        impl Pin { $($(#[$doc])* pub const $name: Pin = Pin($port * 16 + $number);)* }
    };
}
pins! {
    /// TIM2 CH2: data-ready of the IMU.
    PA1 = 0, 1;
    /// TIM2 CH3: strobe input.
    PA2 = 0, 2;
    /// TIM2 CH4: trigger read-back.
    PA3 = 0, 3;
    /// TIM2 CH1: camera trigger.
    PA5 = 0, 5;
    /// MCO1: clock of the IMU.
    PA8 = 0, 8;
    /// USB D-.
    PA11 = 0, 11;
    /// USB D+.
    PA12 = 0, 12;
    /// I2C1 clock.
    PB6 = 1, 6;
    /// I2C1 data.
    PB7 = 1, 7;
    /// UART5 transmit: NMEA for a lidar.
    PC12 = 2, 12;
    /// LED: IMU alive.
    PD12 = 3, 12;
    /// LED: pulse.
    PD13 = 3, 13;
    /// LED: fault.
    PD14 = 3, 14;
    /// LED: host linked.
    PD15 = 3, 15;
    /// TIM1 CH1: pulse per second.
    PE9 = 4, 9;
    /// TIM1 CH2: trigger output 2.
    PE11 = 4, 11;
    /// TIM1 CH3: trigger output 3.
    PE13 = 4, 13;
    /// TIM1 CH4: trigger output 4.
    PE14 = 4, 14;
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", (b'A' + self.0 / 16) as char, self.number())
    }
}

impl fmt::Debug for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl core::str::FromStr for Pin {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let bad = || format!("'{s}' is not a pin: expected a name such as PA5 or PD12");
        let rest = s.strip_prefix(['P', 'p']).ok_or_else(bad)?;
        let mut chars = rest.chars();
        let port = chars.next().ok_or_else(bad)?.to_ascii_uppercase();
        let number: u8 = chars.as_str().parse().map_err(|_| bad())?;
        let port = u8::try_from(port)
            .ok()
            .and_then(|p| p.checked_sub(b'A'))
            .ok_or_else(bad)?;
        Pin::new(port, number).ok_or_else(bad)
    }
}

/// Logic level of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Level {
    /// Below the threshold.
    #[default]
    Low,
    /// Above the threshold.
    High,
}

impl Level {
    /// Whether the level is high.
    #[must_use]
    pub const fn is_high(self) -> bool {
        matches!(self, Level::High)
    }
}

impl From<bool> for Level {
    fn from(high: bool) -> Self {
        if high { Level::High } else { Level::Low }
    }
}

/// What something outside of the microcontroller does to a pin.
///
/// Against a push-pull output of the microcontroller the output wins (the
/// model has no short circuits); against an open-drain output a low wins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Drive {
    /// Nothing connected: the pin's own pull resistor decides, else low.
    #[default]
    Floating,
    /// A resistor to the supply: high unless someone drives low.
    PullUp,
    /// A resistor to ground: low unless someone drives high.
    PullDown,
    /// Driven low.
    Low,
    /// Driven high.
    High,
}

impl From<Level> for Drive {
    fn from(level: Level) -> Self {
        match level {
            Level::Low => Drive::Low,
            Level::High => Drive::High,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_both_ways() {
        assert_eq!("PA5".parse::<Pin>().unwrap(), Pin::PA5);
        assert_eq!(Pin::PD12.to_string(), "PD12");
        assert!("PA16".parse::<Pin>().is_err());
        assert!("X1".parse::<Pin>().is_err());
        assert!("P".parse::<Pin>().is_err());
        assert!("PZ1".parse::<Pin>().is_err());
    }
}
