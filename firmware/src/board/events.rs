//! From TIM2's handler to the tasks.
//!
//! TIM2's handler may not touch what critical sections protect. It leaves events
//! in a lock-free queue and pends this handler, of normal priority, which puts
//! them where they belong. The interrupt is DCMI's: the camera interface is not
//! used on this board.

#![allow(unsafe_code, reason = "unmasks the interrupt")]

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt;
use embassy_stm32::pac;
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use firmware::config;
use firmware::pulser::Pulsed;
use heapless::spsc::{Consumer, Producer, Queue};
use protocol::{
    Arrived, Capture, Output, OutputArrived, OutputPulse, Pps, Pulse, TickDelta, Ticks,
};
use static_cell::StaticCell;

use crate::board::leds::{self, Led};
use crate::board::outputs::{self, OutputEvent};
use crate::state;
use crate::tasks;

/// The interrupt that this handler takes.
pub(crate) const INTERRUPT: pac::Interrupt = pac::Interrupt::DCMI;

/// Capture inputs, as bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Input {
    /// The IMU's data-ready.
    DataReady = 1,
    /// The strobe.
    Strobe = 2,
}

/// What TIM2's handler has to say.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Event {
    /// A pulse of the trigger, with its number in the stream.
    Pulse(u32, Pulsed),
    /// An edge of the strobe.
    Capture(Capture),
    /// Data-ready of the IMU rose.
    DataReady { at: Ticks, after_loss: bool },
    /// An input was switched off because of too many edges.
    Flooded(Input),
}

/// An edge of data-ready.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DataReady {
    pub(crate) at: Ticks,
    pub(crate) after_loss: bool,
}

/// Edges of data-ready, for the IMU's task.
pub(crate) static DATA_READY: Channel<CriticalSectionRawMutex, DataReady, 4> = Channel::new();

/// Inputs that were switched off, for the task that switches them on again.
pub(crate) static FLOODED: Channel<CriticalSectionRawMutex, Input, 4> = Channel::new();

static EVENTS: CriticalSectionMutex<RefCell<Option<Consumer<'static, Event>>>> =
    CriticalSectionMutex::new(RefCell::new(None));

static OUTPUTS: CriticalSectionMutex<RefCell<Option<Consumer<'static, OutputEvent>>>> =
    CriticalSectionMutex::new(RefCell::new(None));

/// Starts the handler; returns the ends of the queues for TIM2's and TIM1's.
pub(crate) fn init() -> (Producer<'static, Event>, Producer<'static, OutputEvent>) {
    static QUEUE: StaticCell<Queue<Event, { config::EVENTS }>> = StaticCell::new();
    static OUTPUT_QUEUE: StaticCell<Queue<OutputEvent, { config::OUTPUT_EVENTS }>> =
        StaticCell::new();
    let (producer, consumer) = QUEUE.init(Queue::new()).split();
    EVENTS.lock(|events| *events.borrow_mut() = Some(consumer));
    let (outputs, consumer) = OUTPUT_QUEUE.init(Queue::new()).split();
    OUTPUTS.lock(|events| *events.borrow_mut() = Some(consumer));
    // SAFETY: what the handler touches is set up.
    unsafe { NVIC::unmask(INTERRUPT) };
    (producer, outputs)
}

fn next_output() -> Option<OutputEvent> {
    OUTPUTS.lock(|events| {
        events
            .borrow_mut()
            .as_mut()
            .and_then(|events| events.dequeue())
    })
}

fn next() -> Option<Event> {
    EVENTS.lock(|events| {
        events
            .borrow_mut()
            .as_mut()
            .and_then(|events| events.dequeue())
    })
}

#[interrupt]
fn DCMI() {
    while let Some(event) = next() {
        match event {
            Event::Pulse(seq, pulsed) => send_pulse(seq, pulsed),
            Event::Capture(capture) => state::send(|outbox| outbox.capture(capture)),
            Event::DataReady { at, after_loss } => {
                if DATA_READY.try_send(DataReady { at, after_loss }).is_err() {
                    tasks::imu::lost_data_ready();
                }
            }
            Event::Flooded(input) => {
                let _ = FLOODED.try_send(input);
            }
        }
    }
    while let Some(event) = next_output() {
        send_output(&event);
    }
}

fn send_output(event: &OutputEvent) {
    let OutputEvent {
        channel,
        seq,
        pulsed,
    } = *event;
    let output = Output::ALL
        .into_iter()
        .find(|&output| outputs::channel_of(output) == channel);
    let Some(output) = output else {
        let pps = Pps {
            seq,
            at: pulsed.at,
            utc: tasks::gnss::utc_of(pulsed.at),
        };
        return state::send(|outbox| outbox.pps(pps));
    };
    let pulse = OutputPulse {
        output,
        pulse: Pulse {
            seq,
            train: pulsed.train,
            number: pulsed.number,
            at: pulsed.at,
            aligned: pulsed.aligned,
            readback: None,
        },
    };
    let arrived = pulsed.arrived.map(|command| OutputArrived {
        output,
        command,
        train: pulsed.train,
        pulse: pulsed.number,
        at: pulsed.at,
        remaining: TickDelta::ZERO,
    });
    state::send(|outbox| {
        outbox.output_pulse(pulse);
        if let Some(arrived) = arrived {
            outbox.output_arrived(arrived);
        }
    });
}

fn send_pulse(seq: u32, pulsed: Pulsed) {
    leds::set(Led::Pulse, pulsed.number.is_multiple_of(2));
    let pulse = Pulse {
        seq,
        train: pulsed.train,
        number: pulsed.number,
        at: pulsed.at,
        aligned: pulsed.aligned,
        readback: pulsed.readback,
    };
    let arrived = pulsed.arrived.map(|command| Arrived {
        command,
        train: pulsed.train,
        pulse: pulsed.number,
        at: pulsed.at,
        // The plan ends on the grid itself; the edge is its floor.
        remaining: TickDelta::ZERO,
    });
    state::send(|outbox| {
        outbox.pulse(pulse);
        if let Some(arrived) = arrived {
            outbox.arrived(arrived);
        }
    });
}
