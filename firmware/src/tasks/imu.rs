//! Samples the IMU: sets it up, reads it on each data-ready, and sets it up
//! again when it fails.
//!
//! A fault of one transfer costs that sample: the bus is freed and opened again,
//! and the next data-ready tries again. A second fault in a row, or silence,
//! starts from the sensor's reset. Nothing here holds up anything else.

use core::cell::Cell;
use core::sync::atomic::Ordering;

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Delay, Duration, Timer, with_timeout};
use firmware::alive::Task;
use firmware::config::{
    DATA_READY_SLACK_MS, FIRST_DATA_READY_MS, I2C_TIMEOUT_MS, IMU_CLOCK_SETTLING_MS, IMU_DEFAULT,
    IMU_POWER_UP_MS, IMU_RETRY_MS, IMU_START_MS, SET_UP_MS,
};
use firmware::imu::{self, Imu, RawSample};
use protocol::{
    DeviceToHost, ImuClock, ImuConfig, ImuFault, ImuFlags, ImuModel, ImuSample, ImuSetup, ImuState,
    ImuStatus, Refusal,
};

use crate::hardware::events::{DATA_READY, DataReady, LOST_DATA_READY};
use crate::hardware::imu_bus::{ImuBus, OpenBus};
use crate::hardware::imu_clock::ImuClockOutput;
use crate::hardware::leds::{self, Led};
use crate::hardware::tim2;
use crate::state::{self, ALIVE};
use crate::tasks::self_test;

type Sensor<'a> = Imu<OpenBus<'a>>;

static STATUS: CriticalSectionMutex<Cell<ImuStatus>> =
    CriticalSectionMutex::new(Cell::new(ImuStatus {
        state: ImuState::Starting,
        clock: ImuClock::Unknown,
        samples: 0,
        late: 0,
        overcaptures: 0,
        recoveries: 0,
        last_fault: None,
    }));

static CONFIG: CriticalSectionMutex<Cell<ImuConfig>> =
    CriticalSectionMutex::new(Cell::new(IMU_DEFAULT));

/// The sensor that was found last.
static MODEL: CriticalSectionMutex<Cell<ImuModel>> =
    CriticalSectionMutex::new(Cell::new(ImuModel::Unknown));

static RECONFIGURED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

pub(crate) fn status() -> ImuStatus {
    let counters = tim2::counters();
    let mut status = STATUS.lock(Cell::get);
    status.overcaptures = counters
        .data_ready_overcaptures
        .saturating_add(counters.lost_data_ready)
        .saturating_add(LOST_DATA_READY.load(Ordering::Relaxed));
    status
}

pub(crate) fn setup() -> ImuSetup {
    imu::describe(MODEL.lock(Cell::get), CONFIG.lock(Cell::get), status())
}

/// Sets the IMU up again, unless it is, or is about to be: a command that comes twice
/// changes nothing.
///
/// # Errors
///
/// A setting that the sensor does not have.
pub(crate) fn configure(config: ImuConfig) -> Result<ImuSetup, Refusal> {
    imu::check(MODEL.lock(Cell::get), &config)?;
    let before = CONFIG.lock(|cell| cell.replace(config));
    if before != config || status().state == ImuState::Failed {
        update(|status| status.state = ImuState::Starting);
        RECONFIGURED.signal(());
    }
    Ok(setup())
}

fn update(change: impl FnOnce(&mut ImuStatus)) {
    STATUS.lock(|cell| {
        let mut status = cell.get();
        change(&mut status);
        cell.set(status);
    });
}

fn book(fault: ImuFault) {
    let before = STATUS.lock(Cell::get).last_fault;
    if before != Some(fault) {
        defmt::warn!("imu: {}", fault);
    }
    update(|status| status.last_fault = Some(fault));
}

