//! The steps of a session.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use protocol::{ImuSetup, Period, TICK_HZ, Ticks, TrainState, TriggerAlign, TriggerStart};

use super::alignment::{plan, skew_prior, with_known_skew};
use super::further;
use super::live::Live;
use super::operator::{Choice, Operator};
use super::phone_task::{Answer, PhoneTask, Request};
use super::phones;
use super::preflight::{Checks, IMU_TIME, ImuLook, TRIGGER_TIME, Verdict};
use super::recorder::DepthRecorder;
use super::rig::{Parts, Rig};
use super::watch::{Finding, Grid, Watch};
use super::{Connector, Options, Stop, seconds};
use crate::board::Board;
use crate::cli::Context;
use crate::imu::Scale;
use crate::outcome::{ExitStatus, Failure, Report};
use crate::phone::samples::sample_line;
use crate::phone::{PhoneSample, Sensor};
use crate::profile::Profile;
use crate::recording::folder;
use crate::recording::session_file::{
    Alignment, BoardInfo, ImuInfo, Marker, OtherPhone, PhoneInfo, SessionFile, Span, Twist, Video,
};
use crate::recording::writer::{Severity, Writer};
use crate::sync::{self, ClockModel, GyroTrack, estimate_offset};

/// How often a twist is tried when nobody is there to decide.
const TWIST_TRIES: usize = 3;

/// How much longer than the phone's recording the board's is taken, ticks.
const TWIST_MARGIN: u64 = TICK_HZ as u64 / 4;

/// How much longer than planned an arrival may take, ticks.
const ARRIVAL_MARGIN: u64 = 3 * TICK_HZ as u64;

/// Both sides of a rig, once they have answered.
struct Sides {
    board: Board,
    imu: ImuSetup,
    scale: Scale,
    phone: PhoneTask,
    info: PhoneInfo,
    others: Vec<phones::Other>,
    kept: Vec<OtherPhone>,
}

/// Connects to board and phone, and makes the recording's folder once both are
/// there. With somebody there it is tried as often as they want.
///
/// # Errors
///
/// One of them is not there, or no folder can be made.
pub fn connect<'a>(
    options: &Options,
    profile: &'a Profile,
    context: &'a Context,
    connector: &'a mut dyn Connector,
) -> Result<Rig<'a>, Stop> {
    // It starts a program: the board is not to be kept waiting for that later.
    let mut checked = Checks::default();
    checked.host(profile, options.own_profile, &options.out);
    let asks = !options.yes && !context.global.json;
    let mut live = Live::open(context, !options.plain);
    live.length = options.duration;
    live.onlookers = options.foxglove.open(context)?;
    let operator = match live.take_keys() {
        Some(keys) => Operator::at_keys(keys, asks),
        None if asks => Operator::at_stdin(),
        None => Operator::absent(),
    };
    let sides = loop {
        let failure = match reach(profile, context, connector) {
            Ok(sides) => break sides,
            Err(Stop::Failed(failure)) if asks => failure,
            Err(stop) => return Err(stop),
        };
        let report = Report::of(&failure.into());
        context.say(format!("error: {}", report.message));
        if let Some(next) = &report.next_step {
            context.say(format!("  -> {next}"));
        }
        context.say("[Enter] or [r] try again, [q] quit");
        let choice = loop {
            if context.interrupt.requested() {
                return Err(Stop::Interrupted);
            }
            live.show(Ticks::ZERO, &options.out, None, None, true);
            if let Some(choice) = operator.answer() {
                break choice;
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        if matches!(choice, Choice::Quit | Choice::Skip) {
            let failure = Failure::new(report.status, report.message);
            return Err(match report.next_step {
                Some(next) => failure.next_step(next),
                None => failure,
            }
            .into());
        }
    };
    let mut rig = set_up(sides, operator, live, options, profile, context, connector)?;
    rig.checked = checked;
    Ok(rig)
}

/// Board and phone, both ready.
fn reach(
    profile: &Profile,
    context: &Context,
    connector: &mut dyn Connector,
) -> Result<Sides, Stop> {
    let link = connector.connect(None).map_err(Failure::from)?;
    let mut board = Board::connect(link).map_err(Failure::from)?;
    let wanted = profile.imu_config().map_err(Failure::from)?;
    let mut imu = board.imu().map_err(Failure::from)?;
    if imu.config != wanted {
        imu = board.configure_imu(wanted).map_err(Failure::from)?;
    }
    let scale = Scale::required(&imu)?;

    let (phone, info) = phones::connect(profile, &profile.phone, context)?;
    let (others, kept) = phones::connect_others(profile, context)?;
    Ok(Sides {
        board,
        imu,
        scale,
        phone,
        info,
        others,
        kept,
    })
}

/// The recording's folder with its first lines, and all that a session needs.
fn set_up<'a>(
    sides: Sides,
    operator: Operator,
    mut live: Live,
    options: &Options,
    profile: &'a Profile,
    context: &'a Context,
    connector: &'a mut dyn Connector,
) -> Result<Rig<'a>, Stop> {
    let Sides {
        board,
        imu,
        scale,
        phone,
        info,
        others,
        kept,
    } = sides;
    let name = options.name.clone().unwrap_or_else(folder::name_for_now);
    let folder = folder::create(&options.out, &name).map_err(Failure::from)?;
    let mut writer = Writer::create(&folder).map_err(Failure::from)?;
    if let Some(onlookers) = &live.onlookers {
        writer.mirror(onlookers.clone());
    }
    let name = folder
        .file_name()
        .map_or(name, |name| name.to_string_lossy().into_owned());
    let mut file = SessionFile::new(name, profile.clone());
    let hello = board.hello();
    let (major, minor, patch) = hello.firmware_version;
    file.board = Some(BoardInfo {
        id: protocol::usb::serial_number(&hello.board_id).to_string(),
        firmware: format!("{major}.{minor}.{patch}"),
        git_revision: hello.git_revision.to_string(),
        git_dirty: hello.git_dirty,
        protocol: hello.protocol_version,
        tick_hz: hello.tick_hz,
        epoch: hello.epoch,
        reset_cause: hello.reset_cause,
    });
    file.imu = Some(ImuInfo { setup: imu, scale });
    file.phone = Some(info);
    file.phones = kept;
    live.gauge.name_sensors(profile);
    live.gauge.board = protocol::usb::serial_number(&board.hello().board_id).to_string();
    let mut rig = Rig::new(Parts {
        context,
        profile,
        connector,
        board,
        imu,
        scale,
        link_patience: options.link_patience,
        phone,
        operator,
        live,
        writer,
        folder,
        file,
    });
    rig.others = others;
    rig.save()?;
    let text = format!("recording into {}", rig.folder.display());
    rig.tell(Severity::Info, "connected", &text)?;
    Ok(rig)
}

