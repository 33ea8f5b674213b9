//! The extraction: from a recording to a data set, step by step.
//!
//! 1. `survey`: pulses, marks and all else that the board recorded, except its samples.
//! 2. The phone's clock (`phone_clock`): over the whole recording from both
//!    gyroscopes, otherwise from the session.
//! 3. Depth frames and their pulses (`depth::matching`).
//! 4. Tables of frames in board time, pairs, sequences.
//! 5. Images and samples, in parallel; images that exist already are kept.
//! 6. Index files of the format, the report.
//!
//! A missing or damaged part is a [`Loss`]: everything else is still
//! extracted. Only a board recording that cannot be read at all, or an output
//! folder that cannot be written, is an error.

mod depth_part;
mod depth_wording;
mod geometry_part;
mod index_files;
mod other_phones;
mod phone_part;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use index_files::Written;
use phone_part::Phone;

use crate::clocks::streams::each_event;
use crate::constants::{self, Constants};
use crate::depth::DepthInput;
use crate::error::ExtractError;
use crate::frames::pairs::{self, Pair};
use crate::frames::trigger_offset::{self, TriggerOffset};
use crate::frames::{ColorFrame, DepthFrame};
use crate::inputs::board_data::{BoardEvent, board_time};
use crate::inputs::survey::{ImuSpan, Survey, survey};
use crate::inputs::{Inputs, PhoneInput};
use crate::layout::{DataSetInfo, Format, ImuRow, Layout};
use crate::options::Options;
use crate::output::contents;
use crate::output::folder::{FileMark, OutputDir, check_outside};
use crate::output::imu_tables::TableWriter;
use crate::output::sequences::Sequences;
use crate::output::tables::{self, PhoneTables};
use crate::output::whole_file::write_whole;
use crate::report::{
    BoardReport, ClockReport, ExtractReport, Loss, LossPart, PairsReport, SensorReport,
};
use crate::time::BoardNanos;
use board::finding::{Finding, Severity};
use recording::SESSION_FILE;
use recording::contents::{FileContents, FileSums};
use recording::error_budget::ErrorPart;
use recording::verify::{Verification, verify_without_phones};
use system::ReadMonitor;

/// Largest number of gaps between pulses that are listed one by one.
const LISTED_GAPS: usize = 1_000;

/// Largest number of pairs whose difference is drawn over time.
const DRAWN_PAIRS: usize = 1_000;

/// Version of the report's format.
const REPORT_VERSION: u32 = 5;

/// Task of an extraction.
#[derive(Clone, Debug)]
pub struct Job {
    /// Recording: a folder or an MCAP file.
    pub recording: PathBuf,
    /// Folder of the phone's files, if it is not in the recording.
    pub phone: Option<PathBuf>,
    /// Depth recording, if it is not in the recording.
    pub depth: Option<PathBuf>,
    /// Format of the data set.
    pub format: Format,
    /// Output folder.
    pub out: PathBuf,
    /// Further choices of the user.
    pub options: Options,
    /// True to replace an extraction of other inputs or with other options in `out`.
    pub overwrite: bool,
    /// Follows and cancels the reading of the inputs.
    pub monitor: ReadMonitor,
}

/// An extraction under way.
struct Extraction<'a> {
    job: &'a Job,
    inputs: Inputs,
    output: OutputDir,
    losses: Vec<Loss>,
    verification: Verification,
    remarks: Vec<String>,
    /// True if images are missing that the next run may write.
    unfinished: bool,
    /// True if an earlier run joined the images into larger files, which are as it wrote them.
    is_joined: bool,
    /// The larger files of this run, relative to the output.
    joined: Vec<PathBuf>,
}

/// Larger files into which images were joined, by their paths, as a finished step keeps them.
type Joined = BTreeMap<PathBuf, FileContents>;

/// Extracts a data set, and returns its report.
///
/// # Errors
///
/// Returns an [`ExtractError`] if there is no data set. Missing and damaged parts are no errors
/// but losses in the report.
pub fn run(job: &Job) -> Result<ExtractReport, ExtractError> {
    steps(job).map_err(|error| {
        if system::is_cancelled(&error) {
            ExtractError::Cancelled
        } else {
            error
        }
    })
}

