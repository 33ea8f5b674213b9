//! Events of the timers' handlers, and the queues that pass them on.
//!
//! Those handlers may not touch what critical sections protect. They leave events
//! in lock-free queues and pend an interrupt of normal priority, whose handler puts
//! them where they belong ([`super::handover`]). It is SPI3's, which every chip has and no
//! board uses.

use core::sync::atomic::AtomicU32;

use cortex_m::peripheral::NVIC;
use embassy_stm32::pac;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use firmware::pulser::Pulsed;
use heapless::spsc::Producer;
use protocol::{Capture, Output, Ticks};

pub(crate) const INTERRUPT: pac::Interrupt = pac::Interrupt::SPI3;

/// Capture inputs, as bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Input {
    DataReady = 1,
    Strobe = 2,
}

/// An event of a timer's handler.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Event {
    /// A pulse of an output, or the pulse per second if that is none; with its number in the
    /// stream.
    Pulse(Option<Output>, u32, Pulsed),
    /// An edge of the strobe.
    Capture(Capture),
    DataReady(DataReady),
    /// An input was switched off because of too many edges.
    Flooded(Input),
}

/// A rising edge of the IMU's data-ready.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DataReady {
    pub(crate) at: Ticks,
    pub(crate) after_loss: bool,
}

/// Edges of data-ready, for the IMU's task.
pub(crate) static DATA_READY: Channel<CriticalSectionRawMutex, DataReady, 4> = Channel::new();

/// Edges that found no place in [`DATA_READY`], since reset.
pub(crate) static LOST_DATA_READY: AtomicU32 = AtomicU32::new(0);

/// Inputs that were switched off, for the task that switches them on again.
pub(crate) static FLOODED: Channel<CriticalSectionRawMutex, Input, 4> = Channel::new();

/// The end of a queue that a timer's handler fills, once it is set up.
pub(crate) type Sender = Option<Producer<'static, Event>>;

/// Hands an event over. False if there is no place.
pub(crate) fn send(queue: &mut Sender, event: Event) -> bool {
    NVIC::pend(INTERRUPT);
    queue
        .as_mut()
        .is_some_and(|queue| queue.enqueue(event).is_ok())
}