/// The session from the twist to the end of the recording.
///
/// # Errors
///
/// A step failed, or the user wants to stop.
pub fn session(rig: &mut Rig<'_>, options: &Options) -> Result<(), Stop> {
    step(rig, "the checks", |rig| preflight(rig, options))?;
    first_twist(rig)?;
    step(rig, "the depth recorder", start_depth_recorder)?;
    step(rig, "the trigger", |rig| {
        start_trigger(rig)?;
        check_readback(rig)
    })?;
    let video = phone_video(rig)?;
    let Some(clock) = rig.clock else {
        return Err(
            Failure::new(ExitStatus::Refused, "there is no relation of the clocks")
                .next_step("the twist was left out or refused: record again, and twist faster")
                .into(),
        );
    };
    let mut alignment = align(rig, &clock, &video)?;
    phones::place_others(rig)?;
    confirm_arrival(rig, &mut alignment)?;
    further::start(rig)?;
    record(rig, options, &alignment)
}

/// Ends a session, however it went. Gives the result on, or the first failure of
/// the closing itself if there was none before.
///
/// # Errors
///
/// As `result`; or the files cannot be finished.
pub fn close(rig: &mut Rig<'_>, options: &Options, result: Result<(), Stop>) -> Result<(), Stop> {
    rig.closing = true;
    if let Err(Stop::Failed(failure)) = &result {
        let text = failure.to_string();
        let broken = failure.status() == ExitStatus::Storage;
        if broken {
            // Nothing more can be written; what was written can be read.
            rig.writer = None;
        }
        let told = rig.problem(Finding::error("failed", text));
        if told.is_err() {
            rig.writer = None;
        }
    }
    end_of_recording(rig);
    stop_devices(rig);
    let result = match result {
        Ok(()) => after_recording(rig, options),
        failed => failed,
    };
    finish(rig, result)
}

/// Looks at both sides as `doctor` does. What is not good is said, and all of it
/// kept in the session file.
fn preflight(rig: &mut Rig<'_>, options: &Options) -> Result<(), Stop> {
    let mut checks = std::mem::take(&mut rig.checked);
    if checks.checks.is_empty() {
        checks.host(rig.profile, options.own_profile, &options.out);
    }
    checks.firmware(&rig.board);
    if let Some(PhoneInfo { address, version }) = &rig.file.phone {
        checks.phone(version.as_deref().unwrap_or("of unknown version"), address);
    }
    rig.board.start_counting();
    rig.look = Some(ImuLook::default());
    let until = rig.now.0.saturating_add(IMU_TIME);
    let looked = rig.pump_until(|rig| (rig.now.0 >= until).then_some(()));
    let look = rig.look.take().unwrap_or_default();
    looked?;
    checks.imu(&look, &rig.call(Board::imu)?);
    let session = rig.board.session();
    checks.link(session.counts().lost(), session.damaged_frames());
    rig.file.preflight.clear();
    found(rig, checks)
}

