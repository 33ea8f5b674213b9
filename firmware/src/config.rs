//! Every tuning number of the firmware, with its derivation.

use protocol::{
    AccelRange, CORE_HZ, GyroRange, ImuConfig, LowPass, NMEA_SLACK_MS, TICK_HZ, TickDelta,
};

/// Ticks in a microsecond: 48.
pub const TICKS_PER_US: u32 = TICK_HZ / 1_000_000;

/// Core clock in Hz: the PLL's 192 MHz by 2. Of the settings that give USB its
/// 48 MHz (192 / 4) it is the one whose PLL output also divides to the
/// IMU's 19.2 MHz (96 / 5, MCO1). `docs/architecture.md`. How each board's
/// crystal makes the 192 MHz is in [`crate::boards`].
pub const SYSCLK_HZ: u32 = CORE_HZ;

/// Timer clock of APB1 in Hz: 96 MHz / 4, doubled by the hardware for timers
/// (RM0090 7.2). One tick of board time.
pub const TIM2_HZ: u32 = TICK_HZ;

/// Clock of TIM1 in a tick: APB2's timers run at 96 MHz.
pub const TIM1_CLOCKS_PER_TICK: u32 = SYSCLK_HZ / TICK_HZ;

/// Clock of UART5 in Hz: APB1, 96 MHz / 4.
pub const PCLK1_HZ: u32 = SYSCLK_HZ / 4;

/// Delay of TIM1's start after TIM2's, in clocks of TIM1: a constant of the hardware that the
/// reference manual does not give (RM0090 17.3.20 only says that there is a resynchronisation).
/// This is the simulated board's; the board test measures a real one's, which the board then
/// keeps ([`protocol::BoardSettings`]).
pub const OUTPUT_START_DELAY: u8 = 2;

/// Lowest supply at which the flash is written, in mV: the 2.7 V that 32 bits at once need (RM0090
/// 3.6.2), and 1.5 % for the reference that it is measured by.
pub const FLASH_SUPPLY_MV: u16 = 2_740;

/// Most panics that are kept in flash, of the 910 entries that it takes: a board that panics
/// at each start leaves room for settings.
pub const MOST_PANICS: u32 = 800;

/// Farthest edge that is armed on TIM1, in ticks ahead: 0.6 ms. TIM1 wraps every 65,536 of its
/// clocks, 0.68 ms.
pub const OUTPUT_REACH: u32 = 600 * TICKS_PER_US;

/// Lead of the handler's call before an edge that is too far ahead to be armed at once: 0.4 ms.
/// A channel reaches farther than that by the longest delay of a handler ([`OUTPUT_REACH`]).
pub const WAKE_LEAD: TickDelta = TickDelta::from_micros(400);

/// The quiet margin of TIM1's handlers: 40 µs. Longer than TIM2's
/// ([`QUIET_MARGIN`]), as TIM2's handler goes on meanwhile.
pub const OUTPUT_QUIET_MARGIN: TickDelta = TickDelta::from_micros(40);

/// Longest delay of the start of sentences.
pub const NMEA_SLACK: TickDelta = TickDelta::from_micros(NMEA_SLACK_MS * 1_000);

/// Farthest that a compare is armed ahead, in ticks: 22.4 s. Compares only see
/// the low 32 bits; half of their range keeps "ahead" and "behind" apart, and
/// half of that again is the margin of [`crate::timebase`]. Edges farther away
/// are reached by waypoints.
pub const MAX_ARM_AHEAD: u32 = 1 << 30;

/// An edge that was missed is made this much later than the moment at which
/// that was seen: 10 µs, three times what the handler takes to arm it (some 20
/// accesses of a dozen cycles each).
pub(crate) const LATE_EDGE_DELAY: TickDelta = TickDelta::from_micros(10);

/// A rising edge nearer than this is not taken back by a stop: 20 µs, longer than a
/// task takes from its look at the time to the last register.
/// The stop waits until the pulse is over instead, and so never races the
/// compare.
pub(crate) const STOP_MARGIN: TickDelta = TickDelta::from_micros(20);

/// From a start without a first edge to that edge: 1 ms, ten times
/// the least lead that a host may ask for.
pub const START_LEAD: TickDelta = TickDelta::from_micros(1_000);