fn steps(job: &Job) -> Result<ExtractReport, ExtractError> {
    let mut run = Extraction::open(job)?;
    let survey = survey(&run.inputs.board, run.inputs.train(), &job.monitor)?;
    run.note_published(&survey);
    run.judge_board(&survey);
    let mut input = run.inputs.phone.clone();
    let mut constants = input.constants;

    let phone = run.read_phone(&input, &survey)?;
    let sequences = Sequences::new(survey.marks.clone());
    let depth = run.read_depth(&survey, &mut constants)?;
    input.constants = constants;

    let color = phone.as_ref().map_or(&[][..], |phone| &phone.frames);
    let depth_frames = depth.as_ref().map_or(&[][..], |depth| &depth.frames);
    let pairs = run.aligned_pairs(find_pairs(color, depth_frames, &survey), color, &input);
    let tables = phone_tables(phone.as_ref(), &input, depth_frames, &pairs);
    run.write_tables(&survey, &tables)?;

    let video = run.write_phone_images(&input, phone.as_ref(), &sequences)?;
    let size = video.as_ref().and_then(|video| video.size);
    let (cameras, view) = run.geometry(&input, size, depth.as_ref());
    run.write_cameras(&cameras)?;
    let images = run.write_depth_images(depth.as_ref(), &view, &sequences, depth_frames)?;
    let camera = depth.as_ref().map_or(&[][..], |depth| &depth.color);
    run.write_board_imu(&sequences, constants.board_imu_delay_ns)?;
    let phone_imu = run.write_phone_imu(&input, phone.as_ref(), &sequences)?;

    let facts = DataSetInfo {
        color_rate: rate_of(color.iter().map(|frame| frame.at)),
        board_imu_rate: survey.imu.rate(),
        phone_imu_rate: phone_imu.rate,
        color_size: size,
        cameras,
        constants,
        ..depth
            .as_ref()
            .map_or_else(DataSetInfo::default, |depth| depth.facts(&view))
    };
    let written = Written {
        pulses: &survey.pulses,
        times: &survey.times,
        color,
        depth: depth_frames,
        camera,
        pairs: &pairs,
        video: video.as_ref(),
        images: images.as_ref(),
    };
    run.note_associations(&pairs);
    let sequence_reports = run.finish_sequences(Path::new(""), &sequences, &written, &facts)?;
    if images.is_some() {
        run.write_calibration(depth.as_ref())?;
    }
    let grid = run.trigger_offset(color, &survey, &constants);
    let clock = phone.as_ref().and_then(Phone::clock_report);
    let mut phones = Vec::new();
    for other in run.inputs.others.clone() {
        let center = constants.depth_center_ns;
        phones.push(run.other_phone(&other, &survey, &sequences, depth_frames, center)?);
    }

    let report = ExtractReport {
        version: REPORT_VERSION,
        recording: run.inputs.name.clone(),
        format: job.format,
        task: run.inputs.task.clone(),
        board: run.board_report(&survey, &sequences),
        reference: input.name.clone(),
        phone: phone
            .as_ref()
            .map(|phone| phone.report(video.as_ref(), &phone_imu)),
        pairs: run.pairs_report(&pairs, color, &input, clock.as_ref()),
        clock,
        depth: depth
            .as_ref()
            .map(|depth| depth.report(&survey, images.as_ref())),
        grid,
        phones,
        sensors: sensors(&survey, run.inputs.lidar.as_deref()),
        sequences: sequence_reports,
        constants,
        verification: run.verification.clone(),
        losses: run.losses.clone(),
        remarks: run.remarks.clone(),
    };
    run.check_stop()?;
    run.write_report(&report)?;
    run.write_contents()?;
    Ok(report)
}

/// Returns marks of all input files, by which a later run recognises them.
fn file_marks(
    inputs: &Inputs,
    sums: &mut FileSums,
    monitor: &ReadMonitor,
) -> Result<Vec<FileMark>, ExtractError> {
    let depth = inputs.depth.as_ref().map(DepthInput::files);
    let session = system::folder_of(&inputs.board).join(SESSION_FILE);
    let mut paths: Vec<&Path> = vec![&inputs.board, &session];
    let phones = std::iter::once(&inputs.phone).chain(&inputs.others);
    for phone in phones.filter_map(|phone| phone.files.as_ref()) {
        let files = [&phone.video, &phone.frames, &phone.gyro, &phone.accel];
        paths.extend(files.into_iter().flatten().map(PathBuf::as_path));
    }
    paths.extend(depth.iter().flatten().map(PathBuf::as_path));
    let mut marks = Vec::new();
    for path in paths {
        match FileMark::read(path, sums, monitor) {
            Ok(mark) => marks.push(mark),
            Err(_) if monitor.is_cancelled() => return Err(ExtractError::Cancelled),
            // A file that cannot be read is reported where it is used.
            Err(_) => {}
        }
    }
    Ok(marks)
}