/// Looks whether the train that was just started comes out of the wire.
fn check_readback(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let until = rig.now.0.saturating_add(TRIGGER_TIME);
    rig.pump_until(|rig| (rig.now.0 >= until).then_some(()))?;
    let mut checks = Checks::default();
    checks.readback(&rig.call(Board::trigger)?);
    found(rig, checks)
}

/// Says what was found, and ends with the first of it that is bad.
fn found(rig: &mut Rig<'_>, checks: Checks) -> Result<(), Stop> {
    for check in &checks.checks {
        match check.verdict {
            Verdict::Good => {}
            Verdict::Warning => rig.tell(Severity::Warning, "preflight", &check.line())?,
            Verdict::Bad => rig.tell(Severity::Error, "preflight", &check.line())?,
        }
    }
    let failure = checks.failure();
    rig.file.preflight.extend(checks.checks);
    rig.save()?;
    failure.map_or(Ok(()), |failure| Err(failure.into()))
}

/// Twists until one passes the gates, of every phone.
fn first_twist(rig: &mut Rig<'_>) -> Result<(), Stop> {
    for attempt in 1.. {
        let clocks = match twist(rig) {
            Ok(clocks) => clocks,
            Err(Stop::Failed(failure)) if is_repeatable(&failure) && rig.operator.is_present() => {
                rig.context.say(format!("error: {failure}"));
                vec![None]
            }
            Err(stop) => return Err(stop),
        };
        for (place, clock) in clocks.iter().enumerate() {
            if let Some(clock) = clock {
                rig.set_phone_clock(place, *clock, &format!("twist {attempt}"))?;
            }
        }
        // With nobody there, phones may have got theirs from different twists.
        let related = rig
            .phone_places()
            .all(|place| rig.phone_clock(place).is_some());
        if related && !rig.operator.is_present() {
            return rig.save();
        }
        if clocks.iter().all(Option::is_some) {
            rig.save()?;
            match ask(rig, "[Enter] go on, [r] twist again, [q] quit")? {
                Choice::Repeat => continue,
                Choice::Quit => return Err(Stop::Interrupted),
                Choice::Continue | Choice::Skip => return Ok(()),
            }
        }
        rig.save()?;
        if rig.operator.is_present() {
            match ask(rig, "[Enter] or [r] twist again, [q] quit")? {
                Choice::Quit | Choice::Skip => return Err(Stop::Interrupted),
                Choice::Continue | Choice::Repeat => {}
            }
        } else if attempt >= TWIST_TRIES {
            return Err(Failure::new(
                ExitStatus::Refused,
                format!("none of {TWIST_TRIES} twists gave a trustworthy relation of the clocks"),
            )
            .next_step(
                "twist faster, about all three axes, with phone and board fixed to each other",
            )
            .into());
        }
    }
    Ok(())
}

/// One twist, of all phones. Gives the relation of each phone's clock if it passes
/// the gates, by the phone's place.
fn twist(rig: &mut Rig<'_>) -> Result<Vec<Option<ClockModel>>, Stop> {
    let length = rig.profile.phone.twist_s;
    rig.operator.forget_typed();
    if rig.operator.is_present() {
        let prompt =
            format!("Twist the rig for {length} s about all axes. [Enter] to begin, [q] to quit");
        if ask(rig, &prompt)? == Choice::Quit {
            return Err(Stop::Interrupted);
        }
    }
    let number = rig.file.twists.len() + 1;
    rig.tell(
        Severity::Info,
        "twist",
        &format!("twist {number}: twist now, for {length} s"),
    )?;
    rig.gyro = Some(Vec::new());
    let asked = twist_samples(rig, length);
    let board = rig.gyro.take().unwrap_or_default();
    let samples = asked?;
    let (times, rates): (Vec<Ticks>, Vec<[f64; 3]>) = board.into_iter().unzip();
    let span = Span {
        from: times.first().copied().unwrap_or_default(),
        to: times.last().copied().unwrap_or_default(),
    };
    let mcu = GyroTrack::from_ticks(&times, rates);
    let mut clocks = Vec::new();
    for (place, samples) in samples.iter().enumerate() {
        clocks.push(relate(rig, place, number, (&mcu, span), samples)?);
    }
    Ok(clocks)
}