/// A task masks TIM2's handler only while no edge is due for this long: 15 µs, three
/// times the longest section (a copy of the train's state, 5 µs). So masking never delays
/// an edge's handler.
pub const QUIET_MARGIN: TickDelta = TickDelta::from_micros(15);

/// Longest delay of a trigger edge before its handler counts as dead and the watchdog is no
/// longer fed: 10 ms, a thousand times the handler's latency.
pub const TRIGGER_OVERDUE: TickDelta = TickDelta::from_micros(10_000);

/// Ticks by which the filter of the capture inputs delays every edge: a new level counts
/// when 8 samples at the timer's clock have it (ICxF = 3, RM0090 18.4.7). Taken off where
/// the time of a capture is stated, until the board test has measured the whole delay
/// ([`protocol::BoardSettings`]).
pub const INPUT_FILTER: u32 = 8;

/// Time in which an edge at a pin has surely been captured, in ticks: the filter, at most
/// three clocks of the synchroniser, and some for the bus.
pub const CAPTURE_DELAY: u32 = INPUT_FILTER + 8;

/// Most edges of the strobe close together: eight, whose handling (an estimated 4 µs each, with
/// wait states) together stays below the 50 µs in which the handlers of lower priority must arm a
/// falling edge ([`protocol::MIN_OUTPUT_WIDTH`]).
pub const STROBE_CLOSE: u32 = 8;

/// Ticks in which that regains one edge: 60 µs, half of the shortest distance of the
/// camera's edges.
pub const STROBE_CLOSE_REFILL: u32 = 60 * TICKS_PER_US;

/// Bucket of the strobe input: this many edges in a burst. The camera makes 18
/// (9 pulses) a frame; three frames of it may come at once.
pub const STROBE_BURST: u32 = 64;

/// Ticks in which the strobe bucket regains one edge: 0.5 ms, so 2,000 edges a
/// second for ever. The camera makes 540 (18 at 30 fps). At some 150 cycles
/// for the handler of one edge and 1,500 for its message, a flood costs 3 % of
/// the core.
pub const STROBE_REFILL: u32 = 500 * TICKS_PER_US;

/// Bucket of data-ready: this many edges in a burst.
pub const DATA_READY_BURST: u32 = 16;

/// Ticks in which the data-ready bucket regains one edge: 0.5 ms, twice the
/// sensor's highest rate.
pub const DATA_READY_REFILL: u32 = 500 * TICKS_PER_US;

/// Time for which an input is off after a flood, in ms: long enough to regain 40 edges, short
/// enough to lose no more than one frame of the camera's pulses.
pub const MUTE_MS: u64 = 20;

/// Events of TIM2's handler that wait for the handler below it. That one runs
/// within some tens of µs (the longest handler of its priority is USB's), in
/// which no more than a burst of 20 edges at the handler's own pace can come.
pub const EVENTS: usize = 32;

/// Answers that wait to be sent. Commands are taken from the link only while
/// there is room for theirs, so this bounds how many are answered in one go.
pub(crate) const ANSWERS: usize = 12;

/// Room in the answers that a command needs: its answer and a hello, and one
/// for an arrival that comes between.
pub(crate) const ANSWERS_PER_COMMAND: usize = 3;

/// Pulses that wait to be sent: two seconds at 30 fps.
pub(crate) const PULSES: usize = 64;

/// Pulses of the auxiliary outputs that wait to be sent, pulses per second with
/// them: half a second of three trains at 30 fps.
pub(crate) const OUTPUT_PULSES: usize = 64;

/// Events of TIM1's handlers that wait for the handler below them. Four channels
/// whose pulses are 0.15 ms apart at least make 26 in 1 ms.
pub const OUTPUT_EVENTS: usize = 32;

/// Captures that wait to be sent: five frames of the camera's pulses.
pub(crate) const CAPTURES: usize = 96;

/// IMU samples that wait to be sent: 128 ms at 500 Hz. A USB host that is busy
/// elsewhere for that long loses nothing.
pub(crate) const IMU_SAMPLES: usize = 64;

/// Status messages that wait to be sent.
pub(crate) const STATUSES: usize = 2;

/// Bytes that are gathered before they are written to USB: the longest frame
/// and then some, 16 packets.
pub const TRANSMIT_BUFFER: usize = 1024;

