//! The beginning of a session: both sides are reached, its folder is made, and what
//! there is is looked at.

use std::time::Duration;

use protocol::{ImuSetup, Ticks};

use super::live::Live;
use super::operator::{Choice, Operator};
use super::phone_task::PhoneTask;
use super::phones;
use super::preflight::{Checks, IMU_TIME, ImuLook, TRIGGER_TIME};
use super::rig::{Parts, Rig};
use super::{Connector, Options, Stop};
use crate::advice::imu_scale;
use crate::cli::Context;
use crate::outcome::Failure;
use board::Board;
use board::imu::Scale;
use recording::folder;
use recording::profile::Profile;
use recording::session_file::Verdict;
use recording::session_file::{BoardInfo, ImuInfo, OtherPhone, PhoneInfo, SessionFile};
use recording::writer::{Severity, Writer};

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
        context.say(format!("error: {failure}"));
        context.say(format!("  -> {}", failure.what_to_do()));
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
            return Err(failure.into());
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
    let scale = imu_scale(&imu)?;

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

/// Looks at both sides as `doctor` does. What is not good is said, and all of it
/// kept in the session file.
pub(super) fn preflight(rig: &mut Rig<'_>, options: &Options) -> Result<(), Stop> {
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
    let link = rig.board.conversation();
    checks.link(link.counts().lost(), link.damaged_frames());
    rig.file.preflight.clear();
    found(rig, checks)
}

/// Looks whether the train that was just started comes out of the wire.
pub(super) fn check_readback(rig: &mut Rig<'_>) -> Result<(), Stop> {
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