/// Relates the clock of one phone to the board's by a twist.
fn relate(
    rig: &mut Rig<'_>,
    place: usize,
    number: usize,
    (mcu, span): (&GyroTrack, Span),
    samples: &[PhoneSample],
) -> Result<Option<ClockModel>, Stop> {
    let phone = rig.phone_profile(place);
    let folder = rig.file.phone_folder(&phone.name);
    let name = folder.join(format!("twist_{number}_phone_gyro.csv"));
    let name = name.to_string_lossy().into_owned();
    let label = if rig.others.is_empty() {
        format!("twist {number}")
    } else {
        format!("twist {number}, {}", phone.name)
    };
    save_samples(rig, &name, samples)?;
    let phone_times: Vec<_> = samples.iter().map(|sample| sample.time).collect();
    let phone_rates = samples.iter().map(|sample| sample.xyz).collect();
    let phone_track = GyroTrack::from_phone_nanos(&phone_times, phone_rates);
    let delay_us = rig
        .file
        .imu
        .as_ref()
        .map_or(0, |imu| imu.scale.gyro_delay_us);
    let options = sync::Options {
        mcu_delay_s: f64::from(delay_us) * 1e-6,
        phone_delay_s: phone.gyro_delay_us * 1e-6,
        sigma_limit_s: rig.profile.align.max_offset_sigma_us * 1e-6,
        ..sync::Options::default()
    };
    let result = estimate_offset(mcu, &phone_track, &options);
    let report = match &result {
        Ok(estimate) => &estimate.report,
        Err(refusal) => &refusal.report,
    };
    let report = serde_json::to_value(report).unwrap_or(serde_json::Value::Null);
    let estimate = result.as_ref().ok();
    let twist = Twist {
        phone_gyro: Some(name.clone()),
        span,
        accepted: estimate.is_some(),
        clock: estimate.map(|estimate| estimate.clock),
        offset_sigma_us: estimate.map(|estimate| estimate.offset_sigma_s() * 1e6),
        skew_sigma_ppm: estimate.map(|estimate| estimate.skew_sigma() * 1e6),
        report,
    };
    rig.keep_twist(place, twist);
    rig.file.files.push(name);
    match result {
        Ok(estimate) => {
            let text = format!(
                "{label}: offset {:.6} s ± {:.2} µs, skew {:+.3} ± {:.3} ppm",
                estimate.clock.offset,
                estimate.offset_sigma_s() * 1e6,
                estimate.clock.skew * 1e6,
                estimate.skew_sigma() * 1e6
            );
            rig.tell(Severity::Info, "twist", &text)?;
            for warning in &estimate.report.warnings {
                rig.tell(Severity::Info, "twist", warning)?;
            }
            sharpen(rig, place, estimate.clock).map(Some)
        }
        Err(refusal) => {
            let text = format!("{label} refused: {refusal}");
            rig.tell(Severity::Warning, "twist_refused", &text)?;
            Ok(None)
        }
    }
}

/// The phones' samples of one twist, by their places; the board's go into the rig
/// meanwhile.
fn twist_samples(rig: &mut Rig<'_>, length: u32) -> Result<Vec<Vec<PhoneSample>>, Stop> {
    let request = Request::Gyroscope(Duration::from_secs(length.into()));
    let requests = rig
        .phone_places()
        .map(|place| (place, request.clone()))
        .collect();
    let bar = spinner(rig);
    let mut shown = Instant::now();
    let answers = rig.ask_phones(requests, |rig| {
        if shown.elapsed() > Duration::from_millis(300) {
            shown = Instant::now();
            bar.set_message(motion_hint(rig.gyro.as_deref().unwrap_or_default()));
        }
    });
    bar.finish_and_clear();
    let mut samples = Vec::new();
    for (place, answer) in answers? {
        let recording = match answer.map_err(|error| rig.phone_failure(place, error))? {
            Answer::Gyroscope(recording) => recording,
            other => return Err(odd_answer(&other).into()),
        };
        let gyro = recording.samples(Sensor::Gyroscope).unwrap_or_default();
        samples.push(gyro.to_vec());
    }
    // The board's samples of the last moment are still on their way.
    let until = rig.now.0.saturating_add(TWIST_MARGIN);
    rig.pump_until(|rig| (rig.now.0 >= until).then_some(()))?;
    Ok(samples)
}

/// Whether the motion suffices, from the board's samples so far.
fn motion_hint(samples: &[(Ticks, [f64; 3])]) -> String {
    let count = samples.len().max(1) as f64;
    let mut rms = [0.0; 3];
    for axis in 0..3 {
        let sum: f64 = samples.iter().map(|(_, rate)| rate[axis].powi(2)).sum();
        rms[axis] = (sum / count).sqrt();
    }
    let mut sorted = rms;
    sorted.sort_by(f64::total_cmp);
    let hint = if sorted[2] < 0.5 {
        "twist faster"
    } else if sorted[1] < 0.3 {
        "twist about another axis too"
    } else {
        "good"
    };
    format!(
        "x {:.1}  y {:.1}  z {:.1} rad/s rms: {hint}",
        rms[0], rms[1], rms[2]
    )
}

