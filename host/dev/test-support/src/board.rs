//! Messages of a board, as tests send them in its place.

use protocol::{
    AccelRange, BoardModel, DeviceToHost, GyroRange, Hello, ImuClock, ImuConfig, ImuModel,
    ImuSensor, ImuSetup, ImuState, ImuStatus, LowPass, MAX_FRAME, PROTOCOL_VERSION, ResetCause,
    TICK_HZ, Ticks, encode,
};

/// Returns the frame of a message.
#[must_use]
pub fn frame(message: &DeviceToHost) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    encode(message, &mut buffer).unwrap().to_vec()
}

/// Returns what a board says of itself after its watchdog has reset it.
#[must_use]
pub fn hello() -> Hello {
    Hello {
        protocol_version: PROTOCOL_VERSION,
        firmware_version: (1, 2, 3),
        git_revision: "0123456789ab".try_into().unwrap(),
        git_dirty: true,
        board_id: [0xAB, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
        tick_hz: TICK_HZ,
        now: Ticks(48_000_000 * 90),
        epoch: 77,
        reset_cause: ResetCause::Watchdog,
        last_panic: Some("trigger.rs:12: odd".try_into().unwrap()),
        board: BoardModel::BlackPill,
        panics: 3,
        kept_panic: Some("trigger.rs:12: odd".try_into().unwrap()),
    }
}

/// Returns the setup of an ICM-42688-P at 500 Hz on the board's clock.
#[must_use]
pub fn imu_setup() -> ImuSetup {
    ImuSetup {
        config: ImuConfig {
            divider: 1,
            low_pass: LowPass::Hz188,
            gyro_range: GyroRange::Dps500,
            accel_range: AccelRange::G4,
        },
        interval: 96_000,
        gyro_lsb_per_dps_times_10: 655,
        accel_lsb_per_g: 8_192,
        gyro_delay_us: 1_300,
        accel_delay_us: 1_300,
        status: ImuStatus {
            state: ImuState::Running,
            clock: ImuClock::External,
            samples: 500,
            ..ImuStatus::default()
        },
        sensor: ImuSensor {
            model: ImuModel::Icm42688P,
            gyro_bandwidth_hz_times_10: 2_467,
            gyro_noise_udps: 2_800,
            accel_noise_ug: 70,
            temperature_lsb_per_c_times_100: 13_248,
            temperature_at_zero_centidegrees: 2_500,
        },
    }
}
