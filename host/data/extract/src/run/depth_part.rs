//! The depth camera's part of an extraction: times, pulses, images.

use super::{Extraction, depth_wording, rate_of};
use crate::constants::Constants;
use crate::depth::depth_clock::{DepthMatch, FrameState, MatchError};
use crate::depth::k4a::ColorTrack;
use crate::depth::matching::{Matched, Matching};
use crate::depth::ros2_bag::Ros2Bag;
use crate::depth::{DepthIndex, DepthInput};
use crate::error::ExtractError;
use crate::frames::{self, CameraFrame, DepthFrame};
use crate::geometry::DepthView;
use crate::inputs::survey::Survey;
use crate::layout::{DataSetInfo, ImageKind, calibration_path};
use crate::output::images::{CameraPaths, DepthImageView, DepthOutcome, DepthPaths, write_depth};
use crate::output::sequences::Sequences;
use crate::output::tables;
use crate::report::{DepthReport, LossPart};
use recording::camera::Center;

/// The depth recording and the times of its frames.
pub(super) struct Depth {
    pub(super) index: DepthIndex,
    matched: Result<DepthMatch, MatchError>,
    pub(super) frames: Vec<DepthFrame>,
    /// The camera's colour images.
    pub(super) color: Vec<CameraFrame>,
}

