//! The beginning of a session: both sides are reached, its folder is made, and what
//! there is is looked at.

use std::time::Duration;

use protocol::Ticks;

use super::journal::Journal;
use super::link::BoardLink;
use super::live::Live;
use super::operator::{Choice, Operator};
use super::phones::{self, Phones};
use super::preflight::{Checks, IMU_TIME, TRIGGER_TIME, firmware_version};
use super::rig::Rig;
use super::track;
use super::{Connector, Options, Stop};
use crate::advice::imu_scale;
use crate::context::Context;
use board::Board;
use board::imu::{ImuLook, Scale};
use recording::finding::Severity;
use recording::folder;
use recording::profile::Profile;
use recording::session_file::{BoardInfo, ImuInfo, OtherPhone, PhoneInfo, SessionFile};
use recording::writer::Writer;

/// Both sides of a rig, once they have answered.
struct Sides<'a> {
    board: Board,
    imu: ImuInfo,
    phones: Phones<'a>,
    apps: Vec<PhoneInfo>,
}

/// Connects to board and phone, and makes the recording's folder once both are
/// there. With somebody there it is tried as often as they want. Gives the checks of
/// this computer too, which are made first.
pub(super) fn connect<'a>(
    options: &Options,
    profile: &'a Profile,
    context: &'a Context,
    connector: &'a mut dyn Connector,
) -> Result<(Rig<'a>, Checks), Stop> {
    // It starts a program: the board is not to be kept waiting for that later.
    let checked = check_host(profile, options);
    let asks = !options.yes && !context.global.json;
    let mut live = Live::open(context, !options.plain);
    live.length = options.duration;
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
    // What the board sends meanwhile waits in the link's queue.
    let tracking = track::start(options.track, profile, context)?;
    let journal = new_journal(&sides, live, options, profile, context)?;
    let link = BoardLink::new(
        sides.board,
        sides.imu.scale,
        connector,
        options.link_patience,
    );
    let mut rig = Rig::new(context, profile, link, sides.phones, operator, journal);
    rig.tracking = tracking;
    rig.journal.save()?;
    let text = format!("recording into {}", rig.journal.folder.display());
    rig.journal.info("connected", &text)?;
    Ok((rig, checked))
}

/// Board and phone, both ready.
fn reach<'a>(
    profile: &'a Profile,
    context: &Context,
    connector: &mut dyn Connector,
) -> Result<Sides<'a>, Stop> {
    let link = connector.connect(None)?;
    let mut board = Board::connect(link)?;
    let wanted = profile.imu_config()?;
    let mut setup = board.imu()?;
    if setup.config != wanted {
        setup = board.configure_imu(wanted)?;
    }
    let scale = imu_scale(&setup)?;
    let (phones, apps) = phones::connect(profile, context)?;
    Ok(Sides {
        board,
        imu: ImuInfo { setup, scale },
        phones,
        apps,
    })
}

/// The recording's folder, and its session file with what is known of both sides.
fn new_journal<'a>(
    sides: &Sides<'_>,
    mut live: Live,
    options: &Options,
    profile: &Profile,
    context: &'a Context,
) -> Result<Journal<'a>, Stop> {
    let name = options.name.clone().unwrap_or_else(folder::name_for_now);
    let folder = folder::create(&options.out, &name)?;
    let writer = Writer::create(&folder)?;
    let name = folder
        .file_name()
        .map_or(name, |name| name.to_string_lossy().into_owned());
    let mut file = SessionFile::new(name, profile.clone());
    let hello = sides.board.hello();
    let id = protocol::usb::serial_number(&hello.board_id).to_string();
    live.gauge.know_rig(profile);
    live.gauge.latest.board.clone_from(&id);
    file.board = Some(BoardInfo {
        id,
        firmware: firmware_version(hello),
        git_revision: hello.git_revision.to_string(),
        git_dirty: hello.git_dirty,
        model: hello.board,
        protocol: hello.protocol_version,
        tick_hz: hello.tick_hz,
        epoch: hello.epoch,
        reset_cause: hello.reset_cause,
    });
    file.imu = Some(sides.imu.clone());
    let mut apps = sides.apps.iter().cloned();
    file.phone = apps.next();
    let others = profile.phones.iter().zip(apps);
    file.phones = others
        .map(|(phone, info)| OtherPhone {
            name: phone.name.clone(),
            info,
            twists: Vec::new(),
            clock: None,
            video: None,
            placement: None,
        })
        .collect();
    Ok(Journal::new(context, live, writer, folder, file))
}

fn check_host(profile: &Profile, options: &Options) -> Checks {
    let mut checks = Checks::default();
    checks.host(profile, &options.profile, &options.out);
    checks
}

/// Checks both sides as `doctor` does. Problems are told, and all checks kept in the
/// session file.
pub(super) fn preflight(
    rig: &mut Rig<'_>,
    options: &Options,
    checked: Option<Checks>,
) -> Result<(), Stop> {
    let mut checks = checked.unwrap_or_else(|| check_host(rig.profile, options));
    checks.firmware(&rig.link.board, Some(rig.profile));
    if let Some(PhoneInfo { address, version }) = &rig.journal.file.phone {
        checks.phone(version.as_deref().unwrap_or("of unknown version"), address);
    }
    rig.link.board.start_counting();
    let setup = checks.look_at_imu(|| {
        rig.observers.look = Some(ImuLook::default());
        let looked = rig.pump_for(IMU_TIME);
        let look = rig.observers.look.take().unwrap_or_default();
        looked?;
        Ok::<_, Stop>((look, rig.call(Board::imu)?))
    })?;
    // The sensor is known now, also if it was still being looked for before.
    if let Some(scale) = Scale::of(&setup) {
        rig.link.set_scale(Some(scale));
        rig.journal.file.imu = Some(ImuInfo { setup, scale });
    }
    let session = rig.link.board.conversation();
    checks.link(session.counts().lost(), session.damaged_frames());
    rig.journal.file.preflight.clear();
    found(&mut rig.journal, checks)
}

/// Looks whether the train that was just started comes out of the wire.
pub(super) fn check_readback(rig: &mut Rig<'_>) -> Result<(), Stop> {
    rig.pump_for(TRIGGER_TIME)?;
    let mut checks = Checks::default();
    checks.readback(&rig.call(Board::trigger)?);
    found(&mut rig.journal, checks)
}

/// Says what was found, and ends with the first of it that is bad.
fn found(journal: &mut Journal<'_>, checks: Checks) -> Result<(), Stop> {
    for check in &checks.checks {
        match check.severity {
            Severity::Good => {}
            Severity::Check => journal.tell(Severity::Check, "preflight", &check.line())?,
            Severity::Bad => journal.tell(Severity::Bad, "preflight", &check.line())?,
        }
    }
    let failure = checks.failure();
    journal.file.preflight.extend(checks.checks);
    journal.save()?;
    failure.map_or(Ok(()), |failure| Err(failure.into()))
}