/// Messages in [`TRANSMIT_BUFFER`], whose frames take 14 bytes at least: a capture of two bytes of
/// number and five of time.
pub const MOST_FRAMES: usize = TRANSMIT_BUFFER / 14;

/// Packet of full-speed bulk endpoints, in bytes (USB 2.0, 5.8.3).
pub const USB_PACKET: usize = 64;

/// Interval at which a waiting task wakes up to check in, in ms: twice in each watchdog round.
pub const CHECK_IN_MS: u64 = 500;

/// The watchdog's timeout in µs. It runs from the LSI, 17 to 47 kHz for a
/// nominal 32 (data sheet, table 36), so 2.7 to 7.5 s; it is fed once a second.
pub const WATCHDOG_US: u32 = 4_000_000;

/// Seconds in which the host sends and the board's core sends nothing, until the board leaves the
/// bus and comes back. Status alone goes out every second.
pub const TRANSMIT_SILENT_S: u32 = 5;

/// Seconds from a bus reset without a configuration by the host, until the board leaves the bus
/// and comes back: several times the 5 s that a host waits for one control transfer.
pub const UNCONFIGURED_S: u32 = 30;

/// From the answer to a self test to the failure, in ms: the answer has left.
pub const SELF_TEST_DELAY_MS: u64 = 50;

/// By what a self test makes the trigger's handler slower, in core cycles: 50 µs, more
/// than the shortest gap between two pulses leaves it ([`protocol::MIN_PULSE_GAP`]).
pub const SLOW_HANDLER_CYCLES: u32 = 50 * (SYSCLK_HZ / 1_000_000);

/// I2C clock in Hz: the sensor's fastest.
pub const I2C_HZ: u32 = 400_000;

/// Longest I2C transfer in ms. Reading a sample is 17 bytes of 9 bits at
/// 400 kHz: 0.4 ms; the sensor does not stretch the clock.
pub const I2C_TIMEOUT_MS: u64 = 5;

/// From reset to the first access of the sensor, in ms: it takes up to 100 ms
/// after power-on until it answers (data sheet 6.3).
pub const IMU_POWER_UP_MS: u64 = 100;

/// Clock of an ICM-42688-P, in Hz: at 32 kHz its rates are those that it is set to (data
/// sheet, 12.5). 1,500 ticks of TIM3.
pub const IMU_RTC_HZ: u32 = 32_000;

/// Longest time for starting a sensor that is set up, in ms: twelve transfers of at most
/// 0.1 ms, a pause of 0.2, and time for a bus with a hiccup.
pub const IMU_START_MS: u64 = 10;

/// Longest wait for the first data-ready after setting up, in ms beyond one interval, before the
/// clock counts as missing: three times the start-up time of the gyroscope (30 ms, data sheet
/// 6.1; MPU-6500 35 ms, ICM-42688-P 30 ms).
pub const FIRST_DATA_READY_MS: u64 = 100;

/// From the switch to the external clock until the sensor's PLL has settled on it, in
/// ms: 10 at most by the product specification. What it samples until then is in
/// neither clock.
pub const IMU_CLOCK_SETTLING_MS: u64 = 10;

/// Longest time for setting the sensor up, in ms: 100 ms for its reset, 51
/// transfers of at most 0.1 ms, and time for a bus with a hiccup.
pub const SET_UP_MS: u64 = 150;

/// Longest wait for data-ready beyond two intervals, in ms: ten intervals at 500 Hz. Silence is
/// noticed after 24 ms there and after 420 ms at 5 Hz.
pub const DATA_READY_SLACK_MS: u64 = 20;

/// Pause between two attempts to set up a sensor that does not answer, in ms.
/// An attempt without answer is over at once, and one that succeeds takes some
/// 150 ms to the first data-ready (250 ms more without the external clock): well
/// within the second in which a sensor must be recovered.
pub const IMU_RETRY_MS: u64 = 100;

/// The IMU as it is set up at reset: 500 Hz, the widest low-pass below half of
/// that, ±500 °/s (a twist by hand reaches more than ±250), ±4 g.
pub const IMU_DEFAULT: ImuConfig = ImuConfig {
    divider: 1,
    low_pass: LowPass::Hz188,
    gyro_range: GyroRange::Dps500,
    accel_range: AccelRange::G4,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_of_32_khz_is_whole_ticks() {
        assert_eq!(TIM2_HZ % IMU_RTC_HZ, 0);
    }
}
