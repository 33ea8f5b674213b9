//! Writes down the truth of a rig while it runs.
//!
//! [`TruthRecorder::poll`] is called now and then between steps of the rig. It
//! takes what the models have noted, the edges of the trigger pin, and once a
//! virtual second what all clocks show, so the models' own notes stay short.

use std::io::Write;

use anyhow::Result;

use crate::rig_config::RigParts;
use crate::run_truth::zero_of;
use crate::truth::{TruthRecord, TruthWriter};
use crate::wiring;
use stm32f4_sim::pin::Level;
use stm32f4_sim::shared::lock;
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::{SimDuration, SimTime};

/// Board time from one wrap of the timer's 32-bit counter to the next.
const WRAP: u64 = wiring::UNITS_PER_TICK << 32;
/// How often the clocks are read.
const CLOCKS: SimDuration = SimDuration::from_secs(1);

/// Keeps a truth file.
#[derive(Debug)]
pub(crate) struct TruthRecorder<W: Write> {
    writer: TruthWriter<W>,
    parts: RigParts,
    next_clocks: SimTime,
    zero: Option<SimTime>,
}

impl<W: Write> TruthRecorder<W> {
    /// Begins the file of a rig with these parts. The trigger's edges are
    /// taken from the rig's edge log from now on.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn new(to: W, rig: &mut Sim, parts: &RigParts) -> Result<Self> {
        rig.log_pin(wiring::TRIGGER);
        Ok(Self {
            writer: TruthWriter::new(to, parts.run_record())?,
            parts: parts.clone(),
            next_clocks: rig.now(),
            zero: None,
        })
    }

    /// Writes what has happened since the last call. Between two calls there
    /// must be less than a wrap of the board's counter (89 s).
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn poll(&mut self, rig: &mut Sim) -> Result<()> {
        self.timebase(rig)?;
        for (pin, level, at) in rig.take_edges() {
            if pin == wiring::TRIGGER {
                let rising = level == Level::High;
                self.writer
                    .write(&TruthRecord::TriggerEdge { at, rising })?;
            }
        }
        for record in self.parts.take_records() {
            self.writer.write(&record)?;
        }
        while self.next_clocks <= rig.now() {
            let at = self.parts.board.true_at(self.next_clocks);
            let clocks = self.parts.clocks_at(at);
            self.writer.write(&TruthRecord::Clocks(clocks))?;
            self.next_clocks += CLOCKS;
        }
        Ok(())
    }

    /// Notes where the board's tick count is zero: after power-on, and anew
    /// after a reset.
    fn timebase(&mut self, rig: &Sim) -> Result<()> {
        let Some(zero) = zero_of(rig) else {
            return Ok(());
        };
        let goes_on = self
            .zero
            .is_some_and(|before| zero.units().abs_diff(before.units()) % WRAP == 0);
        if !goes_on {
            self.zero = Some(zero);
            self.writer.write(&TruthRecord::Timebase { zero })?;
        }
        Ok(())
    }

    /// Hands on everything that was written.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn flush(&mut self) -> Result<()> {
        self.writer.flush()
    }
}

impl RigParts {
    /// Takes what the parts have noted since the last call, part by part.
    #[must_use]
    pub(crate) fn take_records(&self) -> Vec<TruthRecord> {
        let mut records = Vec::new();
        if let Some(imu) = &self.imu {
            let samples = lock(imu).log_mut().take();
            records.extend(samples.into_iter().map(TruthRecord::from));
        }
        if let Some(camera) = &self.depth_camera {
            let frames = lock(camera).take_frames();
            records.extend(frames.into_iter().map(TruthRecord::DepthFrame));
        }
        records
    }
}
