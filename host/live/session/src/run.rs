//! A whole session.

use std::path::PathBuf;

use recording::profile::Profile;
use recording::session_file::{SessionFile, SessionOutcome};
use system::ReadMonitor;

use crate::checks::Checks;
use crate::devices::{Clock, Connector, DepthRecorder, Operator, Phone, PhoneClockStarter};
use crate::error::{SessionError, Stop};
use crate::event::{Phase, SessionEvent, Stamped};
use crate::options::Options;
use crate::phones::Phones;
use crate::steps;
use crate::steps::close::close;
use crate::steps::connect::{Parts, connect};

/// All devices of a session, and its listener.
pub struct Devices<'a> {
    /// Opens the link to the board.
    pub connector: &'a mut dyn Connector,
    /// The phones, in the profile's order: the first is the reference.
    pub phones: Vec<Box<dyn Phone>>,
    /// Starts to read the reference phone's clock.
    pub phone_clock: &'a mut dyn PhoneClockStarter,
    /// Records the depth camera.
    pub recorder: &'a mut dyn DepthRecorder,
    /// Checks the computer and the profile. Called before the session, and when the checks are
    /// repeated.
    pub host_checks: &'a mut dyn FnMut() -> Checks,
    /// All time except that of the board's link.
    pub clock: &'a dyn Clock,
    /// The person at the rig.
    pub operator: &'a mut dyn Operator,
    /// Receives the events as they happen.
    pub events: &'a mut dyn FnMut(&Stamped),
}

/// The result of a session.
#[derive(Debug)]
pub struct Ended {
    /// Its outcome, or the error with which it failed.
    pub result: Result<SessionOutcome, SessionError>,
    /// The recording's folder.
    pub folder: PathBuf,
    /// Content of `session.json`.
    pub file: SessionFile,
}

/// Runs a session. Returns `None` if it was interrupted before there was a folder.
///
/// # Errors
///
/// Board or phone cannot be reached, or the folder cannot be created. Later failures are in
/// [`Ended::result`].
pub fn run(
    options: &Options,
    profile: &Profile,
    devices: Devices<'_>,
) -> Result<Option<Ended>, SessionError> {
    // This may start a program, which must not delay the session once it is connected.
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
    let outcome = session.outcome_of(&result);
    // Checksums of long files take their time: until then the file states all else.
    let saved = session.save().and_then(|()| {
        let folder = session.log.folder.clone();
        let files = session.file.close_files(&folder, &ReadMonitor::default());
        session.save().and(files)
    });
    let (folder, file) = (session.log.folder.clone(), session.file.clone());
    session.enter(Phase::Ended);
    let ended = SessionEvent::Ended {
        outcome,
        folder: folder.clone(),
    };
    session.log.publish(ended);
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
