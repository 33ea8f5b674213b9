//! `smartdepthsync doctor`: is the rig ready for a recording? Each problem is listed
//! with its fix. The checks are those of a session.

use std::path::Path;
use std::time::Duration;

use protocol::{
    DeviceToHost, Output, Period, QueryImu, QueryTrigger, StartTrigger, StopTrigger, TICK_HZ,
    TrainState, TriggerStart,
};

use crate::advice::at_phone;
use crate::checks;
use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure, next_text};
use crate::recordings;
use crate::rig_profile::ProfileArg;
use board::finding::Severity;
use board::imu::{ImuLook, Scale};
use board::{Board, Event};
use phone::{PhoneClient, Settings};
use recording::profile::Profile;
use recording::session_file::CHECK_LEARNT;
use report::summary::findings_text;
use serde::Serialize;
use session::checks::{Checks, IMU_TIME, TRIGGER_TIME};
use session::error::Fault;
use session::steps::connect::has_addresses;

/// Options of `doctor`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync doctor")]
pub(crate) struct DoctorArgs {
    #[command(flatten)]
    pub(crate) port: PortArg,
    #[command(flatten)]
    pub(crate) profile: ProfileArg,
    /// Skip the trigger (no pulses on the wire)
    #[arg(long)]
    pub(crate) no_trigger: bool,
    /// Skip the phone
    #[arg(long)]
    pub(crate) no_phone: bool,
}

/// The checks of a rig, and what could not be checked.
#[derive(Debug, Default, Serialize)]
struct Found {
    #[serde(flatten)]
    pub(crate) checks: Checks,
    /// The exit code of the first failure, where no bad check came before it.
    #[serde(skip)]
    failed: Option<ExitStatus>,
}

impl Found {
    /// Exit code of a command that prints them: as the first bad one says.
    pub(crate) fn outcome(&self) -> ExitStatus {
        match (self.failed, self.checks.result()) {
            (Some(status), _) => status,
            (None, Err(error)) => Failure::from(error).status(),
            (None, Ok(())) => ExitStatus::Good,
        }
    }

    /// Adds a check that failed.
    fn fail(&mut self, name: &str, failure: impl Into<Failure>) {
        let failure = failure.into();
        if self.checks.result().is_ok() {
            self.failed = Some(failure.status());
        }
        let step = failure.what_to_do();
        self.checks.bad(Fault::Rig, name, failure.to_string(), step);
    }
}

/// Checks the rig.
///
/// # Errors
///
/// None but those of printing; what is wrong is in the result.
pub(crate) fn run(args: &DoctorArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let found = look(args, context);
    let status = found.outcome();
    context.print_checks(&found, || {
        let place = args.profile.place();
        let has_profile = place.path.as_ref().is_some_and(|path| path.is_file());
        let is_learnt = found
            .checks
            .checks
            .iter()
            .any(|check| check.kind == CHECK_LEARNT && check.severity == Severity::Good);
        let (verdict, next) = match (status, is_learnt) {
            (ExitStatus::Good, _) if !has_profile => ("Ready for a profile of its own.", "setup"),
            (ExitStatus::Good, false) => ("Ready to record.", "record --calibrate"),
            (ExitStatus::Good, true) => ("Ready to record.", "record --duration 1m"),
            _ if !has_profile => ("Not ready: make a profile, mend what is BAD.", "setup"),
            _ => ("Not ready: mend what is BAD.", "doctor"),
        };
        let checks = findings_text(&found.checks.checks);
        let mut next = format!("smartdepthsync {next}{}", place.option());
        // It cannot be found without, until a profile has it.
        let known = args
            .profile
            .load()
            .ok()
            .and_then(|(profile, _)| profile.port);
        if let Some(port) = args
            .port
            .port
            .as_ref()
            .filter(|&port| known.as_ref() != Some(port))
        {
            next += &format!(" --port {}", system::shell_word(Path::new(port)));
        }
        format!("{checks}{verdict}\n{}", next_text(&[next]))
    })?;
    if context.interrupt.requested() {
        return Ok(ExitStatus::Interrupted);
    }
    Ok(status)
}

