//! The phone's part of an extraction: timestamps, clock, images, samples.

use std::path::PathBuf;

use phone::coverage;
use phone::video::{Pixels, Video, VideoError, presentation_times};
use phone::video_files::VideoFiles;

use super::Extraction;
use super::depth_wording::WITH_PROFILE;
use crate::clocks::phone_clock::{self, PhoneClock};
use crate::error::ExtractError;
use crate::faults::Faults;
use crate::frames::video_rows::{VideoRows, match_by_time};
use crate::frames::{self, ColorFrame};
use crate::inputs::PhoneInput;
use crate::inputs::phone_rows::PhoneRows;
use crate::inputs::survey::{ImuSpan, Survey};
use crate::layout::ImageKind;
use crate::output::images::{VideoOutcome, write_video};
use crate::output::imu_tables::{AccelInterpolator, TableWriter, in_board_time};
use crate::output::sequences::Sequences;
use crate::report::{ClockReport, LossPart, PhoneReport};
use crate::time::PhoneNanos;

/// A phone's timestamps in board time.
pub(super) struct Phone {
    name: String,
    /// Number of images that the video should have.
    images: usize,
    /// Number of timestamps.
    stamps: usize,
    /// True if a mismatch of video and timestamps has been reported.
    has_mismatch: bool,
    pub(super) frames: Vec<ColorFrame>,
    pub(super) clock: Option<PhoneClock>,
}

/// Summary of a phone's samples.
#[derive(Default)]
pub(super) struct PhoneImu {
    gyro: u64,
    rows: u64,
    pub(super) rate: Option<f64>,
}

