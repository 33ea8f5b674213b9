//! The depth camera's part of an extraction: times, pulses, images.

use super::{ExtractError, Extraction};
use crate::board_data::BoardInput;
use crate::depth::{DepthIndex, DepthInput};
use crate::depth_clock::{DepthMatch, FrameState, MatchError};
use crate::depth_match::{self, Matched};
use crate::image_tables::{DepthOutcome, DepthPlace, ImagesError, write_depth};
use crate::layout::calibration_path;
use crate::report::{Constants, DepthReport};
use crate::sequence::Sequences;
use crate::survey::Survey;
use crate::tables::{self, DepthFrame};

/// The depth camera's part after reading.
pub(super) struct Depth {
    pub(super) index: DepthIndex,
    matched: Result<Matched, MatchError>,
    pub(super) frames: Vec<DepthFrame>,
}

impl Extraction<'_> {
    pub(super) fn read_depth(
        &mut self,
        survey: &Survey,
        constants: &mut Constants,
    ) -> Result<Option<Depth>, ExtractError> {
        let input = match (&self.inputs.depth, &self.inputs.board) {
            (Some(input), _) => input.clone(),
            (None, BoardInput::Bag(path)) if survey.images > 0 => DepthInput::Bag(path.clone()),
            _ => {
                self.lose(
                    "depth",
                    "there is no depth recording; give the file with --depth",
                );
                return Ok(None);
            }
        };
        self.inputs.depth = Some(input.clone());
        let length = std::fs::metadata(input.path()).map_or(0, |meta| meta.len());
        self.progress
            .begin("reading the depth recording's times", length);
        let index = match input.index(&mut |position| self.progress.at(position)) {
            Ok(index) => index,
            Err(error) => {
                self.lose("depth", error.to_string());
                return Ok(None);
            }
        };
        self.progress.end();
        for fault in &index.faults {
            self.lose("depth", fault.clone());
        }
        self.set_center(&index, constants);
        let constants = *constants;
        let matched = depth_match::find(
            &self.inputs.board,
            &input,
            &index,
            survey,
            &constants,
            self.job.options.first_pulse,
            self.progress,
        )?;
        match &matched {
            Ok(matched) => {
                self.remarks.extend(matched.remarks.iter().cloned());
                for loss in &matched.losses {
                    self.lose("depth", loss.clone());
                }
                let missing = &matched.found.missing;
                if !missing.is_empty() {
                    let count = missing.len();
                    self.lose("depth", format!("{count} pulses have no depth frame; depth_frames.csv and report.json name them"));
                }
            }
            Err(error) => self.lose("depth", error.to_string()),
        }
        let found = matched.as_ref().ok().map(|matched| &matched.found);
        let frames = tables::depth_frames(&index, found, &survey.pulses, constants.depth_center_ns);
        let broken = frames.iter().filter(|frame| !frame.whole).count();
        if broken > 0 {
            self.lose(
                "depth",
                format!("{broken} depth frames do not hold a whole image"),
            );
        }
        Ok(Some(Depth {
            index,
            matched,
            frames,
        }))
    }

    /// The edge-to-centre time of the camera's mode, where nothing better is known.
    fn set_center(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let given = self
            .job
            .options
            .depth_center_ns
            .or(self.inputs.phone.rig.depth_center_ns);
        if given.is_some() {
            return;
        }
        let mode = index.mode.as_deref();
        match mode.and_then(nominal_center) {
            Some(center) => {
                constants.depth_center_ns = center;
                let mode = mode.unwrap_or_default();
                self.remarks.push(format!(
                    "from pulse to centre of exposure: {:.1} µs, half of the infrared train of mode {mode}; \
                     measure it and give --depth-center-us",
                    center as f64 / 1000.0
                ));
            }
            None => {
                let mode = match mode {
                    Some(mode) => format!("there is no known value for depth mode {mode}"),
                    None => String::from("the depth recording does not say its mode"),
                };
                self.remarks.push(format!(
                    "the time from pulse to centre of exposure is not known ({mode}): depth timestamps \
                     are the pulses; give --depth-center-us"
                ));
            }
        }
    }

    pub(super) fn write_depth_images(
        &mut self,
        depth: Option<&Depth>,
        sequences: &Sequences,
        frames: &[DepthFrame],
    ) -> Result<Option<DepthOutcome>, ExtractError> {
        let (Some(depth), Some(input)) = (depth, self.inputs.depth.clone()) else {
            return Ok(None);
        };
        if depth.matched.is_err() {
            return Ok(None);
        }
        let layout = self.job.format.layout();
        let place_of = |frame: &DepthFrame| match frame.at.filter(|_| frame.is_used()) {
            None => DepthPlace::default(),
            Some(at) => {
                let folder = self.place.out.join(sequences.folder(sequences.at(at)));
                let infrared = layout
                    .infrared_path(at)
                    .filter(|_| self.job.options.infrared);
                DepthPlace {
                    depth: Some(folder.join(layout.depth_path(at))),
                    infrared: infrared.map(|path| folder.join(path)),
                }
            }
        };
        let places: Vec<DepthPlace> = frames.iter().map(place_of).collect();
        let outcome = match self.place.done::<DepthOutcome>("depth") {
            Some(outcome) => outcome,
            None => {
                let written = write_depth(&input, &places, depth.index.size, layout, self.progress);
                match written {
                    Ok(outcome) => {
                        self.place
                            .keep("depth", &outcome)
                            .map_err(|error| self.failed(error))?;
                        outcome
                    }
                    Err(ImagesError::Depth(error)) => {
                        self.lose("depth", error.to_string());
                        return Ok(None);
                    }
                    Err(error) => return Err(error.into()),
                }
            }
        };
        let counts = [
            (
                &outcome.damaged,
                "depth frames lie in a part of the file whose checksum is wrong",
            ),
            (
                &outcome.empty,
                "depth frames are black: no pixel has a depth",
            ),
        ];
        for (frames, what) in counts {
            if !frames.is_empty() {
                let first: Vec<String> = frames.iter().take(10).map(ToString::to_string).collect();
                self.lose(
                    "depth",
                    format!("{} {what} (frames {} ...)", frames.len(), first.join(" ")),
                );
            }
        }
        if outcome.out_of_range > 0 {
            self.lose(
                "depth",
                format!(
                    "{} pixels lie beyond the 13.107 m that the format can hold and became 0",
                    outcome.out_of_range
                ),
            );
        }
        Ok(Some(outcome))
    }

    pub(super) fn write_calibration(&self, depth: Option<&Depth>) -> Result<(), ExtractError> {
        let Some(calibration) = depth.and_then(|depth| depth.index.calibration.as_ref()) else {
            return Ok(());
        };
        self.write(calibration_path(self.job.format), calibration)
    }
}