impl<'a> Extraction<'a> {
    /// Finds the inputs, and opens the output folder.
    fn open(job: &'a Job) -> Result<Self, ExtractError> {
        let inputs = crate::inputs::find(
            &job.recording,
            job.phone.as_deref(),
            job.depth.as_deref(),
            &job.options,
        )?;
        check_outside(&job.out, &job.recording)?;
        let mut sums = FileSums::default();
        let marks = file_marks(&inputs, &mut sums, &job.monitor)?;
        let output = OutputDir::open(&job.out, &marks, (job.format, &job.options), job.overwrite)?;
        let joined = output.outcome::<Joined>("joined").unwrap_or_default();
        let is_whole = |(path, held): (&PathBuf, &FileContents)| {
            let found = FileContents::read(&output.out.join(path), &job.monitor);
            found.is_ok_and(|found| found == *held)
        };
        let is_joined = !joined.is_empty() && joined.iter().all(is_whole);
        let verification = verify_without_phones(&inputs.board, &mut sums, &job.monitor)?;
        Ok(Self {
            job,
            losses: losses_of(&verification),
            verification,
            remarks: inputs.remarks.clone(),
            inputs,
            output,
            unfinished: false,
            is_joined,
            joined: Vec::new(),
        })
    }
}

/// Returns what the check of the recording found missing, damaged or contradictory.
fn losses_of(verification: &Verification) -> Vec<Loss> {
    let findings = verification.findings.iter();
    let findings = findings.filter(|finding| finding.severity != Severity::Good);
    let loss = |finding: &Finding| Loss {
        part: LossPart::Board,
        what: finding.words(),
    };
    findings.map(loss).collect()
}