fn show(state: ImuState) {
    leds::set(Led::Imu, state == ImuState::Running);
    leds::show_imu_fault(state == ImuState::Failed);
    if STATUS.lock(Cell::get).state != state {
        defmt::info!("imu: {}", state);
    }
    update(|status| status.state = state);
}

#[embassy_executor::task]
pub(crate) async fn run(mut bus: ImuBus, clock_output: ImuClockOutput) {
    let mut sampler = Sampler {
        clock_output,
        config: IMU_DEFAULT,
        seq: 0,
        flags: ImuFlags::FIRST,
        failed: false,
    };
    ALIVE.check_in(Task::Imu);
    Timer::after_millis(IMU_POWER_UP_MS).await;
    loop {
        sampler.config = CONFIG.lock(Cell::get);
        RECONFIGURED.reset();
        show(ImuState::Starting);
        let ended = sampler.session(&mut bus).await;
        if let Err(fault) = ended {
            book(fault);
            show(ImuState::Failed);
            // A sensor that had been running is tried again at once.
            if sampler.failed {
                alive().await;
                Timer::after_millis(IMU_RETRY_MS).await;
            }
        }
        sampler.failed = ended.is_err();
    }
}

/// Checks in; does not return during the self test.
async fn alive() {
    if self_test::is_stalled() {
        core::future::pending::<()>().await;
    }
    ALIVE.check_in(Task::Imu);
}

struct Sampler {
    clock_output: ImuClockOutput,
    config: ImuConfig,
    seq: u32,
    /// Flags that the next sample carries.
    flags: ImuFlags,
    /// The last session ended in a fault.
    failed: bool,
}

impl Sampler {
    /// From setting up to the next fault (an error) or configuration.
    async fn session(&mut self, bus: &mut ImuBus) -> Result<(), ImuFault> {
        alive().await;
        let (clock, mut edge) = match self.start(bus).await? {
            Some(started) => started,
            None => return Ok(()),
        };
        if self.failed {
            update(|status| status.recoveries = status.recoveries.saturating_add(1));
            self.failed = false;
        }
        self.flags = ImuFlags::FIRST;
        update(|status| status.clock = clock);
        show(ImuState::Running);
        let model = MODEL.lock(Cell::get);
        defmt::info!("imu runs, {}, clock {}", model, clock);

        let patience = self.patience();
        let mut sensor = Imu::new(bus.open(), model);
        let mut one_failed = false;
        loop {
            alive().await;
            match within(I2C_TIMEOUT_MS, &mut sensor, Sensor::read_sample).await {
                Ok(raw) => {
                    self.send(edge, &raw);
                    one_failed = false;
                }
                Err(fault) => {
                    self.lose(fault);
                    if one_failed {
                        return Err(fault);
                    }
                    one_failed = true;
                    drop(sensor);
                    if !bus.free().await {
                        return Err(ImuFault::BusHeld);
                    }
                    sensor = Imu::new(bus.open(), model);
                }
            }
            match next_edge(patience).await? {
                Some(next) => edge = next,
                None => return Ok(()),
            }
        }
    }

    /// Sets the sensor up, on the board's clock or else its own, and waits for
    /// the first data-ready. `None` if another configuration came.
    async fn start(&mut self, bus: &mut ImuBus) -> Result<Option<(ImuClock, DataReady)>, ImuFault> {
        match self.start_on(bus, ImuClock::External).await {
            Err(setback) if setback.on_external_clock => {
                book(setback.fault);
                self.start_on(bus, ImuClock::Internal).await
            }
            other => other,
        }
        .map_err(|setback| setback.fault)
    }