/// Takes the skew that was learnt before into a twist's result.
fn sharpen(rig: &mut Rig<'_>, place: usize, clock: ClockModel) -> Result<ClockModel, Stop> {
    let Some((skew, sigma, _)) = skew_prior(rig.phone_profile(place), &rig.board_id) else {
        return Ok(clock);
    };
    match with_known_skew(&clock, skew, sigma) {
        Some(sharper) => Ok(sharper),
        None => {
            rig.tell(
                Severity::Warning,
                "learnt_skew",
                &format!(
                    "the learnt skew of {:+.3} ppm does not fit this twist's {:+.3} ppm; it is not used",
                    skew * 1e6,
                    clock.skew * 1e6
                ),
            )?;
            Ok(clock)
        }
    }
}

fn save_samples(rig: &Rig<'_>, name: &str, samples: &[PhoneSample]) -> Result<(), Stop> {
    let mut text = String::new();
    for sample in samples {
        text.push_str(&sample_line(sample));
        text.push('\n');
    }
    let path = rig.folder.join(name);
    let folder = path.parent().unwrap_or(&rig.folder);
    let written = std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&path, text));
    written.map_err(|source| {
        Failure::from(crate::recording::RecordingError::Io {
            action: "write",
            path,
            source,
        })
        .into()
    })
}

fn start_depth_recorder(rig: &mut Rig<'_>) -> Result<(), Stop> {
    rig.depth = DepthRecorder::start(&rig.profile.depth, &rig.folder)?;
    if rig.depth.is_some() {
        rig.tell(Severity::Info, "depth_recorder", "the depth recorder runs")?;
    }
    Ok(())
}

/// Starts the train at the best period that is known so far.
fn start_trigger(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let width = rig.profile.pulse_width();
    let nominal = Period::from_ticks(TICK_HZ / rig.profile.depth.fps);
    let period = match (&rig.profile.phone.learnt, rig.clock) {
        (Some(learnt), Some(clock)) => {
            let picos = learnt.frame_period_ns * 1e3 / (1.0 + clock.skew)
                * f64::from(rig.profile.frame_ratio());
            Period::from_picos(picos.round() as u64)
                .filter(|period| period.in_bounds())
                .unwrap_or(nominal)
        }
        _ => nominal,
    };
    let status = rig.call(Board::trigger)?;
    if status.state != TrainState::Stopped {
        rig.call(Board::stop_trigger)?;
    }
    rig.trigger_started = true;
    rig.call(|board| {
        board.start_trigger(TriggerStart {
            period,
            width,
            first_edge: None,
        })
    })?;
    rig.tell(
        Severity::Info,
        "trigger",
        &format!("the trigger runs with a period of {period}"),
    )
}

/// Starts the phones' videos; gives what the phone said that is aligned to.
fn phone_video(rig: &mut Rig<'_>) -> Result<Video, Stop> {
    let what = if rig.others.is_empty() {
        "the phone's video"
    } else {
        "the phones' videos"
    };
    step(rig, what, phones::start_videos)?;
    rig.file.video.ok_or_else(|| {
        Failure::new(ExitStatus::Phone, "the phone's video was left out")
            .next_step("record again with the phone: there is nothing to align to without it")
            .into()
    })
}

/// Sends the train onto the phone's frames.
fn align(rig: &mut Rig<'_>, clock: &ClockModel, video: &Video) -> Result<Alignment, Stop> {
    let planned = plan(rig.profile, clock, video).map_err(|error| {
        Failure::new(ExitStatus::Refused, error.to_string())
            .next_step("set the profile's values to the camera's mode, or twist longer")
    })?;
    for remark in &planned.remarks {
        rig.tell(Severity::Info, "align", remark)?;
    }
    let alignment = planned.alignment;
    let align = TriggerAlign {
        anchor: alignment.anchor,
        period: Period(alignment.period_q32),
        slew: rig.profile.slew(),
    };
    let plan = rig.call(|board| board.align(align))?;
    rig.file.alignment = Some(Alignment {
        arrival_pulse: Some(plan.arrival_pulse),
        arrival: Some(plan.arrival),
        ..alignment
    });
    rig.save()?;
    rig.tell(
        Severity::Info,
        "align",
        &format!(
            "aligning: {:+.1} µs over {} frames; phase ± {:.1} µs, drift ± {:.1} µs/min (1-sigma)",
            plan.shift.as_secs_f64() * 1e6,
            plan.frames,
            alignment.phase_sigma_us,
            alignment.drift_sigma_us_per_min
        ),
    )?;
    Ok(Alignment {
        arrival_pulse: Some(plan.arrival_pulse),
        arrival: Some(plan.arrival),
        ..alignment
    })
}

