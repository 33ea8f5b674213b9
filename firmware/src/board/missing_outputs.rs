//! What chips without UART5 and random number generator have in place of their drivers.

/// No line for sentences: the pulse per second is refused before anything asks for it.
pub(crate) mod nmea_port {
    use protocol::Baud;

    pub(crate) const fn init() {}

    pub(crate) const fn open(_: Baud) {}

    pub(crate) const fn close() {}

    pub(crate) const fn is_idle() -> bool {
        true
    }

    pub(crate) const fn send(_: &str) -> bool {
        false
    }
}

/// No random numbers: the number of the first run is what memory held at power-on.
pub(crate) mod rng {
    pub(crate) const fn number() -> Option<u32> {
        None
    }
}