    /// On its own clock, if it does not take another.
    async fn start_on(
        &mut self,
        bus: &mut ImuBus,
        wanted: ImuClock,
    ) -> Result<Option<(ImuClock, DataReady)>, Setback> {
        let before = |fault| Setback {
            on_external_clock: false,
            fault,
        };
        alive().await;
        if !bus.free().await {
            return Err(before(ImuFault::BusHeld));
        }
        let mut sensor = Imu::new(bus.open(), ImuModel::Unknown);
        within(SET_UP_MS, &mut sensor, async |sensor| {
            sensor.set_up(&self.config, &mut Delay).await
        })
        .await
        .map_err(before)?;
        let model = sensor.model();
        MODEL.lock(|cell| cell.set(model));
        let clock = match model.clock_input() {
            Some(_) => wanted,
            None => ImuClock::Internal,
        };
        let after = |fault| Setback {
            on_external_clock: clock == ImuClock::External,
            fault,
        };
        self.clock_output.set(model);
        within(IMU_START_MS, &mut sensor, async |sensor| {
            sensor.start(clock, &mut Delay).await
        })
        .await
        .map_err(after)?;
        if clock == ImuClock::External {
            Timer::after_millis(IMU_CLOCK_SETTLING_MS).await;
        }
        alive().await;
        // Edges from before the reset, or of another clock.
        DATA_READY.clear();
        let first = FIRST_DATA_READY_MS + u64::from(imu::interval_ms(&self.config));
        let edge = next_edge(Duration::from_millis(first)).await;
        Ok(edge.map_err(after)?.map(|edge| (clock, edge)))
    }

    /// Longest wait for data-ready.
    fn patience(&self) -> Duration {
        let interval = u64::from(imu::interval_ms(&self.config));
        Duration::from_millis(2 * interval + DATA_READY_SLACK_MS)
    }

    /// The sample of an edge could not be read: a gap in the stream.
    fn lose(&mut self, fault: ImuFault) {
        self.seq = self.seq.wrapping_add(1);
        self.flags = self.flags.with(ImuFlags::AFTER_LOSS);
        book(fault);
    }

    fn send(&mut self, edge: DataReady, raw: &RawSample) {
        let mut flags = core::mem::take(&mut self.flags);
        if edge.after_loss {
            flags = flags.with(ImuFlags::AFTER_LOSS);
        }
        if raw.is_saturated() {
            flags = flags.with(ImuFlags::SATURATED);
        }
        // The next edge came before the registers were read.
        let late = !DATA_READY.is_empty();
        if late {
            flags = flags.with(ImuFlags::LATE);
        }
        update(|status| {
            status.samples = status.samples.saturating_add(1);
            status.late = status.late.saturating_add(u32::from(late));
        });
        let sample = ImuSample {
            seq: self.seq,
            at: edge.at,
            flags,
            accel: raw.accel,
            temperature: raw.temperature,
            gyro: raw.gyro,
        };
        self.seq = self.seq.wrapping_add(1);
        state::send(DeviceToHost::Imu(sample));
    }
}

/// Why a start failed.
struct Setback {
    /// It came with the switch to the board's clock: the sensor's own is still to be
    /// tried.
    on_external_clock: bool,
    fault: ImuFault,
}

/// The next data-ready, which may stay away that long; `None` if another configuration
/// came.
async fn next_edge(patience: Duration) -> Result<Option<DataReady>, ImuFault> {
    let event = select(DATA_READY.receive(), RECONFIGURED.wait());
    match with_timeout(patience, event).await {
        Ok(Either::First(edge)) => Ok(Some(edge)),
        Ok(Either::Second(())) => Ok(None),
        Err(_) => Err(ImuFault::NoDataReady),
    }
}

/// Limits a step of the work with a sensor to `limit_ms`.
async fn within<'a, T>(
    limit_ms: u64,
    sensor: &mut Sensor<'a>,
    work: impl AsyncFnOnce(&mut Sensor<'a>) -> Result<T, ImuFault>,
) -> Result<T, ImuFault> {
    match with_timeout(Duration::from_millis(limit_ms), work(sensor)).await {
        Ok(result) => result,
        // The transfer that was dropped.
        Err(_) => Err(ImuFault::Timeout {
            register: sensor.register(),
        }),
    }
}
