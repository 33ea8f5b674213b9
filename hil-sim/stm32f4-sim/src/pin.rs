//! Pins of the STM32F407 as one sees them from outside.

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
    ($($port:literal: $($name:ident),*;)*) => {
        impl Pin { $(pins!(@port $port, 0; $($name),*);)* }
    };
    (@port $port:literal, $number:expr; $name:ident $(, $rest:ident)*) => {
        #[doc = concat!("The pin ", stringify!($name), ".")]
        pub const $name: Pin = Pin($port * 16 + $number);
        pins!(@port $port, $number + 1; $($rest),*);
    };
    (@port $port:literal, $number:expr;) => {};
}
pins! {
    0: PA0, PA1, PA2, PA3, PA4, PA5, PA6, PA7, PA8, PA9, PA10, PA11, PA12, PA13, PA14, PA15;
    1: PB0, PB1, PB2, PB3, PB4, PB5, PB6, PB7, PB8, PB9, PB10, PB11, PB12, PB13, PB14, PB15;
    2: PC0, PC1, PC2, PC3, PC4, PC5, PC6, PC7, PC8, PC9, PC10, PC11, PC12, PC13, PC14, PC15;
    3: PD0, PD1, PD2, PD3, PD4, PD5, PD6, PD7, PD8, PD9, PD10, PD11, PD12, PD13, PD14, PD15;
    4: PE0, PE1, PE2, PE3, PE4, PE5, PE6, PE7, PE8, PE9, PE10, PE11, PE12, PE13, PE14, PE15;
    5: PF0, PF1, PF2, PF3, PF4, PF5, PF6, PF7, PF8, PF9, PF10, PF11, PF12, PF13, PF14, PF15;
    6: PG0, PG1, PG2, PG3, PG4, PG5, PG6, PG7, PG8, PG9, PG10, PG11, PG12, PG13, PG14, PG15;
    7: PH0, PH1, PH2, PH3, PH4, PH5, PH6, PH7, PH8, PH9, PH10, PH11, PH12, PH13, PH14, PH15;
    8: PI0, PI1, PI2, PI3, PI4, PI5, PI6, PI7, PI8, PI9, PI10, PI11, PI12, PI13, PI14, PI15;
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
    /// True if the level is high.
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

/// Action of something outside of the microcontroller on a pin.
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
