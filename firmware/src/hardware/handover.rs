//! The handler between those of the timers and the tasks: moves events
//! ([`super::events`]) to the outbox, the LEDs and the tasks' queues.

#![allow(unsafe_code, reason = "unmasks the interrupt")]

use core::cell::{Cell, RefCell};
use core::sync::atomic::Ordering;

use cortex_m::peripheral::NVIC;
use embassy_stm32::peripherals::SPI3;
use embassy_stm32::{Peri, interrupt};
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use firmware::config;
use firmware::nmea;
use firmware::pulser::Pulsed;
use heapless::spsc::{Consumer, Producer, Queue};
use protocol::{Arrived, DeviceToHost, Output, Pps, Pulse, TickDelta};
use static_cell::StaticCell;

use crate::hardware::cycles::HANDOVER_TIME;
use crate::hardware::events::{DATA_READY, Event, FLOODED, INTERRUPT, LOST_DATA_READY};
use crate::hardware::leds::{self, Led};
use crate::state;

/// The end of a queue that this handler empties, once it is set up.
type Receiver = CriticalSectionMutex<RefCell<Option<Consumer<'static, Event>>>>;

static EVENTS: Receiver = Receiver::new(RefCell::new(None));

static OUTPUTS: Receiver = Receiver::new(RefCell::new(None));

/// Starts the handler, on the interrupt of a peripheral that nobody else uses. Returns the sending
/// ends of the queues, for TIM2's handler and for TIM1's.
pub(crate) fn init(_: Peri<'static, SPI3>) -> (Producer<'static, Event>, Producer<'static, Event>) {
    static QUEUE: StaticCell<Queue<Event, { config::EVENTS }>> = StaticCell::new();
    static OUTPUT_QUEUE: StaticCell<Queue<Event, { config::OUTPUT_EVENTS }>> = StaticCell::new();
    let (producer, consumer) = QUEUE.init(Queue::new()).split();
    EVENTS.lock(|events| *events.borrow_mut() = Some(consumer));
    let (outputs, consumer) = OUTPUT_QUEUE.init(Queue::new()).split();
    OUTPUTS.lock(|events| *events.borrow_mut() = Some(consumer));
    // SAFETY: what the handler touches is set up.
    unsafe { NVIC::unmask(INTERRUPT) };
    (producer, outputs)
}

fn next(events: &Receiver) -> Option<Event> {
    events.lock(|events| events.borrow_mut().as_mut()?.dequeue())
}

#[interrupt]
fn SPI3() {
    HANDOVER_TIME.measure(hand_over);
}

fn hand_over() {
    while let Some(event) = next(&EVENTS).or_else(|| next(&OUTPUTS)) {
        match event {
            Event::Pulse(None, seq, pulsed) => send_pps(seq, &pulsed),
            Event::Pulse(Some(output), seq, pulsed) => {
                if output.is_camera() {
                    leds::set(Led::Pulse, pulsed.number.is_multiple_of(2));
                }
                send_pulse(output, seq, &pulsed);
            }
            Event::Capture(capture) => state::send(DeviceToHost::Capture(capture)),
            Event::DataReady(edge) => {
                if DATA_READY.try_send(edge).is_err() {
                    LOST_DATA_READY.fetch_add(1, Ordering::Relaxed);
                }
            }
            Event::Flooded(input) => {
                let _ = FLOODED.try_send(input);
            }
        }
    }
}

fn send_pps(seq: u32, pulsed: &Pulsed) {
    let pps = Pps {
        seq,
        at: pulsed.at,
        utc: nmea::utc_of(state::UTC_AT_ZERO.lock(Cell::get), pulsed.at),
    };
    state::send(DeviceToHost::Pps(pps));
}

fn send_pulse(output: Output, seq: u32, pulsed: &Pulsed) {
    let pulse = Pulse {
        output,
        seq,
        train: pulsed.train,
        number: pulsed.number,
        at: pulsed.at,
        aligned: pulsed.aligned,
        readback: pulsed.readback,
    };
    state::send(DeviceToHost::Pulse(pulse));
    if let Some(command) = pulsed.arrived {
        state::send(DeviceToHost::Arrived(Arrived {
            output,
            command,
            train: pulsed.train,
            pulse: pulsed.number,
            at: pulsed.at,
            // The plan ends on the grid itself; the edge is its floor.
            remaining: TickDelta::ZERO,
        }));
    }
}
