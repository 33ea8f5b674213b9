//! What really happened: the record that every result is judged against.
//!
//! A truth file is JSON lines, one [`TruthRecord`] a line, in no particular
//! order but that [`TruthRecord::Run`] comes first. Board times are
//! [`SimTime`] units (see [`stm32f4_sim::time`]), which are exact; the board's tick
//! count is `floor((at - zero) · 48 MHz)` with the `zero` of
//! [`TruthRecord::Timebase`]. No number goes through a float except rates and
//! rotations.

use std::io::{BufRead, Write};

use anyhow::{Context as _, Result, bail};
use serde::{Deserialize, Serialize};

use crate::depth_camera::{DepthCameraConfig, FrameRecord, TIMESTAMP_HZ};
use crate::imu::{SampleRecord, SimImuConfig, Values};
use crate::oscillator::{BoardTime, Oscillator, OscillatorConfig, TrueTime};
use crate::random::{ALGORITHM, Seed};
use stm32f4_sim::clock::Rate;
use stm32f4_sim::time::{SimTime, UNITS_PER_SECOND};

/// Version of the format; a reader refuses others.
pub const VERSION: u32 = 1;

/// One line of a truth file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TruthRecord {
    /// What was simulated.
    Run(Box<Run>),
    /// The board's time at which its 64-bit tick count was zero.
    Timebase {
        /// In units of board time.
        zero: SimTime,
    },
    /// All clocks at one true time.
    Clocks(Clocks),
    /// An edge of the trigger pin.
    TriggerEdge {
        /// When, in units of board time.
        at: SimTime,
        /// Rising or falling.
        rising: bool,
    },
    /// A sample that the IMU put into its registers.
    ImuSample {
        /// Counted from zero.
        number: u64,
        /// When, in units of board time: the data-ready edge, if there was one.
        at: SimTime,
        /// Whether data-ready made an edge.
        edge: bool,
        /// The registers.
        #[serde(flatten)]
        values: Values,
    },
    /// A frame of the depth camera.
    DepthFrame(FrameRecord),
}

/// The settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// [`VERSION`].
    pub version: u32,
    /// Units of board time and of true time in a second.
    pub units_per_second: u64,
    /// The seed that everything random came from.
    pub seed: Seed,
    /// The generator of random numbers.
    pub random: String,
    /// The motion, as its specification is written.
    pub motion: String,
    /// The board's crystal.
    pub board_clock: OscillatorConfig,
    /// The IMU, if there is one.
    pub imu: Option<SimImuConfig>,
    /// The depth camera, if there is one.
    pub depth_camera: Option<DepthCameraConfig>,
}

impl Run {
    /// A record of this version with no parts but the board.
    #[must_use]
    pub fn new(seed: Seed, motion: String, board_clock: OscillatorConfig) -> Self {
        Self {
            version: VERSION,
            units_per_second: UNITS_PER_SECOND,
            seed,
            random: ALGORITHM.to_owned(),
            motion,
            board_clock,
            imu: None,
            depth_camera: None,
        }
    }
}

/// What all clocks of the rig show at one true time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clocks {
    /// True time, in units.
    pub at: TrueTime,
    /// The board's time, in units.
    pub board: SimTime,
    /// The phone's clock, in its nanoseconds.
    pub phone_ns: Option<i64>,
    /// The depth camera's timestamp counter, without its offset.
    pub camera_ticks: Option<u64>,
}

impl Clocks {
    /// Looks at the clocks.
    #[must_use]
    pub fn at(
        at: TrueTime,
        board: &BoardTime,
        phone: Option<&Oscillator>,
        camera: Option<&Oscillator>,
    ) -> Self {
        Self {
            at,
            board: board.board_at(at),
            phone_ns: phone.map(|clock| clock.nanos_at(at)),
            camera_ticks: camera.map(|clock| clock.ticks_at(at, Rate::hz(TIMESTAMP_HZ))),
        }
    }
}

impl From<SampleRecord> for TruthRecord {
    fn from(sample: SampleRecord) -> Self {
        Self::ImuSample {
            number: sample.number,
            at: sample.at,
            edge: sample.edge,
            values: sample.values,
        }
    }
}

/// Writes a truth file.
#[derive(Debug)]
pub struct TruthWriter<W: Write> {
    to: W,
}