impl Extraction<'_> {
    /// Reads a phone's timestamps, and relates its clock to the board's.
    pub(super) fn read_phone(
        &mut self,
        input: &PhoneInput,
        survey: &Survey,
    ) -> Result<Option<Phone>, ExtractError> {
        let Some(files) = input.files.clone() else {
            let option = match input.other_name() {
                Some(name) => format!("--phone {name}=PATH"),
                None => String::from("--phone"),
            };
            let copy = input.copy.as_ref();
            let copy = copy.map_or(String::new(), |copy| {
                format!("`{copy}` copies them by USB, or ")
            });
            let what = format!(
                "there are no files of the phone (its video .mp4 and beside it the .csv files of frame \
                 timestamps, gyroscope and accelerometer); {copy}give the folder that has them with {option}"
            );
            self.lose(LossPart::Phone, input.about(&what));
            return Ok(None);
        };
        for what in files.missing() {
            let copy = input.copy.as_ref();
            let copy = copy.map_or(String::new(), |copy| format!("; `{copy}` copies it by USB"));
            let what = format!("there is no {what}{copy}");
            self.lose(LossPart::Phone, input.about(&what));
        }
        self.compare_files(input, &files)?;
        let mut rows_of_frames = Vec::new();
        if let Some(path) = &files.frames {
            let read = PhoneRows::open(path, &self.job.monitor);
            let read = read.and_then(|mut rows| Ok((rows.timestamps()?, rows)));
            match read {
                Ok((mut read, rows)) => {
                    let boot = |stamp: &mut PhoneNanos| {
                        stamp.0 = stamp.0.saturating_add(input.boot_minus_frames_ns);
                    };
                    read.iter_mut().flatten().for_each(boot);
                    rows_of_frames = read;
                    self.note_faults(input, "frame timestamps", rows.faults());
                }
                Err(error) => {
                    let what = format!("reading {}: {error}", path.display());
                    self.lose(LossPart::Phone, input.about(&what));
                }
            }
        }
        let stamps: Vec<PhoneNanos> = rows_of_frames.iter().flatten().copied().collect();
        let board = &self.inputs.board;
        let clock = match phone_clock::find(board, input, survey, &self.job.monitor) {
            Ok(clock) => {
                let about = clock.remarks.iter().map(|remark| input.about(remark));
                self.remarks.extend(about);
                Some(clock)
            }
            Err(error) if error.is_fatal() => return Err(error),
            Err(error) => {
                self.lose(LossPart::Clock, input.about(&error.to_string()));
                None
            }
        };
        let constants = &input.constants;
        if !constants.is_middle_known && !stamps.is_empty() {
            self.remarks.push(input.about(
                &format!(
                    "exposure or readout of the phone is not known: its images' times are earlier than the \
                     middle of exposure by half of what is missing; set exposure_us and readout_us in the rig profile, {WITH_PROFILE}"
                ),
            ));
        }
        let matched = self.match_video(input, &files, &rows_of_frames);
        let mut images = vec![None; stamps.len()];
        for (image, row) in matched.rows.iter().enumerate() {
            if let Some(slot) = row.and_then(|row| images.get_mut(row)) {
                *slot = Some(image);
            }
        }
        let frames = clock.as_ref().map_or_else(Vec::new, |clock| {
            frames::color_frames(&stamps, &images, &clock.map, constants.color_middle_ns)
        });
        Ok(Some(Phone {
            name: files.name.clone(),
            images: matched.rows.len(),
            stamps: stamps.len(),
            has_mismatch: matched.remark.is_some(),
            frames,
            clock,
        }))
    }

    /// Reports where the phone's files contradict each other or the alignment of the trigger.
    fn compare_files(
        &mut self,
        input: &PhoneInput,
        files: &VideoFiles,
    ) -> Result<(), ExtractError> {
        match coverage::check(files, input.assumed.as_ref(), &self.job.monitor) {
            Ok(faults) => {
                for fault in faults {
                    self.lose(LossPart::Phone, input.about(&fault.to_string()));
                }
            }
            Err(_) if self.job.monitor.is_cancelled() => return Err(ExtractError::Cancelled),
            // It is reported where the file's rows are used.
            Err(_) => {}
        }
        Ok(())
    }

    /// Finds the row of the timestamps for each frame of the video.
    fn match_video(
        &mut self,
        input: &PhoneInput,
        files: &VideoFiles,
        rows: &[Option<PhoneNanos>],
    ) -> VideoRows {
        let Some(video) = &files.video else {
            return VideoRows::default();
        };
        match presentation_times(video, &self.job.monitor) {
            Some(times) if times.len() != rows.len() => {
                let stamps: Vec<PhoneNanos> = rows.iter().flatten().copied().collect();
                let matched = match_by_time(&times, &stamps);
                if let Some(remark) = &matched.remark {
                    self.lose(LossPart::Video, input.about(remark));
                }
                matched
            }
            // Also without ffprobe, or without times in the file: then the count is
            // compared when the frames are decoded.
            _ => VideoRows::image_per_row(rows),
        }
    }

    /// Reports the damaged rows of a file.
    fn note_faults(&mut self, input: &PhoneInput, what: &str, faults: &Faults) {
        if faults.count() > 0 {
            let (count, first) = (faults.count(), faults.first().join("; "));
            let what = format!("{count} rows of the {what} are left out: {first}");
            self.lose(LossPart::Phone, input.about(&what));
        }
    }

    /// Decodes the phone's video, and writes its images; `None` if there is no place for them.
    pub(super) fn write_phone_images(
        &mut self,
        input: &PhoneInput,
        phone: Option<&Phone>,
        sequences: &Sequences,
    ) -> Result<Option<VideoOutcome>, ExtractError> {
        let video = input.files.as_ref().and_then(|files| files.video.clone());
        let (Some(phone), Some(video)) = (phone, video) else {
            return Ok(None);
        };
        if phone.frames.is_empty() {
            return Ok(None);
        }
        let layout = self.layout();
        if layout.folder(ImageKind::Color).is_none() {
            return Ok(None);
        }
        let last = phone.frames.iter().filter_map(|frame| frame.image).max();
        let mut paths: Vec<Option<PathBuf>> = vec![None; last.map_or(0, |last| last + 1)];
        for frame in &phone.frames {
            if let Some(slot) = frame.image.and_then(|image| paths.get_mut(image)) {
                let folder = self
                    .output
                    .out
                    .join(&input.folder)
                    .join(sequences.folder(sequences.at(frame.at)));
                let path = layout.image_path(ImageKind::Color, frame.at);
                *slot = path.map(|path| folder.join(path));
            }
        }
        let step = match input.other_name() {
            Some(name) => format!("video-{name}"),
            None => String::from("video"),
        };
        let stored = self.output.outcome::<VideoOutcome>(&step);
        let outcome = match stored.filter(|outcome| self.is_joined || outcome.is_there(&paths)) {
            Some(outcome) => outcome,
            None => match Video::open(&video, Pixels::Rgb, &self.job.monitor) {
                Ok(decoder) => {
                    let outcome = write_video(decoder, &paths)?;
                    // After an error the next run tries again.
                    if outcome.error.is_none() {
                        self.output
                            .store(&step, &outcome)
                            .map_err(|error| self.failed(error))?;
                    }
                    outcome
                }
                Err(error @ VideoError::Missing(_)) => {
                    let again = "run the extraction again: it goes on where it stopped";
                    self.lose(
                        LossPart::Video,
                        input.about(&format!("{error}, and {again}")),
                    );
                    self.unfinished = true;
                    return Ok(None);
                }
                Err(error) => VideoOutcome {
                    error: Some(error.to_string()),
                    ..VideoOutcome::default()
                },
            },
        };
        if let Some(error) = &outcome.error {
            self.unfinished = true;
            self.lose(LossPart::Video, input.about(error));
        }
        let expected = phone.stamps as u64;
        let is_complete = outcome.decoded == phone.images as u64;
        if !is_complete && !phone.has_mismatch && outcome.error.is_none() {
            let what = format!(
                "{} frames were decoded and there are {expected} timestamps",
                outcome.decoded
            );
            self.lose(LossPart::Video, input.about(&what));
        }
        Ok(Some(outcome))
    }

    /// Writes the phone's samples in board time.
    pub(super) fn write_phone_imu(
        &mut self,
        input: &PhoneInput,
        phone: Option<&Phone>,
        sequences: &Sequences,
    ) -> Result<PhoneImu, ExtractError> {
        let clock = phone.and_then(|phone| phone.clock.as_ref());
        let files = input.files.clone().unwrap_or_default();
        let (Some(clock), Some(gyro), Some(accel), Some(table)) =
            (clock, &files.gyro, &files.accel, self.layout().phone_imu())
        else {
            return Ok(PhoneImu::default());
        };
        let open = |path| PhoneRows::open(path, &self.job.monitor);
        let (mut gyro, mut accel) = match (open(gyro), open(accel)) {
            (Ok(gyro), Ok(accel)) => (gyro, accel),
            (Err(error), _) | (_, Err(error)) => {
                let what = format!("opening the sensor files: {error}");
                self.lose(LossPart::Phone, input.about(&what));
                return Ok(PhoneImu::default());
            }
        };
        let out = self.output.out.join(&input.folder);
        let mut writer =
            TableWriter::new(table, &out, sequences, input.constants.phone_imu_delay_ns);
        let mut span = ImuSpan::default();
        let mut interpolator = AccelInterpolator::new(|| accel.next_sample());
        let read_error = loop {
            let sample = match gyro.next_sample() {
                Ok(Some(sample)) => sample,
                Ok(None) => break None,
                Err(error) => break Some(error),
            };
            span.add(sample.time.0);
            let value = match interpolator.at(sample.time) {
                Ok(Some(value)) => value,
                Ok(None) => continue,
                Err(error) => break Some(error),
            };
            if let Some(row) = in_board_time(&clock.map, &sample, value) {
                writer.push(row).map_err(|error| self.failed(error))?;
            }
        };
        let without = interpolator.without_accel;
        let rows = writer.finish().map_err(|error| self.failed(error))?;
        if let Some(error) = read_error {
            let what = format!("reading the sensor files: {error}");
            self.lose(LossPart::Phone, input.about(&what));
        }
        self.note_faults(input, "gyroscope", gyro.faults());
        self.note_faults(input, "accelerometer", accel.faults());
        if without > 0 {
            self.remarks.push(input.about(&format!(
                "gyroscope samples of the phone without an acceleration around them, and so without a row: {without}"
            )));
        }
        Ok(PhoneImu {
            gyro: span.samples,
            rows,
            rate: span.rate(),
        })
    }
}

impl Phone {
    /// Reports the relation of the clocks over the phone's frames.
    pub(super) fn clock_report(&self) -> Option<ClockReport> {
        Some(self.clock.as_ref()?.report(&self.frames))
    }

    /// Reports timestamps, images and samples.
    pub(super) fn report(&self, video: Option<&VideoOutcome>, imu: &PhoneImu) -> PhoneReport {
        PhoneReport {
            name: self.name.clone(),
            timestamps: self.stamps,
            video_frames: video.map(|video| video.decoded),
            images: video.map_or(0, |video| video.written),
            gyro_samples: imu.gyro,
            imu_rows: imu.rows,
        }
    }
}
