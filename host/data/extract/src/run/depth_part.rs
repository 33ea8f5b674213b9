//! The depth camera's part of an extraction: times, pulses, images.

use super::geometry_part::DepthView;
use super::{Extraction, rate_of};
use crate::constants::Constants;
use crate::depth::depth_clock::{DepthMatch, FrameState, MatchError};
use crate::depth::k4a::ColorTrack;
use crate::depth::matching::{Matched, Matching};
use crate::depth::ros2_bag::Ros2Bag;
use crate::depth::{DepthIndex, DepthInput};
use crate::error::ExtractError;
use crate::inputs::survey::Survey;
use crate::layout::{DataSetInfo, ImageKind, calibration_path, number};
use crate::output::images::{CameraPaths, DepthImageView, DepthOutcome, DepthPaths, write_depth};
use crate::output::sequences::Sequences;
use crate::output::tables::{self, CameraFrame, DepthFrame};
use crate::report::DepthReport;
use recording::camera::Center;

/// The depth camera's part after reading.
pub(super) struct Depth {
    pub(super) index: DepthIndex,
    matched: Result<Matched, String>,
    pub(super) frames: Vec<DepthFrame>,
    /// Colour images of the camera.
    pub(super) color: Vec<CameraFrame>,
}

impl Extraction<'_> {
    pub(super) fn read_depth(
        &mut self,
        survey: &Survey,
        constants: &mut Constants,
    ) -> Result<Option<Depth>, ExtractError> {
        let input = match &self.inputs.depth {
            Some(input) => input.clone(),
            // The published system has all in one bag.
            None if survey.published => DepthInput::Ros2(Ros2Bag {
                path: self.inputs.board.clone(),
                topic: self.job.options.depth_topic.clone(),
            }),
            None => {
                self.lose(
                    "depth",
                    "there is no depth recording; give the file with --depth",
                );
                return Ok(None);
            }
        };
        self.inputs.depth = Some(input.clone());
        let index = match input.index(&self.job.monitor) {
            Ok(index) => index,
            Err(error) => {
                self.lose("depth", error.to_string());
                return Ok(None);
            }
        };
        for fault in &index.faults {
            self.lose("depth", fault.clone());
        }
        self.set_center(&index, constants);
        let constants = *constants;
        let matched = match self.match_depth(&input, &index, survey, &constants) {
            Err(error) if error.is_fatal() => return Err(error),
            matched => matched.map_err(|error| error.to_string()),
        };
        if let Some(by) = &index.rewritten {
            self.lose("depth", by.clone());
        }
        match &matched {
            Ok(matched) => {
                self.remarks.extend(matched.remarks.iter().cloned());
                let missing = &matched.found.missing;
                if !missing.is_empty() {
                    let count = missing.len();
                    self.lose("depth", format!("{count} pulses have no depth frame; depth_frames.csv and report.json name them"));
                }
            }
            Err(error) if index.rewritten.is_none() => self.lose("depth", error.clone()),
            // Times that are rounded explain it.
            Err(_) => self.lose(
                "depth",
                "with rounded times it is not found which pulse made which depth frame",
            ),
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
        let color = tables::camera_frames(&index.color_frames, &frames, found);
        self.write_camera_table(&index, &color)?;
        Ok(Some(Depth {
            index,
            matched,
            frames,
            color,
        }))
    }

    /// Depth frames and their pulses.
    fn match_depth(
        &self,
        input: &DepthInput,
        index: &DepthIndex,
        survey: &Survey,
        constants: &Constants,
    ) -> Result<Matched, ExtractError> {
        let matching = Matching {
            board: &self.inputs.board,
            input,
            index,
            survey,
            constants,
            monitor: &self.job.monitor,
        };
        if let Some(sync) = index.sync.as_ref().filter(|sync| *sync != "SUBORDINATE") {
            let sync = sync.chars().take(32).collect();
            let error = MatchError::OtherSync { sync };
            return Err(ExtractError::Missing(error.to_string()));
        }
        matching.find(self.job.options.first_pulse)
    }

    fn write_camera_table(
        &mut self,
        index: &DepthIndex,
        frames: &[CameraFrame],
    ) -> Result<(), ExtractError> {
        let Some(color) = &index.color else {
            return Ok(());
        };
        if !color.is_jpeg() {
            let format: String = color.format.chars().filter(|c| !c.is_control()).collect();
            self.lose(
                "depth",
                format!(
                    "the camera's colour images are {format}, expected MJPG: their times are in \
                     camera_frames.csv, and no images are written; record with an MJPG colour mode"
                ),
            );
        }
        let exposure = self.inputs.color_exposure_ns;
        let path = self.output.out.join("camera_frames.csv");
        tables::write_camera(&path, frames, exposure).map_err(|error| self.failed(error))
    }

    /// From the pulse to the centre of exposure: the profile's, or the nominal one of the mode,
    /// made to fit to what the file says: its mode, its delays, and a colour camera that exposes
    /// longer.
    fn set_center(&mut self, index: &DepthIndex, constants: &mut Constants) {
        match constants.is_center_known {
            true => self.compare_mode(index, constants),
            false => self.nominal_center(index, constants),
        }
        // Without colour the recorder's library refuses a delay of depth behind it.
        let behind_color = index.depth_delay * i64::from(index.color.is_some());
        let delay = index.subordinate_delay.saturating_add(behind_color);
        if index.subordinate_delay != 0 || behind_color != 0 {
            constants.delay_depth(delay);
            self.remarks.push(format!(
                "the depth camera's file has delays that the profile does not know: \
                 {} µs after the trigger (K4A_SUBORDINATE_DELAY_NS) and {} µs of depth after colour \
                 (K4A_DEPTH_DELAY_NS); depth is timed {} µs later by that",
                micros(index.subordinate_delay),
                micros(behind_color),
                micros(delay)
            ));
        }
        if index.color.is_some() {
            self.add_color_exposure(index, constants);
        }
    }

    /// The camera puts the centres of colour and depth on one another, and begins with
    /// the longer exposure (issue 868 of the camera's SDK): a colour exposure longer than
    /// the train of infrared pulses makes depth later by half of the difference.
    fn add_color_exposure(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let half_train = index.mode.as_deref().and_then(|mode| self.nominal(mode));
        let (Some(exposure), Some(half_train)) = (self.inputs.color_exposure_ns, half_train) else {
            self.remarks.push(String::from(
                "the depth camera recorded colour too: it exposes depth later by half of what the colour \
                 exposure is longer than the train of infrared pulses (12.725 ms; WFOV_UNBINNED 20.245 ms). \
                 The file does not say that exposure: set color_exposure_us in the rig profile if it may be longer, then extract with `--profile rig.toml`",
            ));
            return;
        };
        let later = (exposure / 2 - half_train).max(0);
        constants.delay_depth(later);
        if later > 0 {
            self.remarks.push(format!(
                "depth is timed {} µs later, because the camera exposed colour for {} µs",
                micros(later),
                micros(exposure)
            ));
        }
    }

    /// The file's mode decides where the profile has another.
    fn compare_mode(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let (Some(file), Some(profile)) = (&index.mode, &self.inputs.depth_mode) else {
            return;
        };
        if file == profile {
            return;
        }
        let change = self.nominal(file).zip(self.nominal(profile));
        let change = change.map(|(file, profile)| file - profile);
        let file: String = file.chars().take(32).collect();
        let what = match change {
            Some(0) => {
                String::from("the time from pulse to centre of exposure is the same in both")
            }
            Some(change) => format!(
                "depth is timed {} µs later than the profile's center_offset_us says, by the difference of \
                 the modes",
                micros(change)
            ),
            None => String::from(
                "the time from pulse to centre of exposure is the profile's; set its center_offset_us, then extract with `--profile rig.toml`",
            ),
        };
        constants.delay_depth(change.unwrap_or(0));
        self.remarks.push(format!(
            "the depth camera recorded in mode {file} and the profile says {profile}: {what}"
        ));
    }

    /// From the edge to the middle of exposure in a mode of the camera, ns, where that is
    /// always the same.
    fn nominal(&self, mode: &str) -> Option<i64> {
        match self.inputs.camera?.mode(mode)?.center {
            Center::Fixed(center_us) => Some((center_us * 1e3).round() as i64),
            Center::Begins(_) | Center::EndsAtNext => None,
        }
    }

    /// The edge-to-centre time of the camera's mode, where nothing better is known.
    fn nominal_center(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let mode = index.mode.as_deref();
        match mode.and_then(|mode| self.nominal(mode)) {
            Some(center) => {
                constants.depth_center_ns = center;
                let mode = mode.unwrap_or_default();
                self.remarks.push(format!(
                    "from pulse to centre of exposure: {:.1} µs, half of the infrared train of mode {mode}; \
                     measure it, set center_offset_us in the rig profile, then extract with `--profile rig.toml`",
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
                     are the pulses; set center_offset_us in the rig profile, then extract with `--profile rig.toml`"
                ));
            }
        }
    }

    pub(super) fn write_depth_images(
        &mut self,
        depth: Option<&Depth>,
        view: &DepthView,
        sequences: &Sequences,
        frames: &[DepthFrame],
    ) -> Result<Option<DepthOutcome>, ExtractError> {
        let (Some(depth), Some(input)) = (depth, self.inputs.depth.clone()) else {
            return Ok(None);
        };
        let registration = match view {
            _ if depth.matched.is_err() => return Ok(None),
            DepthView::None => return Ok(None),
            DepthView::Own => None,
            DepthView::Other(registration) => Some(&**registration),
        };
        let layout = self.layout();
        let path = |kind, at| {
            let folder = self.output.out.join(sequences.folder(sequences.at(at)));
            Some(folder.join(layout.image_path(kind, at)?))
        };
        let paths_of = |frame: &DepthFrame| match frame.at.filter(|_| frame.is_used()) {
            None => DepthPaths::default(),
            Some(at) => DepthPaths {
                depth: path(ImageKind::Depth, at),
                infrared: path(ImageKind::Infrared, at).filter(|_| self.job.options.infrared),
            },
        };
        let is_jpeg = depth.index.color.as_ref().is_some_and(ColorTrack::is_jpeg);
        let color_path = |frame: &CameraFrame| {
            let at = frame.at.filter(|_| is_jpeg)?;
            path(ImageKind::Camera, at)
        };
        let paths = CameraPaths {
            depth: frames.iter().map(paths_of).collect(),
            color: depth.color.iter().map(color_path).collect(),
        };
        let outcome = match self.output.done::<DepthOutcome>("depth") {
            Some(outcome) => outcome,
            None => {
                let view = DepthImageView {
                    size: depth.index.size,
                    registration,
                };
                match write_depth(&input, &paths, view, layout, &self.job.monitor) {
                    Ok(outcome) => {
                        self.output
                            .keep("depth", &outcome)
                            .map_err(|error| self.failed(error))?;
                        outcome
                    }
                    Err(ExtractError::Depth(error)) => {
                        self.lose("depth", error.to_string());
                        self.unfinished = true;
                        return Ok(None);
                    }
                    Err(error) => return Err(error),
                }
            }
        };
        // As the trigger starts, a camera takes up its phase in frames without depth.
        let recorded = self.inputs.recorded;
        let is_outside = |&&index: &&usize| {
            let at = frames.get(index).and_then(|frame| frame.at);
            let both = recorded.zip(at);
            both.is_some_and(|((from, to), at)| !(from..=to).contains(&at.0))
        };
        let (outside, empty): (Vec<usize>, Vec<usize>) = outcome.empty.iter().partition(is_outside);
        if !outside.is_empty() {
            self.remarks.push(format!(
                "depth frames without depth from before the trigger was aligned or after the \
                 recording: {}",
                outside.len()
            ));
        }
        let counts = [
            (
                &outcome.damaged,
                "depth frames lie in a part of the file whose checksum is wrong",
            ),
            (&empty, "depth frames are black: no pixel has a depth"),
            (
                &outcome.color_broken,
                "colour images of the depth camera are no whole JPEG files",
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

/// Nanoseconds as people write microseconds.
fn micros(nanos: i64) -> String {
    number(nanos as f64 / 1000.0, 3)
}

impl Depth {
    /// What is known about its data, seen like this.
    pub(super) fn facts(&self, view: &DepthView) -> DataSetInfo {
        let size = match view {
            DepthView::Other(registration) => registration.out,
            _ => self.index.size,
        };
        DataSetInfo {
            depth_rate: rate_of(self.frames.iter().filter_map(|frame| frame.at)),
            depth_size: Some(size),
            infrared_size: Some(self.index.size),
            registered: matches!(view, DepthView::Other(_)),
            camera_rate: rate_of(self.color.iter().filter_map(|frame| frame.at)),
            camera_size: self.index.color.as_ref().map(|color| color.size),
            ..DataSetInfo::default()
        }
    }

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
            not_matched: self.matched.as_ref().err().cloned(),
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
            color: images.map_or(0, |images| images.color.len() as u64),
            sync: self.index.sync.clone(),
            mode: self.index.mode.clone(),
            serial: self.index.serial.clone(),
        }
    }
}
