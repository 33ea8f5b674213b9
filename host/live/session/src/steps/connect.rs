//! The beginning of a session: connects to both sides, and creates its folder.

use std::sync::Arc;
use std::time::Duration;

use board::Board;
use board::BoardInfo;
use board::imu::Scale;
use protocol::{ConfigureImu, QueryImu, Ticks};
use recording::folder;
use recording::profile::Profile;
use recording::session_file::{ImuInfo, SessionFile};
use recording::writer::Writer;

use crate::devices::{Choice, Clock, Connector, DepthRecorder, Operator, PhoneClockStarter};
use crate::error::{SessionError, Stop};
use crate::event::{Phase, Prompt, SessionEvent, Stamped, Step};
use crate::housekeeping::Housekeeping;
use crate::link::BoardLink;
use crate::link::monitors::Monitors;
use crate::log::{Listener, Log};
use crate::options::Options;
use crate::phones::Phones;
use crate::session::Session;
use crate::tracking;

/// Pause between two looks for an answer while there is no board.
const PAUSE: Duration = Duration::from_millis(20);

/// The devices of a session that begins.
pub(crate) struct Parts<'a> {
    pub(crate) connector: &'a mut dyn Connector,
    pub(crate) phones: Phones<'a>,
    pub(crate) phone_clock: &'a mut dyn PhoneClockStarter,
    pub(crate) recorder: &'a mut dyn DepthRecorder,
    pub(crate) clock: &'a dyn Clock,
    pub(crate) operator: &'a mut dyn Operator,
    pub(crate) events: Listener<'a>,
}

/// Both sides of a rig, once they have answered.
struct Sides {
    board: Board,
    imu: ImuInfo,
    /// The versions of the phones' apps.
    apps: Vec<String>,
}

/// Connects to board and phones, and then creates the recording's folder. A present operator can
/// repeat a connect that fails.
pub(crate) fn connect<'a>(
    options: &Options,
    profile: &'a Profile,
    parts: Parts<'a>,
) -> Result<Session<'a>, Stop> {
    let mut publish = |event| {
        (parts.events)(&Stamped {
            at: Ticks::ZERO,
            event,
        });
    };
    publish(SessionEvent::Phase {
        phase: Phase::Connecting,
    });
    let sides = loop {
        let operator = &mut *parts.operator;
        let is_interrupted = || operator.interrupted();
        let reached = reach(
            options,
            profile,
            parts.connector,
            &parts.phones,
            &is_interrupted,
        );
        let error = match reached {
            Ok(sides) => break sides,
            Err(Stop::Failed(error)) if operator.is_present() => Arc::new(error),
            Err(stop) => return Err(stop),
        };
        let step = Step::Connect;
        publish(SessionEvent::StepFailed {
            step,
            error: Arc::clone(&error),
        });
        let can_skip = false;
        let prompt = Prompt::Repeat { step, can_skip };
        publish(SessionEvent::Prompt { prompt });
        let choice = loop {
            if operator.interrupted() {
                return Err(Stop::Interrupted);
            }
            match operator.answer() {
                Some(choice) => break choice,
                None => parts.clock.wait(PAUSE),
            }
        };
        if matches!(choice, Choice::Quit | Choice::Skip) {
            return Err(Arc::into_inner(error).map_or(Stop::Interrupted, Stop::Failed));
        }
    };
    // Meanwhile the board's messages wait in the link's queue.
    let tracking = tracking::start(
        options.track,
        profile.phones.is_empty(),
        &profile.phone.name,
        parts.phone_clock,
        &mut publish,
    )?;
    let (mut log, file) = create_files(&sides, parts.events, parts.clock, options, profile)?;
    log.now = sides.board.hello().now;
    let scale = sides.imu.scale;
    let mut link = BoardLink::new(sides.board, scale, parts.connector, options.link_patience);
    link.keep_frames(options.raw_link);
    let mut session = Session {
        profile,
        clock: parts.clock,
        operator: parts.operator,
        link,
        phones: parts.phones,
        log,
        file,
        monitors: Monitors::default(),
        housekeeping: Housekeeping::new(parts.recorder, parts.clock.now()),
        tracking,
        trigger_started: false,
        phase: Phase::Connecting,
        closing: false,
        counts_at_reset: None,
        was_reset: false,
        frame: None,
    };
    session.save()?;
    let folder = session.log.folder.clone();
    let board = session.link.id().to_owned();
    session.log.report(SessionEvent::Connected {
        folder,
        board,
        scale,
    })?;
    Ok(session)
}

/// Connects to board and phones, and sets the IMU up.
fn reach(
    options: &Options,
    profile: &Profile,
    connector: &mut dyn Connector,
    phones: &Phones<'_>,
    is_interrupted: &dyn Fn() -> bool,
) -> Result<Sides, Stop> {
    let link = connector.connect(None)?;
    let mut board = match options.first_command {
        Some(first) => Board::connect_from(link, first)?,
        None => Board::connect(link)?,
    };
    let wanted = profile.imu_config()?;
    let mut setup = board.call(QueryImu)?;
    if setup.config != wanted {
        setup = board.call(ConfigureImu(wanted))?;
    }
    let scale = Scale::from_setup(&setup).ok_or(SessionError::NoScale)?;
    has_addresses(profile)?;
    let apps = phones.probe(is_interrupted)?;
    Ok(Sides {
        board,
        imu: ImuInfo { setup, scale },
        apps,
    })
}

/// Checks that the profile has the addresses of all its phones.
///
/// # Errors
///
/// An address is missing.
pub fn has_addresses(profile: &Profile) -> Result<(), SessionError> {
    let mut phones = profile.all_phones();
    match phones.find(|phone| phone.address.trim().is_empty()) {
        Some(phone) => Err(SessionError::NoAddress {
            name: phone.name.clone(),
        }),
        None => Ok(()),
    }
}

/// Creates the recording's folder and its log, and the content of its session file as far as it
/// is known.
fn create_files<'a>(
    sides: &Sides,
    events: Listener<'a>,
    clock: &dyn Clock,
    options: &Options,
    profile: &Profile,
) -> Result<(Log<'a>, SessionFile), Stop> {
    let now = clock.wall_clock();
    let name = options
        .name
        .clone()
        .unwrap_or_else(|| now.strftime("%Y-%m-%d_%H-%M-%S").to_string());
    let folder = folder::create(&options.out, &name)?;
    let mut writer = Writer::create(&folder)?;
    writer.set_wall_clock(clock.time_of_day());
    let name = folder
        .file_name()
        .map_or(name, |name| name.to_string_lossy().into_owned());
    let mut file = SessionFile::new(name, profile.clone());
    file.asked_s = options.duration.map(|ticks| Ticks(ticks).as_secs_f64());
    file.started = now.strftime("%Y-%m-%dT%H:%M:%S%:z").to_string();
    file.board = Some(BoardInfo::new(sides.board.hello()));
    file.imu = Some(sides.imu.clone());
    for (phone, version) in file.phones.iter_mut().zip(&sides.apps) {
        phone.version = Some(version.clone());
    }
    Ok((Log::new(events, writer, folder), file))
}
