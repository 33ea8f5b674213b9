//! Stand-ins for drivers of what a chip does not have.

/// No line for sentences: the pulse per second is refused before anything asks for it.
pub(crate) mod nmea_port {
    use core::marker::PhantomData;

    use protocol::Baud;

    use crate::hardware::resources::Sentences;

    pub(crate) struct Port<'a>(PhantomData<&'a mut Sentences>);

    pub(crate) const fn open(_: &mut Sentences, _: Baud) -> Port<'_> {
        Port(PhantomData)
    }

    impl Port<'_> {
        pub(crate) async fn send(&mut self, _: &str) -> bool {
            false
        }
    }
}

/// No random numbers.
pub(crate) mod rng {
    use crate::hardware::resources::Random;

    pub(crate) const fn number(_: Random) -> Option<u32> {
        None
    }
}