/// Makes the checks.
fn look(args: &DoctorArgs, context: &Context) -> Found {
    let mut found = Found::default();
    let profile = match args.profile.load() {
        Ok((profile, place)) => {
            found.checks = checks::host(&profile, &place, Path::new(recordings::FOLDER));
            Some(profile)
        }
        Err(error) => {
            found.fail("profile", error);
            None
        }
    };
    match args.port.open_of(profile.as_ref()) {
        Ok(mut board) => {
            let checks = &mut found.checks;
            checks.firmware(&board, profile.as_ref());
            let looked = check_imu(&mut board, checks, context)
                .and_then(|()| check_trigger(args, profile.as_ref(), &mut board, checks, context));
            if let Err(error) = looked {
                found.fail("board", error);
            }
        }
        Err(failure) => found.fail("board", failure),
    }
    if let Some(profile) = profile.filter(|_| !args.no_phone) {
        match check_phone(&profile, context) {
            Ok(version) => found.checks.phone(&version, &profile.phone.address),
            Err(failure) => found.fail("phone", failure),
        }
    }
    found
}

/// Handles events for a time of the board. Ends early on Ctrl-C.
fn listen_for(
    board: &mut Board,
    context: &Context,
    ticks: u64,
    mut take: impl FnMut(&Event),
) -> Result<(), Failure> {
    let (now, _) = board.ping()?;
    let end = now.0.saturating_add(ticks);
    let stop = context.interrupt.question();
    board.listen("any message", &stop, |board, event| {
        event.iter().for_each(&mut take);
        let is_over = board.conversation().latest().0 >= end;
        Ok::<_, Failure>(is_over.then_some(()))
    })?;
    Ok(())
}

fn check_imu(board: &mut Board, checks: &mut Checks, context: &Context) -> Result<(), Failure> {
    board.start_counting();
    checks.look_at_imu(|| {
        let mut look = ImuLook::default();
        let scale = Scale::from_setup(&board.call(QueryImu)?);
        listen_for(board, context, IMU_TIME, |event| match (event, &scale) {
            (Event::Message(DeviceToHost::Imu(sample)), Some(scale)) => {
                look.add(&scale.apply(sample));
            }
            (Event::Lost { .. }, _) => look.gap(),
            _ => {}
        })?;
        Ok::<_, Failure>((look, board.call(QueryImu)?))
    })?;
    let link = board.conversation();
    checks.link(link.counts().lost(), link.damaged_frames());
    Ok(())
}

/// Tries the trigger as the profile's camera has it; without a profile that can be read, as
/// the published rig's.
fn check_trigger(
    args: &DoctorArgs,
    profile: Option<&Profile>,
    board: &mut Board,
    checks: &mut Checks,
    context: &Context,
) -> Result<(), Failure> {
    let before = board.call(QueryTrigger(Output::Camera))?;
    let after = if before.state == TrainState::Stopped && !args.no_trigger {
        let published = Profile::published()?;
        let profile = profile.unwrap_or(&published);
        let start = TriggerStart {
            period: Period::from_ticks(TICK_HZ / profile.depth.fps),
            width: profile.pulse_width(),
            first_edge: None,
        };
        let output = Output::Camera;
        board.call(StartTrigger { output, start })?;
        let listened = listen_for(board, context, TRIGGER_TIME, |_| {});
        let after = board.call(StopTrigger(Output::Camera))?;
        listened?;
        after
    } else {
        before
    };
    checks.readback(&after);
    Ok(())
}

/// The version of the phone's app, whose sensors must be free for a twist.
fn check_phone(profile: &Profile, context: &Context) -> Result<String, Failure> {
    has_addresses(profile)?;
    let settings = Settings {
        margin: Duration::from_secs(5),
        cancel: context.interrupt.cancel(),
        ..Settings::default()
    };
    let address = &profile.phone.address;
    let looked = PhoneClient::connect(address, settings)
        .and_then(|mut phone| Ok((phone.probe()?, phone.is_recording()?)));
    let (version, is_recording) = looked.map_err(|error| at_phone(error, address))?;
    if is_recording {
        let message = format!("app {version} at {address} records a video");
        return Err(Failure::new(ExitStatus::Phone, message).next_step(format!(
            "stop it: `smartdepthsync phone stop --phone {address}`"
        )));
    }
    Ok(version.to_string())
}