/// Half of the train of infrared pulses, ns: 12.725 ms of 9 pulses each 1,575 µs
/// (narrow modes and binned wide), 20.245 ms of 9 pulses each 2,515 µs (wide
/// unbinned); each pulse is 125 µs. From the vendor's table of multi-camera delays.
#[must_use]
pub fn nominal_center(mode: &str) -> Option<i64> {
    match mode {
        "NFOV_UNBINNED" | "NFOV_2X2BINNED" | "WFOV_2X2BINNED" => Some(6_362_500),
        "WFOV_UNBINNED" => Some(10_122_500),
        _ => None,
    }
}

impl Depth {
    pub(super) fn report(&self, survey: &Survey, images: Option<&DepthOutcome>) -> DepthReport {
        let those = |is_so: &dyn Fn(&DepthFrame) -> bool| -> Vec<usize> {
            let frames = self.frames.iter().enumerate();
            frames
                .filter(|(_, frame)| is_so(frame))
                .map(|(index, _)| index)
                .collect()
        };
        let of = |state| those(&|frame| frame.state == Some(state));
        let found: Option<&DepthMatch> = self.matched.as_ref().ok().map(|matched| &matched.found);
        let number = |pulse: &usize| survey.pulses.get(*pulse).map(|pulse| pulse.number);
        DepthReport {
            frames: self.frames.len(),
            matched: of(FrameState::Matched).len(),
            decided_by: self
                .matched
                .as_ref()
                .map_or_else(|_| String::new(), |matched| matched.decided_by()),
            not_matched: self.matched.as_ref().err().map(ToString::to_string),
            rate_ppm: found.map(|found| (found.rate_error * 1e6, found.rate_sigma * 1e6)),
            residual_us: found.map(|found| found.residual / 1000.0),
            missing: found.map_or_else(Vec::new, |found| {
                found.missing.iter().filter_map(number).collect()
            }),
            doubled: of(FrameState::Doubled),
            off_pulse: of(FrameState::OffPulse),
            before_first_pulse: of(FrameState::BeforeFirstPulse).len(),
            after_last_pulse: of(FrameState::AfterLastPulse).len(),
            broken: those(&|frame| !frame.whole),
            damaged: images.map_or_else(Vec::new, |images| images.damaged.clone()),
            empty: images.map_or_else(Vec::new, |images| images.empty.clone()),
            out_of_range: images.map_or(0, |images| images.out_of_range),
            images: images.map_or(0, |images| images.written),
            infrared: images.map_or(0, |images| images.infrared.len() as u64),
            mode: self.index.mode.clone(),
            serial: self.index.serial.clone(),
        }
    }
}
