//! The boards of the product: what is soldered to the chip of an STM32F4DISCOVERY or a WeAct
//! Black Pill, what is wired to their pins (the same, but for LEDs, auxiliary outputs and lidar),
//! and the firmware that they run.

pub mod jumpers;
pub mod pin_log;

use std::path::{Path, PathBuf};

use stm32f4_sim::clock::Rate;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::sim::{Part, Sim, SimBuilder, Timer};
use stm32f4_sim::time::{SimDuration, UNITS_PER_SECOND};

/// Environment variable that names the ELF which tests and tools use.
pub(crate) const ELF_VARIABLE: &str = "SMARTDEPTHSYNC_FIRMWARE_ELF";

/// The timer whose counter is the board's time.
pub const TIMEBASE: Timer = Timer::Tim2;

/// Virtual time in one of its ticks.
pub const UNITS_PER_TICK: u64 = UNITS_PER_SECOND / protocol::TICK_HZ as u64;

/// Camera trigger (TIM2 CH1).
pub const TRIGGER: Pin = Pin::PA5;
/// Data-ready of the IMU (TIM2 CH2).
pub(crate) const IMU_READY: Pin = Pin::PA1;
/// Strobe input (TIM2 CH3).
pub const STROBE: Pin = Pin::PA2;
/// The trigger's wire, read back (TIM2 CH4).
pub const READBACK: Pin = Pin::PA3;
/// Clock of an IMU that takes 19.2 MHz (MCO1).
pub const IMU_CLOCK: Pin = Pin::PA8;
/// Clock of an IMU that takes 32 kHz (TIM3 CH3).
pub(crate) const IMU_RTC: Pin = Pin::PB0;
/// Clock of the I2C bus (I2C1).
pub(crate) const SCL: Pin = Pin::PB6;
/// Data of the I2C bus (I2C1).
pub const SDA: Pin = Pin::PB7;
/// Sentences for a lidar (UART5 TX).
pub(crate) const NMEA: Pin = Pin::PC12;
/// Pulse per second for a lidar (TIM1 CH1).
pub(crate) const PPS: Pin = Pin::PE9;
/// The auxiliary trigger outputs (TIM1 CH2 to CH4).
pub const OUTPUTS: [Pin; 3] = [Pin::PE11, Pin::PE13, Pin::PE14];
/// Voltage that the 74AHCT gates between the board and a 5 V input take as high (data sheet of
/// the 74AHCT125, at 4.5 to 5.5 V).
pub const GATE_HIGH: f64 = 2.0;

/// Highest voltage at an input behind the divider for 5 V: 5.25 V through 1.8 kΩ and 2.2 kΩ of 5 %.
pub(crate) const DIVIDED_HIGH: f64 = 5.25 * 2.31 / (2.31 + 1.71);

/// Frequency of the crystals (UM1472 6.10; WeAct's circuit diagram).
const CRYSTAL_HZ: u64 = 8_000_000;
const BLACK_PILL_CRYSTAL_HZ: u64 = 25_000_000;

/// The kind of board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum BoardKind {
    /// STM32F4DISCOVERY
    #[default]
    Discovery,
    /// WeAct Black Pill (STM32F411CE)
    BlackPill,
}

/// A board of either kind with nothing wired to it; without an ELF it has the product's
/// firmware.
#[must_use]
pub fn board_of(kind: BoardKind, elf: Option<&Path>) -> SimBuilder {
    let board = match kind {
        BoardKind::Discovery => board(),
        BoardKind::BlackPill => {
            let elf = default_elf().to_string_lossy().into_owned();
            let elf = match elf.strip_suffix("-discovery.elf") {
                Some(released) => format!("{released}-black-pill.elf"),
                None => elf + "-black-pill",
            };
            board()
                .elf(elf)
                .chip(|chip| {
                    chip.part = Part::Stm32f411ce;
                    chip.die.supply = 3.3;
                })
                .crystal(Rate::hz(BLACK_PILL_CRYSTAL_HZ))
        }
    };
    match elf {
        Some(elf) => board.elf(elf),
        None => board,
    }
}

/// Returns the board with the product's firmware ([`default_elf`]) and nothing wired to it.
#[must_use]
pub fn board() -> SimBuilder {
    Sim::builder(default_elf())
        .missing_hint(
            "run `cargo xtask build`, or name one with --elf or SMARTDEPTHSYNC_FIRMWARE_ELF",
        )
        .crystal(Rate::hz(CRYSTAL_HZ))
        .i2c_bus(SCL, SDA)
        .chip(|chip| chip.shortest_detach = SimDuration::from_millis(3))
}

/// Default path of the firmware's ELF: what the environment variable says, else where
/// `cargo xtask build` or a release puts it, from the folder of this program.
#[must_use]
pub fn default_elf() -> PathBuf {
    if let Some(path) = std::env::var_os(ELF_VARIABLE) {
        return PathBuf::from(path);
    }
    let built = "bare-metal/thumbv7em-none-eabihf/release/smartdepthsync-firmware";
    let released = "share/smartdepthsync/firmware/smartdepthsync-firmware-discovery.elf";
    let own = std::env::current_exe().unwrap_or_default();
    (own.ancestors())
        .flat_map(|folder| [built, released].map(|file| folder.join(file)))
        .find(|elf| elf.is_file())
        .unwrap_or_else(|| built.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rig's wires go to the pins of the one table.
    #[test]
    fn the_wires_are_those_of_the_table() {
        let wires = [
            (TRIGGER, "trigger 1, of the depth camera"),
            (READBACK, "read-back of the trigger"),
            (STROBE, "strobe: comparator of a photodiode, or any event"),
            (IMU_READY, "data-ready of the IMU (INT, INT1)"),
            (SCL, "SCL of the IMU"),
            (SDA, "SDA of the IMU"),
            (IMU_RTC, "32 kHz for CLKIN of an ICM-42688-P"),
            (IMU_CLOCK, "19.2 MHz for CLKIN of an MPU-6050 or MPU-9150"),
            (OUTPUTS[0], "trigger 2"),
            (OUTPUTS[1], "trigger 3"),
            (OUTPUTS[2], "trigger 4"),
            (PPS, "pulse per second for a lidar"),
            (NMEA, "sentences for a lidar"),
            (Pin::PD12, "IMU samples come"),
            (Pin::PD13, "toggles with each pulse"),
            (Pin::PD14, "a fault, or a last run that failed"),
            (Pin::PD15, "a host is linked"),
        ];
        let wires = wires.map(|(pin, signal)| (format!("{pin:?}"), signal));
        let table: Vec<_> = protocol::pins::pins()
            .map(|(pin, _, signal)| (pin.to_owned(), signal))
            .collect();
        assert_eq!(table, wires);
    }
}
