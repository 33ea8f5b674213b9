//! A whole session.

use std::path::PathBuf;

use recording::profile::Profile;
use recording::session_file::{SessionFile, SessionOutcome};

use crate::checks::Checks;
use crate::devices::{Clock, Connector, DepthRecorder, Operator, Phone, PhoneClockStarter};
use crate::error::{SessionError, Stop};
use crate::event::{Phase, SessionEvent, Stamped};
use crate::options::Options;
use crate::phones::Phones;
use crate::steps;
use crate::steps::close::close;
use crate::steps::connect::{Parts, connect};

/// All devices of a session, and who listens to it.
pub struct Devices<'a> {
    /// Reaches the board.
    pub connector: &'a mut dyn Connector,
    /// The phones, in the profile's order: the first is the reference.
    pub phones: Vec<Box<dyn Phone>>,
    /// Reads the reference phone's clock while it records.
    pub phone_clock: &'a mut dyn PhoneClockStarter,
    /// Records the depth camera.
    pub recorder: &'a mut dyn DepthRecorder,
    /// Checks the computer and the profile: before the session, and when the checks are
    /// repeated.
    pub host_checks: &'a mut dyn FnMut() -> Checks,
    /// All time but the board link's.
    pub clock: &'a dyn Clock,
    /// The person at the rig.
    pub operator: &'a mut dyn Operator,
    /// Takes the events, as they happen.
    pub events: &'a mut dyn FnMut(&Stamped),
}

/// A session that has ended, with whatever it left.
#[derive(Debug)]
pub struct Ended {
    /// How it ended; or why it failed.
    pub result: Result<SessionOutcome, SessionError>,
    /// The recording's folder.
    pub folder: PathBuf,
    /// What was decided.
    pub file: SessionFile,
}

/// Runs a session. `None` if it was interrupted before there was a folder.
///
/// # Errors
///
/// It failed before there was a folder: board or phone cannot be reached, or no
/// folder can be made. Later failures are in [`Ended::result`].
pub fn run(
    options: &Options,
    profile: &Profile,
    devices: Devices<'_>,
) -> Result<Option<Ended>, SessionError> {
    // It may start a program: the board is not to be kept waiting for that later.
    let checked = (devices.host_checks)();
    let parts = Parts {
        connector: devices.connector,
        phones: Phones::new(profile, devices.phones, devices.clock),
        phone_clock: devices.phone_clock,
        recorder: devices.recorder,
        clock: devices.clock,
        operator: devices.operator,
        events: devices.events,
    };
    let mut session = match connect(options, profile, parts) {
        Ok(session) => session,
        Err(Stop::Interrupted | Stop::BoardReset) => return Ok(None),
        Err(Stop::Failed(error)) => return Err(error),
    };
    let result = steps::run(&mut session, options, checked, devices.host_checks);
    let result = close(&mut session, options, result);
    let log = &mut session.log;
    let outcome = log.outcome_of(&result);
    log.file.outcome = Some(outcome);
    let saved = log.file.save(&log.folder);
    let (folder, file) = (log.folder.clone(), log.file.clone());
    session.enter(Phase::Ended);
    let ended = SessionEvent::Ended {
        outcome,
        folder: folder.clone(),
    };
    session.log.tell(ended);
    let result = match result {
        Err(Stop::Failed(error)) => Err(error),
        _ => saved.map(|()| outcome).map_err(SessionError::from),
    };
    Ok(Some(Ended {
        result,
        folder,
        file,
    }))
}