impl Extraction<'_> {
    /// Reads the times of the depth recording, and matches its frames to pulses. Adds what the
    /// recording says about the time to the centre of exposure to `constants`.
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
                self.lose(LossPart::Depth, depth_wording::NO_RECORDING);
                return Ok(None);
            }
        };
        self.inputs.depth = Some(input.clone());
        let index = match input.index(&self.job.monitor) {
            Ok(index) => index,
            Err(error) => {
                self.lose(LossPart::Depth, error.to_string());
                return Ok(None);
            }
        };
        for fault in &index.faults {
            self.lose(LossPart::Depth, fault.clone());
        }
        self.set_center(&index, constants);
        let mut has_seen = false;
        if let Some((seen, _)) = &survey.exposures
            && let Some((change_ns, disagrees)) = constants.see_depth(seen)
        {
            has_seen = true;
            self.remarks
                .push(depth_wording::own_strobes(seen, change_ns, disagrees));
        }
        let constants = *constants;
        let matched = self.match_depth(&input, &index, survey, &constants)?;
        if let Some(by) = &index.rewritten {
            self.lose(LossPart::Depth, by.clone());
        }
        let matched = matched.map(
            |Matched {
                 found,
                 offset_alone,
             }| {
                if let Some(error) = offset_alone {
                    self.remarks.push(depth_wording::offset_alone(&error));
                }
                let missing = found.missing.len();
                if missing > 0 {
                    self.lose(LossPart::Depth, depth_wording::missing(missing));
                }
                found
            },
        );
        match &matched {
            Ok(_) => {}
            Err(error) if index.rewritten.is_none() => {
                self.lose(LossPart::Depth, error.to_string());
            }
            // Rounded times explain it.
            Err(_) => self.lose(LossPart::Depth, depth_wording::ROUNDED),
        }
        let found = matched.as_ref().ok();
        let seen = survey.exposures.as_ref().filter(|_| has_seen);
        let seen = seen.map_or(&[][..], |(_, each)| each);
        let center = constants.depth_center_ns;
        let frames = frames::depth_frames(&index, found, &survey.pulses, seen, center);
        let broken = frames.iter().filter(|frame| !frame.whole).count();
        if broken > 0 {
            self.lose(LossPart::Depth, depth_wording::broken(broken));
        }
        let color = frames::camera_frames(&index.color_frames, &frames, found);
        self.write_camera_table(&index, &color)?;
        Ok(Some(Depth {
            index,
            matched,
            frames,
            color,
        }))
    }

    /// Matches depth frames to pulses, unless the camera was not configured to follow them.
    fn match_depth(
        &self,
        input: &DepthInput,
        index: &DepthIndex,
        survey: &Survey,
        constants: &Constants,
    ) -> Result<Result<Matched, MatchError>, ExtractError> {
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
            return Ok(Err(MatchError::OtherSync { sync }));
        }
        matching.find(self.job.options.first_pulse)
    }

    /// Writes the times of the camera's colour images.
    fn write_camera_table(
        &mut self,
        index: &DepthIndex,
        frames: &[CameraFrame],
    ) -> Result<(), ExtractError> {
        let Some(color) = &index.color else {
            return Ok(());
        };
        if !color.is_jpeg() {
            self.lose(LossPart::Depth, depth_wording::no_jpeg(&color.format));
        }
        let exposure = self.inputs.color_exposure_ns;
        let path = self.output.out.join("camera_frames.csv");
        tables::write_camera(&path, frames, exposure).map_err(|error| self.failed(error))
    }

    /// Sets the time from pulse to centre of exposure: the profile's or the mode's nominal one,
    /// corrected by the mode and the delays in the file, and by a colour camera that exposes
    /// longer.
    fn set_center(&mut self, index: &DepthIndex, constants: &mut Constants) {
        if constants.is_center_known {
            self.correct_for_mode(index, constants);
        } else {
            self.set_nominal_center(index, constants);
        }
        // Without colour the recorder's library refuses a delay of depth after it.
        let after_color = index.depth_delay * i64::from(index.color.is_some());
        let delay = index.subordinate_delay.saturating_add(after_color);
        if index.subordinate_delay != 0 || after_color != 0 {
            constants.delay_depth(delay);
            let remark = depth_wording::file_delays(index.subordinate_delay, after_color, delay);
            self.remarks.push(remark);
        }
        if index.color.is_some() {
            self.add_color_exposure(index, constants);
        }
    }

    /// Delays depth by half of what the colour exposure is longer than the train of infrared
    /// pulses: the camera centres colour and depth on each other, and begins with the longer
    /// exposure (issue 868 of the camera's SDK).
    fn add_color_exposure(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let half_train = index.mode.as_deref().and_then(|mode| self.nominal(mode));
        let (Some(exposure), Some(half_train)) = (self.inputs.color_exposure_ns, half_train) else {
            self.remarks.push(depth_wording::color_exposure_unknown());
            return;
        };
        let later = (exposure / 2 - half_train).max(0);
        constants.delay_depth(later);
        if later > 0 {
            let remark = depth_wording::delayed_by_color(later, exposure);
            self.remarks.push(remark);
        }
    }

    /// Corrects the profile's time to the centre of exposure if the file was recorded in
    /// another mode.
    fn correct_for_mode(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let (Some(file), Some(profile)) = (&index.mode, &self.inputs.depth_mode) else {
            return;
        };
        if file == profile {
            return;
        }
        let change = self.nominal(file).zip(self.nominal(profile));
        let change = change.map(|(file, profile)| file - profile);
        constants.delay_depth(change.unwrap_or(0));
        let remark = depth_wording::other_mode(file, profile, change);
        self.remarks.push(remark);
    }

    /// Returns the time from the edge to the centre of exposure in a mode of the camera, ns, if
    /// the mode has a constant one.
    fn nominal(&self, mode: &str) -> Option<i64> {
        match self.inputs.camera?.mode(mode)?.center {
            Center::Fixed(center_us) => Some((center_us * 1e3).round() as i64),
            Center::Begins(_) | Center::EndsAtNext => None,
        }
    }

    /// Sets the nominal time to the centre of exposure of the file's mode, if it has one.
    fn set_nominal_center(&mut self, index: &DepthIndex, constants: &mut Constants) {
        let mode = index.mode.as_deref();
        let nominal = mode.and_then(|mode| Some((mode, self.nominal(mode)?)));
        self.remarks.push(match nominal {
            Some((mode, center)) => {
                constants.depth_center_ns = center;
                depth_wording::nominal_center(mode, center)
            }
            None => depth_wording::unknown_center(mode),
        });
    }

    /// Writes the images of the depth camera, and reports what is wrong with them.
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
            DepthView::Unavailable => return Ok(None),
            DepthView::Own => None,
            DepthView::Registered(registration) => Some(&**registration),
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
        let stored = self.output.outcome::<DepthOutcome>("depth");
        let outcome = match stored.filter(|outcome| self.is_joined || outcome.is_there(&paths)) {
            Some(outcome) => outcome,
            None => {
                let view = DepthImageView {
                    size: depth.index.size,
                    registration,
                };
                match write_depth(&input, &paths, view, layout, &self.job.monitor) {
                    Ok(outcome) => {
                        self.output
                            .store("depth", &outcome)
                            .map_err(|error| self.failed(error))?;
                        outcome
                    }
                    Err(ExtractError::Depth(error)) => {
                        self.lose(LossPart::Depth, error.to_string());
                        self.unfinished = true;
                        return Ok(None);
                    }
                    Err(error) => return Err(error),
                }
            }
        };
        // While the trigger starts, a camera adopts its phase in frames without depth.
        let recorded = self.inputs.recorded;
        let is_outside = |&&index: &&usize| {
            let at = frames.get(index).and_then(|frame| frame.at);
            let both = recorded.zip(at);
            both.is_some_and(|((from, to), at)| !(from..=to).contains(&at.0))
        };
        let (outside, empty): (Vec<usize>, Vec<usize>) = outcome.empty.iter().partition(is_outside);
        if !outside.is_empty() {
            self.remarks.push(depth_wording::outside(outside.len()));
        }
        let counts = [
            (&outcome.damaged, depth_wording::DAMAGED),
            (&empty, depth_wording::BLACK),
            (&outcome.color_broken, depth_wording::COLOR_BROKEN),
        ];
        for (frames, fault) in counts {
            if !frames.is_empty() {
                self.lose(LossPart::Depth, depth_wording::faulty_frames(frames, fault));
            }
        }
        if outcome.out_of_range > 0 {
            self.lose(
                LossPart::Depth,
                depth_wording::out_of_range(outcome.out_of_range),
            );
        }
        Ok(Some(outcome))
    }

    /// Writes the camera's calibration as the recording has it.
    pub(super) fn write_calibration(&self, depth: Option<&Depth>) -> Result<(), ExtractError> {
        let Some(calibration) = depth.and_then(|depth| depth.index.calibration.as_ref()) else {
            return Ok(());
        };
        self.write(calibration_path(self.job.format), calibration)
    }
}