/// Waits until the board says that the train is on its grid.
fn confirm_arrival(rig: &mut Rig<'_>, alignment: &mut Alignment) -> Result<(), Stop> {
    let (Some(pulse), Some(arrival)) = (alignment.arrival_pulse, alignment.arrival) else {
        return Ok(());
    };
    let bar = spinner(rig);
    bar.set_message("waiting for the trigger to arrive on the phone's frames");
    let latest = arrival.0.saturating_add(ARRIVAL_MARGIN);
    let confirmed = rig.pump_until(|rig| match rig.arrived {
        Some(arrived) if arrived.pulse >= pulse => Some(true),
        _ => (rig.now.0 > latest).then_some(false),
    });
    bar.finish_and_clear();
    if confirmed? {
        return rig.save();
    }
    // The message may have been lost on the link; the state of the train was not.
    let status = rig.call(Board::trigger)?;
    if status.state == TrainState::Running && status.pulses > pulse {
        return rig.problem(Finding::warning(
            "arrival_unconfirmed",
            "the board did not report the arrival, but its train runs on the grid",
        ));
    }
    Err(Failure::new(
        ExitStatus::NoAnswer,
        format!(
            "the trigger did not arrive at pulse {pulse} ({:?})",
            status.state
        ),
    )
    .next_step("look at `smartdepthsync trigger status`, then record again")
    .into())
}

/// Periods from the arrival on the grid to the begin of the recorded span: the depth
/// camera may make its next frames by its own clock, or mark them as bad, after the
/// phase was moved.
const SETTLING_PERIODS: u64 = 15;

/// Records, until the time is up or somebody stops it.
fn record(rig: &mut Rig<'_>, options: &Options, alignment: &Alignment) -> Result<(), Stop> {
    let period = Period(alignment.period_q32);
    let settled = alignment.arrival.map(|arrival| {
        let wait = u64::from(period.ticks()) * SETTLING_PERIODS;
        Ticks(arrival.0.saturating_add(wait))
    });
    let from = rig.now.max(settled.unwrap_or_default());
    rig.board.start_counting();
    rig.watch = Some(Watch::new(
        Grid {
            anchor: alignment.anchor,
            period,
        },
        rig.now,
    ));
    rig.file.recorded = Some(Span { from, to: from });
    rig.save()?;
    let end = options.duration.map(|ticks| from.0.saturating_add(ticks));
    let how_long = options.duration.map_or(String::new(), |ticks| {
        format!(" for {:.0} s", ticks as f64 / f64::from(TICK_HZ))
    });
    let keys = if rig.context.said.is_diverted() {
        "m sets a mark, q stops"
    } else {
        "Enter sets a mark, Ctrl-C stops"
    };
    let text = format!("recording{how_long}; {keys}");
    rig.tell(Severity::Info, "recording", &text)?;
    rig.operator.forget_typed();
    let bar = recording_bar(rig, options.duration);
    let mut due: Vec<u64> = options.markers.clone();
    due.sort_unstable_by(|a, b| b.cmp(a));
    let result = rig.pump_until(|rig| {
        bar.set_position((rig.now.0.saturating_sub(from.0)) / u64::from(TICK_HZ));
        while let Some(&next) = due.last()
            && rig.now.0 >= from.0.saturating_add(next)
        {
            due.pop();
            if let Err(stop) = mark(rig, Ticks(from.0 + next), None) {
                return Some(Err(stop));
            }
        }
        match rig.operator.mark() {
            Some(Some(label)) => {
                let label = (!label.is_empty()).then_some(label);
                if let Err(stop) = mark(rig, rig.now, label) {
                    return Some(Err(stop));
                }
            }
            Some(None) => return Some(Ok(())),
            None => {}
        }
        end.is_some_and(|end| rig.now.0 >= end).then_some(Ok(()))
    });
    bar.finish_and_clear();
    result?
}

fn mark(rig: &mut Rig<'_>, at: Ticks, label: Option<String>) -> Result<(), Stop> {
    let label = label.unwrap_or_else(|| format!("marker {}", rig.file.markers.len() + 1));
    let phone = rig.clock.map(|clock| clock.ticks_to_phone(at));
    if let Some(writer) = &mut rig.writer {
        writer.marker(at, phone, &label).map_err(Failure::from)?;
    }
    rig.live.gauge.marker(at, &label);
    rig.file.markers.push(Marker {
        at,
        label: label.clone(),
    });
    rig.save()?;
    rig.tell(Severity::Info, "marker", &format!("mark: {label}"))
}