impl<W: Write> TruthWriter<W> {
    /// Begins a file with its first record.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn new(to: W, run: Run) -> Result<Self> {
        let mut writer = Self { to };
        writer.write(&TruthRecord::Run(Box::new(run)))?;
        Ok(writer)
    }

    /// Adds a record.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write(&mut self, record: &TruthRecord) -> Result<()> {
        serde_json::to_writer(&mut self.to, record)?;
        self.to.write_all(b"\n")?;
        Ok(())
    }

    /// Hands on everything that was written.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        Ok(self.to.flush()?)
    }
}

/// Reads a truth file.
///
/// # Errors
/// The file cannot be read, a line is not a record, or it has another version.
pub fn read(from: impl BufRead) -> Result<Vec<TruthRecord>> {
    let mut records = Vec::new();
    for (i, line) in from.lines().enumerate() {
        let line = line?;
        // By way of a value: a dependency (the firmware's log decoder) switches
        // on serde_json's arbitrary precision, with which a tagged enum cannot
        // take numbers straight from the text.
        let record = serde_json::from_str::<serde_json::Value>(&line)
            .and_then(serde_json::from_value)
            .with_context(|| {
                let line = i + 1;
                format!("truth file, line {line}: not a truth record of version {VERSION}")
            })?;
        if let TruthRecord::Run(run) = &record
            && run.version != VERSION
        {
            let found = run.version;
            bail!("the truth file has version {found}, this program reads version {VERSION}");
        }
        records.push(record);
    }
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth_camera::Source;
    use crate::random::Stream;

    fn run() -> Run {
        let mut run = Run::new(Seed(7), "twist".to_owned(), OscillatorConfig::default());
        run.imu = Some(SimImuConfig::typical(Seed(7)));
        run.depth_camera = Some(DepthCameraConfig::default());
        run
    }

    #[test]
    fn every_record_comes_back_as_it_was() {
        let at = SimTime::from_units(u64::MAX - 1);
        let board = BoardTime::new(
            OscillatorConfig {
                rate_ppm: 10.0,
                ..OscillatorConfig::default()
            },
            Seed(7).stream(Stream::BoardClock),
        );
        let records = [
            TruthRecord::Timebase { zero: at },
            TruthRecord::Clocks(Clocks::at(
                TrueTime::from_nanos(1_000_000_000),
                &board,
                Some(board.oscillator()),
                Some(board.oscillator()),
            )),
            TruthRecord::TriggerEdge { at, rising: true },
            TruthRecord::ImuSample {
                number: 3,
                at,
                edge: true,
                values: Values {
                    accel: [1, -2, i16::MIN],
                    temperature: 5,
                    gyro: [7, 8, i16::MAX],
                },
            },
            TruthRecord::DepthFrame(FrameRecord {
                number: 1,
                source: Source::Pulse {
                    number: 2,
                    edge: at,
                },
                first_flash: at,
                center: at,
                center_true: TrueTime::from_units(9),
                device_ticks: 12,
                bad: false,
                delivered: true,
            }),
        ];
        let mut file = Vec::new();
        let mut writer = TruthWriter::new(&mut file, run()).unwrap();
        for record in &records {
            writer.write(record).unwrap();
        }
        writer.flush().unwrap();
        let back = read(file.as_slice()).unwrap();
        assert_eq!(back[0], TruthRecord::Run(Box::new(run())));
        assert_eq!(back[1..], records);
        // The clocks: after a true second the board counts 10 µs more.
        let TruthRecord::Clocks(clocks) = back[2] else {
            panic!("not the clocks");
        };
        assert_eq!(clocks.board, SimTime::from_nanos(1_000_010_000));
        assert_eq!(clocks.phone_ns, Some(1_000_010_000));
        assert_eq!(clocks.camera_ticks, Some(90_000));
    }

    #[test]
    fn files_of_another_version_and_damaged_lines_are_refused() {
        let mut other = run();
        other.version = 9;
        let mut file = Vec::new();
        TruthWriter::new(&mut file, other).unwrap();
        let error = read(file.as_slice()).unwrap_err().to_string();
        assert!(error.contains("version 9"), "{error}");
        let error = read(&b"{\"kind\":\"nonsense\"}\n"[..])
            .unwrap_err()
            .to_string();
        assert!(error.contains("line 1"), "{error}");
    }
}
