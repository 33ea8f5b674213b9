//! Stand-in for the driver of UART5 on chips that have none.

/// No line for sentences: the pulse per second is refused before anything asks for it.
pub(crate) mod nmea_port {
    use protocol::Baud;

    pub(crate) const fn open(_: Baud) {}

    pub(crate) const fn close() {}

    pub(crate) const fn is_idle() -> bool {
        true
    }

    pub(crate) const fn send(_: &str) -> bool {
        false
    }
}