impl Depth {
    /// Returns the rates and sizes of its data, as seen in `view`.
    pub(super) fn facts(&self, view: &DepthView) -> DataSetInfo {
        let size = match view {
            DepthView::Registered(registration) => registration.out,
            _ => self.index.size,
        };
        DataSetInfo {
            depth_rate: rate_of(self.frames.iter().filter_map(|frame| frame.at)),
            depth_size: Some(size),
            infrared_size: Some(self.index.size),
            registered: matches!(view, DepthView::Registered(_)),
            camera_rate: rate_of(self.color.iter().filter_map(|frame| frame.at)),
            camera_size: self.index.color.as_ref().map(|color| color.size),
            ..DataSetInfo::default()
        }
    }

    /// Reports the frames and, if there are any, the written images.
    pub(super) fn report(&self, survey: &Survey, images: Option<&DepthOutcome>) -> DepthReport {
        let indices = |matches: &dyn Fn(&DepthFrame) -> bool| -> Vec<usize> {
            let frames = self.frames.iter().enumerate();
            frames
                .filter(|(_, frame)| matches(frame))
                .map(|(index, _)| index)
                .collect()
        };
        let in_state = |state| indices(&|frame| frame.state == Some(state));
        let found = self.matched.as_ref().ok();
        let number = |pulse: &usize| survey.pulses.get(*pulse).map(|pulse| pulse.number);
        DepthReport {
            frames: self.frames.len(),
            matched: in_state(FrameState::Matched).len(),
            decided_by: found.map(|found| found.decision),
            not_matched: self.matched.as_ref().err().cloned(),
            rate_ppm: found.map(|found| (found.rate_error * 1e6, found.rate_sigma * 1e6)),
            residual_us: found.map(|found| found.residual / 1000.0),
            missing: found.map_or_else(Vec::new, |found| {
                found.missing.iter().filter_map(number).collect()
            }),
            doubled: in_state(FrameState::Doubled),
            off_pulse: in_state(FrameState::OffPulse),
            before_first_pulse: in_state(FrameState::BeforeFirstPulse).len(),
            after_last_pulse: in_state(FrameState::AfterLastPulse).len(),
            broken: indices(&|frame| !frame.whole),
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