impl Extraction<'_> {
    /// Reports a loss.
    fn lose(&mut self, part: LossPart, what: impl Into<String>) {
        self.losses.push(Loss {
            part,
            what: what.into(),
        });
    }

    /// Ends a cancelled run before parts that were not read to their end are reported as missing.
    fn check_stop(&self) -> Result<(), ExtractError> {
        if self.job.monitor.is_cancelled() {
            return Err(ExtractError::Cancelled);
        }
        Ok(())
    }

    fn layout(&self) -> &'static dyn Layout {
        self.job.format.layout(self.job.options.view)
    }

    fn failed(&self, error: io::Error) -> ExtractError {
        ExtractError::Write {
            path: self.output.out.clone(),
            error,
        }
    }

    /// Writes what the data set holds, by which its readers see that a part is missing or changed, and
    /// keeps what a later run compares the larger files with into which images were joined.
    fn write_contents(&self) -> Result<(), ExtractError> {
        let contents = contents::of(&self.output.out, &self.job.monitor);
        let contents = contents.map_err(|error| self.failed(error))?;
        if !self.unfinished && !self.joined.is_empty() {
            let own = |name: &String| self.joined.iter().any(|path| Path::new(name) == path);
            let joined = contents.files.iter().filter(|(name, _)| own(name));
            let joined: Joined = joined.map(|(name, held)| (name.into(), *held)).collect();
            let kept = self.output.store("joined", &joined);
            kept.map_err(|error| self.failed(error))?;
        }
        let json = serde_json::to_vec_pretty(&contents);
        self.write(
            contents::FILE,
            &json.map_err(|error| self.failed(error.into()))?,
        )
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), ExtractError> {
        write_whole(&self.output.out.join(name), bytes).map_err(|error| self.failed(error))
    }

    fn write_report(&self, report: &ExtractReport) -> Result<(), ExtractError> {
        let json = serde_json::to_vec_pretty(report).map_err(|error| self.failed(error.into()))?;
        self.write(crate::report::FILE, &json)
    }

    fn board_report(&self, survey: &Survey, sequences: &Sequences) -> BoardReport {
        BoardReport {
            id: self.inputs.board_id.clone(),
            pulses: survey.pulses.len(),
            pulse_period_ns: survey.pulse_period(),
            missing_pulses: survey.missing_pulses().take(LISTED_GAPS).collect(),
            imu: survey.imu,
            marks_ns: sequences.marks().iter().map(|mark| mark.0).collect(),
        }
    }

    /// Remarks that the TUM format has no list of pairs without registered depth.
    fn note_associations(&mut self, pairs: &[Pair]) {
        let is_plain = self.job.format == Format::Tum && self.job.options.view.is_none();
        if is_plain && !pairs.is_empty() {
            self.remarks.push(String::from(
                "associations.txt is for registered depth alone, of which each pixel is that of colour \
                 in the same place: the pairs are in pairs.csv",
            ));
        }
    }

    /// Assumes the published system's settings if the recording is its bag.
    fn note_published(&mut self, survey: &Survey) {
        if survey.published {
            self.inputs.phone.constants.board_imu_delay_ns = constants::PUBLISHED_DELAY_NS;
            self.remarks.push(String::from(
                "a bag of the published system says nothing about its settings: the IMU's low-pass \
                 delay is taken as 1.9 ms, its register setting; exposure and readout of the phone are \
                 those of --profile",
            ));
        }
    }

    /// Reports losses of the board's recording.
    fn judge_board(&mut self, survey: &Survey) {
        for left_out in &survey.left_out {
            self.lose(LossPart::Board, left_out.clone());
        }
        // The counts come from a file and may be absurd.
        let counts = survey.missing_pulses().map(|(_, _, count)| count);
        let missing = counts.fold(0, u64::saturating_add);
        if missing > 0 {
            let what = format!(
                "{missing} pulses are not in the recording; report.json names the first {LISTED_GAPS} gaps"
            );
            self.lose(LossPart::Board, what);
        }
        if survey.pulses.is_empty() {
            self.lose(LossPart::Board, "there are no trigger pulses");
        }
        if survey.imu.samples == 0 {
            self.lose(LossPart::Board, "there are no IMU samples");
        }
        if survey.imu.disordered > 0 {
            let count = survey.imu.disordered;
            self.lose(
                LossPart::Board,
                format!("{count} IMU samples are not later than the sample before them"),
            );
        }
        if survey.imu.marked > 0 {
            self.remarks.push(format!(
                "{} IMU samples are marked as late or at the end of their range: they are in the \
                 tables, and left out where clocks are related",
                survey.imu.marked
            ));
        }
    }

    /// Measures the offset of a phone's frames from the trigger's grid, over the recorded span.
    fn trigger_offset(
        &self,
        frames: &[ColorFrame],
        survey: &Survey,
        constants: &Constants,
    ) -> Option<TriggerOffset> {
        let (from, to) = self.inputs.recorded.unwrap_or((i64::MIN, i64::MAX));
        let middles: Vec<BoardNanos> = frames.iter().map(|frame| frame.at).collect();
        let pulses = survey.pulses.iter();
        let centres: Vec<BoardNanos> = pulses
            .filter(|pulse| (from..=to).contains(&pulse.at.0))
            .map(|pulse| BoardNanos(pulse.at.0.saturating_add(constants.depth_center_ns)))
            .collect();
        trigger_offset::measure(&middles, &centres)
    }

    /// Reports the pairs with the frames of a phone.
    fn pairs_report(
        &self,
        pairs: &[Pair],
        color: &[ColorFrame],
        phone: &PhoneInput,
        clock: Option<&ClockReport>,
    ) -> Option<PairsReport> {
        let spread = pairs::spread(pairs)?;
        let central = pairs::central(pairs, &spread);
        let step = central.len().div_ceil(DRAWN_PAIRS).max(1);
        let place = |pair: &Pair| Some((color.get(pair.color)?.at.0, pair.difference));
        let constant = phone.constants.constant_sigma_us;
        let parts = clock.and_then(|clock| clock.sigma_us).zip(constant);
        Some(PairsReport {
            spread,
            sigma_us: parts.map(|([_, most], constant)| most.hypot(constant)),
            largest: parts.map(|([_, most], constant)| {
                if most < constant {
                    phone.constants.constant_part
                } else {
                    ErrorPart::Clocks
                }
            }),
            central: pairs::histogram(&central)?,
            course: central.iter().step_by(step).filter_map(place).collect(),
        })
    }

    /// Writes the tables of pulses, frames and pairs.
    fn write_tables(&self, survey: &Survey, phone: &PhoneTables<'_>) -> Result<(), ExtractError> {
        let (out, depth) = (&self.output.out, phone.depth);
        let write = || -> io::Result<()> {
            tables::write_pulses(&out.join("pulses.csv"), &survey.pulses, depth)?;
            if !depth.is_empty() {
                tables::write_depth(&out.join("depth_frames.csv"), depth, &survey.pulses)?;
            }
            phone.write(out)
        };
        write().map_err(|error| self.failed(error))
    }

    /// Writes the board's samples, `delay` (ns) earlier if the format wants it.
    fn write_board_imu(&self, sequences: &Sequences, delay: i64) -> Result<(), ExtractError> {
        let table = self.layout().board_imu();
        let mut writer = TableWriter::new(table, &self.output.out, sequences, delay);
        let board = &self.inputs.board;
        each_event(board, &self.job.monitor, |event| match event {
            BoardEvent::Sample(sample) => {
                let row = ImuRow {
                    at: board_time(sample.stamp),
                    gyro: sample.gyro,
                    accel: sample.accel,
                    temperature: sample.temperature,
                };
                writer.push(row).map_err(|error| self.failed(error))
            }
            _ => Ok(()),
        })?;
        writer.finish().map_err(|error| self.failed(error))?;
        Ok(())
    }
}