/// Takes down what was recorded. Before the devices are stopped: what they do
/// then is not part of it.
fn end_of_recording(rig: &mut Rig<'_>) {
    if rig.watch.take().is_none() {
        return;
    }
    if let Some(span) = &mut rig.file.recorded {
        span.to = span.from.max(rig.now);
    }
    rig.file.counts = rig.board.session().counts();
    rig.file.damaged_frames = rig.board.session().damaged_frames();
}

/// Stops phone, depth recorder and trigger; what cannot be stopped is told.
fn stop_devices(rig: &mut Rig<'_>) {
    stop_videos(rig);
    if let Some(recorder) = rig.depth.take() {
        let problem = recorder.stop(|| {
            // Its own failure is told by the next step of closing.
            if rig.pump(Duration::from_millis(20)).is_err() {
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        if let Some(text) = problem {
            report(rig, Finding::error("depth_recorder_gone", text));
        }
    }
    if rig.trigger_started {
        rig.trigger_started = false;
        if let Err(Stop::Failed(failure)) = further::stop(rig) {
            report(
                rig,
                Finding::error(
                    "outputs_not_stopped",
                    format!("a further output could not be stopped: {failure}"),
                ),
            );
        }
        if let Err(Stop::Failed(failure)) = rig.call(Board::stop_trigger) {
            report(
                rig,
                Finding::error(
                    "trigger_not_stopped",
                    format!("the trigger could not be stopped: {failure}"),
                ),
            );
        }
    }
    // Its last messages.
    for _ in 0..5 {
        if rig.pump(Duration::from_millis(20)).is_err() {
            break;
        }
    }
}

fn stop_videos(rig: &mut Rig<'_>) {
    let running = rig.take_running_videos();
    if running.is_empty() {
        return;
    }
    let requests = running
        .into_iter()
        .map(|place| (place, Request::StopVideo))
        .collect();
    let mut problems = Vec::new();
    match rig.ask_phones(requests, |_| {}) {
        Ok(answers) => {
            for (place, answer) in answers {
                if let Err(error) = answer {
                    problems.push(format!(
                        "the video of {} could not be stopped: {error}; stop it on the phone",
                        rig.phone_label(place)
                    ));
                }
            }
        }
        Err(Stop::Failed(failure)) => problems.push(failure.to_string()),
        Err(Stop::Interrupted) => {}
    }
    for text in problems {
        report(rig, Finding::error("phone_lost", text));
    }
}

/// What follows a recording that was not broken off.
fn after_recording(rig: &mut Rig<'_>, options: &Options) -> Result<(), Stop> {
    rig.save()?;
    // From here on Ctrl-C leaves the rest out.
    rig.closing = false;
    if options.second_twist {
        let first: Vec<Option<ClockModel>> = rig
            .phone_places()
            .map(|place| rig.phone_clock(place))
            .collect();
        step(rig, "the second twist", |rig| second_twist(rig, &first))
            .or_else(|stop| lesser(rig, "second_twist", stop))?;
    }
    if options.fetch_video {
        for place in rig.phone_places() {
            step(rig, "the download", |rig| fetch_video(rig, place))
                .or_else(|stop| lesser(rig, "video_not_fetched", stop))?;
        }
    }
    Ok(())
}

/// Twists once more and joins what it says with the first; of each phone by itself.
fn second_twist(rig: &mut Rig<'_>, first: &[Option<ClockModel>]) -> Result<(), Stop> {
    let second = twist(rig)?;
    let mut refused = false;
    for (place, clocks) in first.iter().zip(&second).enumerate() {
        let (Some(first), Some(second)) = clocks else {
            refused = true;
            continue;
        };
        if !rig.file.runs.is_empty() {
            // The first twist is of the run before the reset: its rate holds, its
            // offset is better known from this one.
            let sigma = first.covariance[1][1].max(0.0).sqrt();
            let clock = with_known_skew(second, first.skew, sigma).unwrap_or(*second);
            let source = "twist at the end, after a reset of the board";
            rig.set_phone_clock(place, clock, source)?;
            continue;
        }
        let joined = first.joined(second);
        let text = format!(
            "both twists{}: skew {:+.4} ± {:.4} ppm",
            if rig.others.is_empty() {
                String::new()
            } else {
                format!(", {}", rig.phone_profile(place).name)
            },
            joined.skew * 1e6,
            joined.covariance[1][1].sqrt() * 1e6
        );
        rig.tell(Severity::Info, "twist", &text)?;
        rig.set_phone_clock(place, joined, "twists at begin and end")?;
    }
    if refused {
        return Err(
            Failure::new(ExitStatus::Refused, "the second twist was refused")
                .next_step("twist again, faster and about all axes")
                .into(),
        );
    }
    Ok(())
}

/// A failure of a step after the recording: the recording is there, so it is a
/// problem, not the end.
fn lesser(rig: &mut Rig<'_>, kind: &'static str, stop: Stop) -> Result<(), Stop> {
    match stop {
        Stop::Failed(failure) if is_repeatable(&failure) => {
            rig.problem(Finding::error(kind, failure.to_string()))
        }
        stop => Err(stop),
    }
}

fn fetch_video(rig: &mut Rig<'_>, place: usize) -> Result<(), Stop> {
    let own = rig.file.phone_folder(&rig.phone_profile(place).name);
    let folder = rig.folder.join(&own);
    let label = rig.phone_label(place);
    let bar = spinner(rig);
    let answers = rig.ask_phones(vec![(place, Request::FetchVideo(folder))], |rig| {
        let (done, whole) = rig.phone_task(place).progress();
        bar.set_message(format!(
            "downloading the video of {label}: {} of {} MB",
            done / 1_000_000,
            whole / 1_000_000
        ));
    });
    bar.finish_and_clear();
    let Some((_, answer)) = answers?.pop() else {
        return Ok(());
    };
    match answer.map_err(|error| rig.phone_failure(place, error))? {
        Answer::Fetched(video) => {
            if let Some(name) = video.path.file_name() {
                let name = own.join(name).to_string_lossy().into_owned();
                rig.file.files.push(name);
            }
            rig.tell(
                Severity::Info,
                "video",
                &format!(
                    "the video is {} ({} bytes)",
                    video.path.display(),
                    video.size
                ),
            )
        }
        other => Err(odd_answer(&other).into()),
    }
}

/// Finishes the files.
fn finish(rig: &mut Rig<'_>, result: Result<(), Stop>) -> Result<(), Stop> {
    rig.closing = true;
    let finished = match rig.writer.take() {
        Some(writer) => writer.finish().map_err(|error| Failure::from(error).into()),
        None => Ok(()),
    };
    match result {
        Ok(()) => finished,
        failed => failed,
    }
}

/// Runs a step; if it fails in a way that may pass, and somebody is there, it
/// can be repeated or left out.
fn step(
    rig: &mut Rig<'_>,
    name: &str,
    mut run: impl FnMut(&mut Rig<'_>) -> Result<(), Stop>,
) -> Result<(), Stop> {
    loop {
        let failure = match run(rig) {
            Err(Stop::Failed(failure)) if is_repeatable(&failure) => failure,
            other => return other,
        };
        if !rig.operator.is_present() {
            return Err(failure.into());
        }
        rig.context.say(format!("error: {failure}"));
        let prompt = format!("{name}: [Enter] or [r] try again, [s] leave it out, [q] quit");
        match ask(rig, &prompt)? {
            Choice::Continue | Choice::Repeat => {}
            Choice::Skip => return Ok(()),
            Choice::Quit => return Err(Stop::Interrupted),
        }
    }
}

/// Whether trying again may help.
fn is_repeatable(failure: &Failure) -> bool {
    matches!(
        failure.status(),
        ExitStatus::Phone | ExitStatus::Refused | ExitStatus::DepthRecorder
    )
}

fn ask(rig: &mut Rig<'_>, prompt: &str) -> Result<Choice, Stop> {
    rig.context.say(prompt);
    rig.pump_until(|rig| rig.operator.answer())
}

/// Tells a problem while closing, where nothing can be done about a failure.
fn report(rig: &mut Rig<'_>, finding: Finding) {
    if rig.problem(finding).is_err() {
        rig.writer = None;
    }
}

pub(super) fn odd_answer(answer: &Answer) -> Failure {
    Failure::new(
        ExitStatus::Phone,
        format!("the phone answered something else: {answer:?}"),
    )
    .next_step("restart the app and try again")
}

fn spinner(rig: &Rig<'_>) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, target(rig));
    bar.set_style(ProgressStyle::default_spinner());
    bar
}

fn recording_bar(rig: &Rig<'_>, duration: Option<u64>) -> ProgressBar {
    let length = duration.map(|ticks| ticks / seconds(1));
    let style = ProgressStyle::with_template(if length.is_some() {
        "{bar:30} {pos}/{len} s"
    } else {
        "{spinner} {pos} s"
    })
    .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::with_draw_target(length, target(rig)).with_style(style)
}

fn target(rig: &Rig<'_>) -> ProgressDrawTarget {
    if rig.context.shows_progress() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    }
}
