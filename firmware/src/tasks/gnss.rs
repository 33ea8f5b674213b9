//! The pulse per second and its sentences.
//!
//! The pulse is a train like any other, with a period of a second, on channel 1 of
//! TIM1. This task sends the sentences of each second when they are due, by board
//! time. What is late is left out and counted: a sentence outside of its window
//! would give a lidar the wrong second.

use core::cell::Cell;

use embassy_futures::select::select;
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};
use firmware::alive::Task;
use firmware::boards::BOARD;
use firmware::config::{NMEA_SLACK, START_LEAD, TICKS_PER_US};
use firmware::nmea;
use protocol::{
    GnssReport, GnssSettings, GnssStatus, Period, Refusal, TICK_HZ, TickDelta, Ticks, TriggerStart,
};

use crate::hardware::nmea_port::{self, Port};
use crate::hardware::outputs::{self, Line};
use crate::hardware::resources::Sentences;
use crate::hardware::tim2;
use crate::state::{ALIVE, CHECK_IN, UTC_AT_ZERO};

#[derive(Clone, Copy)]
struct State {
    settings: Option<GnssSettings>,
    /// The first whole second that has a pulse.
    first_second: u64,
    stopped_at: Ticks,
    /// The line is not closed yet.
    open: bool,
    sentences: u32,
    missed: u32,
}

static STATE: CriticalSectionMutex<Cell<State>> = CriticalSectionMutex::new(Cell::new(State {
    settings: None,
    first_second: 0,
    stopped_at: Ticks::ZERO,
    open: false,
    sentences: 0,
    missed: 0,
}));

static CHANGED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// The instant at which a whole second of board time begins.
const fn start_of(second: u64) -> Ticks {
    Ticks(second * TICK_HZ as u64)
}

fn update(change: impl FnOnce(&mut State)) {
    STATE.lock(|cell| {
        cell.update(|mut state| {
            change(&mut state);
            state
        });
    });
}

/// Starts it on the next whole second of board time.
///
/// # Errors
///
/// Settings out of bounds; it runs with others.
pub(crate) fn start(settings: GnssSettings) -> Result<GnssReport, Refusal> {
    if !BOARD.model.has_outputs() {
        return Err(Refusal::NotOnThisBoard);
    }
    let now = tim2::now();
    nmea::check(&settings, now)?;
    let state = STATE.lock(Cell::get);
    match state.settings {
        Some(same) if same == settings => return Ok(report()),
        Some(_) => return Err(Refusal::GnssRunning),
        None => {}
    }
    let stopped = outputs::with_line(Line::Pps, |pulser, _, _| pulser.running().is_none());
    if state.open || !stopped {
        return Err(Refusal::GnssStopping);
    }
    let second = (now + START_LEAD).0 / u64::from(TICK_HZ) + 1;
    let train = TriggerStart {
        period: Period::from_ticks(TICK_HZ),
        width: settings.pulse_width,
        first_edge: Some(start_of(second).into()),
    };
    outputs::set_pps_inverted(settings.pulse_inverted);
    outputs::with_line(Line::Pps, |pulser, output, time| {
        pulser.start(output, time, train)
    })?;
    UTC_AT_ZERO.lock(|cell| cell.set(settings.utc_at_zero));
    update(|state| {
        state.settings = Some(settings);
        state.first_second = second;
        state.open = true;
    });
    CHANGED.signal(());
    Ok(report())
}

/// Stops it. The pulse and the sentences under way are finished.
pub(crate) fn stop() -> GnssReport {
    outputs::with_line(Line::Pps, |pulser, output, time| pulser.stop(output, time));
    let now = tim2::now();
    update(|state| {
        if state.settings.take().is_some() {
            state.stopped_at = now;
        }
    });
    CHANGED.signal(());
    report()
}

pub(crate) fn report() -> GnssReport {
    GnssReport {
        settings: STATE.lock(Cell::get).settings,
        status: status(),
    }
}

pub(crate) fn status() -> GnssStatus {
    let state = STATE.lock(Cell::get);
    let pulses = outputs::with_line(Line::Pps, |pulser, _, _| pulser.summary(tim2::now()));
    GnssStatus {
        state: pulses.state,
        pulses: pulses.pulses,
        sentences: state.sentences,
        missed: state.missed,
        late: pulses.late,
    }
}

#[embassy_executor::task]
pub(crate) async fn run(mut sentences: Sentences) {
    loop {
        ALIVE.check_in(Task::Gnss);
        let state = STATE.lock(Cell::get);
        if let Some(settings) = state.settings {
            let port = nmea_port::open(&mut sentences, settings.baud);
            send_each(port, &settings, state.first_second).await;
        }
        update(|state| state.open = state.settings.is_some());
        select(CHANGED.wait(), Timer::after(CHECK_IN)).await;
    }
}

/// Sends the sentences of each second from `second` on, until it is stopped: a pulse that was made
/// gets its sentences.
async fn send_each(mut port: Port<'_>, settings: &GnssSettings, mut second: u64) {
    loop {
        ALIVE.check_in(Task::Gnss);
        let state = STATE.lock(Cell::get);
        if state.settings.is_none() && start_of(second) > state.stopped_at {
            return;
        }
        let due = start_of(second) + TickDelta::from_micros(u32::from(settings.delay_ms) * 1_000);
        let now = tim2::now();
        if now < due {
            let micros = (due - now).unsigned_abs().div_ceil(TICKS_PER_US.into());
            let pause = Duration::from_micros(micros).min(CHECK_IN);
            select(CHANGED.wait(), Timer::after(pause)).await;
            continue;
        }
        let in_time = now - due <= NMEA_SLACK;
        let text = nmea::text(settings.sentences, nmea::utc_of(settings.utc_at_zero, due));
        let sent = in_time && port.send(&text).await;
        update(|state| {
            if sent {
                state.sentences = state.sentences.saturating_add(1);
            } else {
                state.missed = state.missed.saturating_add(1);
            }
        });
        second += 1;
    }
}