impl Extraction<'_> {
    /// Removes pairs from before the trigger was aligned and from after the recording, and, with
    /// the phone that it was aligned to, pairs that are far apart. Reports their numbers.
    fn aligned_pairs(
        &mut self,
        mut pairs: Vec<Pair>,
        color: &[ColorFrame],
        input: &PhoneInput,
    ) -> Vec<Pair> {
        let Some((from, to)) = self.inputs.recorded.filter(|_| !self.job.options.all_pairs) else {
            return pairs;
        };
        let found = pairs.len();
        let is_within = |pair: &Pair| {
            let at = color.get(pair.color).map(|frame| frame.at.0);
            at.is_some_and(|at| (from..=to).contains(&at))
        };
        pairs.retain(is_within);
        let aligned = pairs.len();
        let limit = if input.is_other() {
            i64::MAX
        } else {
            pairs::LIMIT_NS
        };
        pairs.retain(|pair| pair.difference.saturating_abs() <= limit);
        let (outside, far) = (found - aligned, aligned - pairs.len());
        if outside + far > 0 {
            self.remarks.push(input.about(&format!(
                "{outside} pairs from before the trigger was aligned or after the recording are \
                 left out, and {far} that are more than {} ms apart (--all-pairs has them)",
                pairs::LIMIT_NS / 1_000_000
            )));
        }
        pairs
    }
}

/// Returns the tables of a phone's frames and their pairs with depth frames.
fn phone_tables<'a>(
    phone: Option<&'a Phone>,
    input: &PhoneInput,
    depth: &'a [DepthFrame],
    pairs: &'a [Pair],
) -> PhoneTables<'a> {
    let constant_us = input.constants.constant_sigma_us;
    let clock = phone.and_then(|phone| phone.clock.as_ref());
    PhoneTables {
        color: phone.map_or(&[], |phone| &phone.frames),
        shutter: input.camera(None).shutter,
        depth,
        pairs,
        sigma: Box::new(move |at| {
            let model = clock?.model_at(at)?;
            let clock_us = model.covariance[0][0].max(0.0).sqrt() * 1e6;
            constants::nanos(clock_us.hypot(constant_us?))
        }),
    }
}

/// Pairs the frames of a phone with the depth frames that have a place in the data set.
fn find_pairs(color: &[ColorFrame], depth: &[DepthFrame], survey: &Survey) -> Vec<Pair> {
    let Some(period) = survey.pulse_period() else {
        return Vec::new();
    };
    let mut phone: Vec<(usize, BoardNanos)> = color
        .iter()
        .enumerate()
        .map(|(index, frame)| (index, frame.at))
        .collect();
    let mut centres: Vec<(usize, BoardNanos)> = depth
        .iter()
        .enumerate()
        .filter(|(_, frame)| frame.is_used())
        .filter_map(|(index, frame)| Some((index, frame.at?)))
        .collect();
    phone.sort_by_key(|&(_, at)| at);
    centres.sort_by_key(|&(_, at)| at);
    pairs::find(&phone, &centres, period / 2)
}

/// Returns the sensors on auxiliary outputs and the lidar, with their pulses.
fn sensors(survey: &Survey, lidar: Option<&str>) -> Vec<SensorReport> {
    let mut pulses = BTreeMap::<&str, usize>::new();
    for pair in &survey.times {
        if let Some(name) = pair.of.sensor(lidar) {
            *pulses.entry(name).or_default() += 1;
        }
    }
    let sensor = |(name, pulses): (&str, usize)| SensorReport {
        name: name.to_owned(),
        pulses,
    };
    pulses.into_iter().map(sensor).collect()
}

/// Returns the mean rate of events, Hz; `None` for fewer than two.
fn rate_of(times: impl Iterator<Item = BoardNanos>) -> Option<f64> {
    let mut span = ImuSpan::default();
    for at in times {
        span.add(at.0);
    }
    span.rate()
}
