//! Advice on the errors of the libraries: exit code and next step.
//!
//! A library states what is wrong in a typed error. What the user can do about it is stated by
//! this program, in this one place.

use std::borrow::Cow;
use std::fmt::Display;
use std::path::Path;

use board::BoardError;
use board::bring_up::BringUpError;
use board::imu::Scale;
use board::transport::serial::OpenError;
use phone::PhoneError;
use phone::adb::AdbError;
use phone::error::Refusal as AppRefusal;
use protocol::{ImuSetup, Refusal};
use recording::RecordingError;
use recording::profile::ProfileError;
use session::error::{Fault, SessionError};

use crate::outcome::{ExitStatus, Failure, file_step};

/// Next step where another firmware is needed.
const FLASH: &str = ExitStatus::OtherVersion.next_step();

/// An error of a library with exit code and next step.
pub trait Advice: Display {
    /// Returns the exit code and the next step.
    fn advice(&self) -> (ExitStatus, Cow<'static, str>);
}

impl<E: Advice + ?Sized> Advice for &E {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        (**self).advice()
    }
}

impl<E: Advice> From<E> for Failure {
    fn from(error: E) -> Self {
        let (status, step) = error.advice();
        Self::new(status, error.to_string()).next_step(step)
    }
}

impl Advice for BoardError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        let (status, step) = match self {
            Self::Open(error) => return error.advice(),
            Self::Silent => {
                let step = format!(
                    "choose another port if this is not the board's (`smartdepthsync board list` \
                     marks boards), or press its reset button; if it stays silent, {FLASH}"
                );
                return (ExitStatus::NoAnswer, step.into());
            }
            Self::NotThisBoard { .. } => {
                let step = format!(
                    "choose another port (`smartdepthsync board list` marks boards), or {FLASH}"
                );
                return (ExitStatus::NotThisBoard, step.into());
            }
            Self::Ports(_) => (ExitStatus::Error, "give the board's port with --port"),
            Self::NoBoard => (
                ExitStatus::NoPort,
                "plug the board in, or give its port with --port (a pseudo-terminal of a simulated \
                 board must be given)",
            ),
            Self::ManyBoards { .. } => (ExitStatus::NoPort, "choose one with --port"),
            Self::Link(_) => (ExitStatus::LinkLost, ExitStatus::LinkLost.next_step()),
            Self::OtherVersion { .. } => (ExitStatus::OtherVersion, FLASH),
            Self::NoAnswer { .. } | Self::OddReply { .. } => {
                (ExitStatus::NoAnswer, ExitStatus::NoAnswer.next_step())
            }
            Self::Refused { refusal, .. } => (ExitStatus::Refused, refusal_step(refusal)),
        };
        (status, step.into())
    }
}

impl Advice for SessionError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        let (status, step) = match self {
            Self::Board(error) => return error.advice(),
            Self::Phone { error, .. } | Self::PhoneClock(error) | Self::Samples(error) => {
                return error.advice();
            }
            Self::Recording(error) => return error.advice(),
            Self::Profile(error) => return error.advice(),
            Self::Check {
                next_step, fault, ..
            } => {
                let status = fault_status(*fault);
                let step = next_step.clone().map(Cow::Owned);
                return (status, step.unwrap_or(status.next_step().into()));
            }
            Self::NoAddress { .. } => (
                ExitStatus::Usage,
                "set `address` in `[phone]` of the rig profile (`smartdepthsync setup` asks for \
                 it), as the app's dialog shows it",
            ),
            Self::Recorder(_) => (
                ExitStatus::DepthRecorder,
                "install it, or change `command` in `[depth.recorder]` of the rig profile; an \
                 empty list records without it",
            ),
            Self::NoScale => (ExitStatus::Error, FLASH),
            Self::Twists { .. } => (
                ExitStatus::Refused,
                "twist faster, about all three axes, with phone and board fixed to each other",
            ),
            Self::SecondTwist => (
                ExitStatus::Refused,
                "twist again, faster and about all axes",
            ),
            Self::NoClock => (
                ExitStatus::Refused,
                "the twist was skipped or refused: record again, and twist faster",
            ),
            Self::NoVideo => (
                ExitStatus::Phone,
                "record again with the phone's video: the trigger is aligned to it",
            ),
            Self::Alignment(_) => (
                ExitStatus::Refused,
                "set the profile's values to the camera's mode, or twist longer",
            ),
            Self::NotArrived { .. } => (
                ExitStatus::NoAnswer,
                "look at `smartdepthsync board trigger status`, then record again",
            ),
            Self::LinkLost { .. } => (ExitStatus::LinkLost, ExitStatus::LinkLost.next_step()),
            Self::BoardReset { .. } => (
                ExitStatus::LinkLost,
                "check the board's supply and cable, then record again",
            ),
            Self::RecordingMoved { .. } => (
                ExitStatus::Storage,
                "leave the folder in its place while it is recorded into, and record again",
            ),
            Self::DiskFull { .. } => (
                ExitStatus::Storage,
                "free some space; what was recorded is kept",
            ),
            Self::NoOutputForLed => (
                ExitStatus::Usage,
                "take one sensor out of the profile's [[outputs]] and off its pin for the calibration",
            ),
            Self::OutputTooSlow { .. } => (
                ExitStatus::Usage,
                "set a smaller `every` in its `[[outputs]]` of the rig profile",
            ),
            Self::Lidar(_) => (
                ExitStatus::Usage,
                "correct `[lidar]` of the rig profile; `smartdepthsync profile check rig.toml` checks it",
            ),
            Self::ClockBefore1970 => (ExitStatus::Error, "set this computer's clock"),
        };
        (status, step.into())
    }
}

/// Returns the exit code for the fault of a bad check.
const fn fault_status(fault: Fault) -> ExitStatus {
    match fault {
        Fault::Rig => ExitStatus::Refused,
        Fault::Recorder => ExitStatus::DepthRecorder,
        Fault::Disk => ExitStatus::Storage,
    }
}

/// Returns the next step after a refusal of the board.
pub(crate) const fn refusal_step(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::TriggerRunning | Refusal::OutputRunning => {
            "stop it first: `smartdepthsync board trigger stop`"
        }
        Refusal::TriggerStopped => "start it first: `smartdepthsync board trigger start`",
        Refusal::AlignInProgress => {
            "wait until it has arrived; `smartdepthsync board trigger status` shows when"
        }
        Refusal::GnssRunning => "stop it first: `smartdepthsync board pps stop`",
        Refusal::GnssStopping => "repeat it in a second",
        Refusal::NotKept => "reset the board and repeat it",
        Refusal::WrongKey => "nothing was changed; repeat it",
        Refusal::NotOnThisBoard => {
            "leave `[[outputs]]` and `[lidar]` out of the rig profile, or use an STM32F4DISCOVERY"
        }
        Refusal::PeriodOutOfRange
        | Refusal::WidthOutOfRange { .. }
        | Refusal::TimeOutOfRange { .. }
        | Refusal::SlewOutOfRange { .. }
        | Refusal::ImuSettingOutOfRange
        | Refusal::BoardSettingOutOfRange
        | Refusal::GnssDateOutOfRange
        | Refusal::GnssWindowExceeded { .. } => {
            "nothing was changed; choose a value within the bounds"
        }
    }
}

impl Advice for BringUpError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        let (status, step) = match self {
            Self::Board(error) => return error.advice(),
            Self::Reset => (
                ExitStatus::Error,
                "`smartdepthsync board info` says why; measure part by part with --part to find out when",
            ),
            Self::Gone => (ExitStatus::Error, "look at the board's LEDs, and reset it"),
            Self::InUse => (
                ExitStatus::Refused,
                "end the other program, or stop it: `smartdepthsync board trigger stop`",
            ),
            Self::Stopped => (ExitStatus::Interrupted, ExitStatus::Interrupted.next_step()),
        };
        (status, step.into())
    }
}

impl Advice for OpenError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        let (status, step) = match self {
            Self::Permission { path } => {
                let step = format!(
                    "install the udev rule, then plug the board in again: `sudo cp \
                     host/live/udev/60-smartdepthsync.rules /etc/udev/rules.d/ && sudo udevadm control \
                     --reload` (or, until the next boot: `sudo chmod a+rw {path}`)"
                );
                return (ExitStatus::Permission, step.into());
            }
            Self::Busy { path } => {
                let step = format!(
                    "close the other program (`fuser -v {path}` names it; ModemManager leaves the \
                     board alone once the udev rule is installed)"
                );
                return (ExitStatus::Busy, step.into());
            }
            Self::NotFound { .. } => (ExitStatus::NoPort, ExitStatus::NoPort.next_step()),
            Self::NotAPort { .. } => (
                ExitStatus::NotThisBoard,
                "give the board's serial port to --port; `smartdepthsync board list` lists them",
            ),
            Self::Terminal { .. } => (
                ExitStatus::NotThisBoard,
                "start the simulated board again (`hil-sim serve`): its name leads to a terminal that \
                 was opened since",
            ),
            Self::Other { .. } => (
                ExitStatus::Error,
                "unplug the board, plug it in again, and look into `dmesg`",
            ),
        };
        (status, step.into())
    }
}

impl Advice for PhoneError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        let status = phone_status(self);
        (
            status,
            phone_step(self).unwrap_or(status.next_step()).into(),
        )
    }
}

/// Adds the phone's address to a failure of the phone.
pub(crate) fn at_phone(failure: impl Into<Failure>, address: &str) -> Failure {
    let failure = failure.into();
    let text = failure.to_string();
    if text.contains(address) || failure.status() != ExitStatus::Phone {
        failure
    } else {
        failure.about(&format!("the phone at {address}"))
    }
}

/// Returns the exit code of a command after an error of the phone.
pub(crate) fn phone_status(error: &PhoneError) -> ExitStatus {
    match error.cause() {
        PhoneError::Address { .. } | PhoneError::Argument(_) => ExitStatus::Usage,
        PhoneError::TargetExists { .. } | PhoneError::File { .. } => ExitStatus::Storage,
        PhoneError::Cancelled { .. } | PhoneError::Adb(AdbError::Cancelled) => {
            ExitStatus::Interrupted
        }
        PhoneError::Adb(AdbError::Io { .. }) => ExitStatus::Storage,
        _ => ExitStatus::Phone,
    }
}

fn phone_step(error: &PhoneError) -> Option<&'static str> {
    Some(match error {
        PhoneError::Address { .. } => {
            "give <host> or <host>:<port>, as the app's dialog shows it at its start"
        }
        PhoneError::Connect { .. } => {
            "open OpenCamera Sensors with its remote control switched on, and make sure that both are on the same network. If it is open, leave it and open it again: it may not listen any more"
        }
        PhoneError::MayRecord { why, .. } if why.is_app_gone() => {
            "the app has ended, and its video with it: open it again, see that it does not record, and start again"
        }
        PhoneError::MayRecord { .. } => {
            "look at the phone, and stop its video there: nothing here can do it now"
        }
        PhoneError::StartUndone { cause } => return phone_step(cause),
        PhoneError::StalePhase { .. } => {
            "nothing records now: run it again. (A video was begun on the phone itself, or by a start that failed.) If it fails each time, the frames are on another clock: connect the phone by USB with `adb`, which reads both"
        }
        PhoneError::FrameClock { .. } => {
            "restart the phone and keep its screen on, so that both clocks are one; or let it sleep for a minute"
        }
        PhoneError::Adb(error) => return adb_step(error),
        PhoneError::NoGyroscope => {
            "tick it in the app: IMU settings, Enabled sensors. (Up to v1.48.2.9 each request rewrites these ticks; later versions go by them)"
        }
        PhoneError::TooShort { .. } => {
            "keep the app in the foreground and the screen on until it has answered, then try again"
        }
        PhoneError::Hangs { .. } => {
            "force the app to stop in the phone's settings (Apps, OpenCamera Sensors), and open it again. Its video is whole: it lies on the phone. Storage without the storage access framework avoids this"
        }
        PhoneError::Timeout { .. } => {
            "bring the app to the foreground and close other clients: it serves one at a time. On a slow network, see whether it answers at all: `smartdepthsync phone imu --timeout 60s --phone HOST`"
        }
        PhoneError::TooSlow { .. } => "move the phone closer to the access point, or use a cable",
        PhoneError::Closed { request, .. } if *request == "get_video" => {
            "open the app again: it ends when it is asked for a video and has made none since it was opened. Record one first"
        }
        PhoneError::Closed { .. } | PhoneError::Connection { .. } => {
            "make sure that the app is open and in the foreground, then try again"
        }
        PhoneError::VideoTooShort { .. } | PhoneError::VideoTooLong { .. } => {
            "nothing was saved; try again once the app has finished the file"
        }
        PhoneError::VideoTooLarge { .. } => "copy it from the phone by MTP or a cable",
        PhoneError::UnsupportedVersion { .. } => {
            "install one of these versions of OpenCamera Sensors"
        }
        PhoneError::Refused { .. } => return error.refusal().map(app_refusal_step),
        PhoneError::Malformed { .. } => {
            "make sure that OpenCamera Sensors listens on this port, then try again"
        }
        PhoneError::Unrequested { .. } => {
            "connect again, and make sure that nothing else talks to the app"
        }
        PhoneError::TargetExists { .. } => "choose another place with --out, or give --overwrite",
        PhoneError::File { source, .. } => file_step(source.kind()),
        PhoneError::NotConnected => "connect again",
        PhoneError::Argument(_) => "`smartdepthsync help phone` lists what is accepted",
        PhoneError::Cancelled { request } if *request == "imu" => {
            "the phone records on until the time is up, then it is free again"
        }
        PhoneError::Cancelled { .. } => "run the command again when you are ready",
    })
}

fn adb_step(error: &AdbError) -> Option<&'static str> {
    Some(match error {
        AdbError::NoProgram => "install adb (Debian: `apt install adb`), or copy the files by MTP",
        AdbError::NoDevice { .. } => {
            "connect the phone by USB with USB debugging switched on, and allow this computer on its screen; or `adb connect`"
        }
        AdbError::SeveralDevices { .. } => {
            "leave one phone connected, or follow none: `record --track never`"
        }
        AdbError::NoAgent { .. } => {
            "build everything together (`cargo xtask build`), or record with `--track never`"
        }
        AdbError::NotFound { .. } => {
            "the app may save elsewhere, or the files of the video be deleted: copy them by hand, and give their folder to `extract --phone`"
        }
        AdbError::Failed { .. } => "try again once the phone is idle",
        AdbError::Io { source, .. } => file_step(source.kind()),
        AdbError::Cancelled => "run the command again when you are ready",
    })
}

/// Returns the next step after a refusal of the app.
const fn app_refusal_step(refusal: AppRefusal) -> &'static str {
    match refusal {
        AppRefusal::SensorsBusy => {
            "stop the video first (`smartdepthsync phone stop`): the app records its sensors already"
        }
        AppRefusal::NoPhase => {
            "try again: a video that was running was stopped. If it fails again, switch on `Enable video with IMU recording` in the app's IMU settings, which needs Camera2, and a video mode of more than 6 frames a second"
        }
        AppRefusal::VideoGone => {
            "the last video was deleted or moved on the phone: look for it there (gallery, bin, file manager), or record again"
        }
        AppRefusal::NoSensor => "take another phone: this one lacks a sensor",
        AppRefusal::UnknownRequest => {
            "the app does not know this form of the request: install v.0.1 or v.0.1.1"
        }
    }
}

impl Advice for ProfileError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        match self {
            Self::Read { .. } => (
                ExitStatus::Storage,
                "`smartdepthsync setup` asks for what a profile needs; `smartdepthsync profile \
                 init rig.toml` writes a commented one to start from"
                    .into(),
            ),
            Self::Syntax { path, .. } | Self::Value { path, .. } => {
                let file = path
                    .as_deref()
                    .map_or("rig.toml".into(), Path::to_string_lossy);
                let step = format!(
                    "correct that line; `smartdepthsync profile check {file}` checks it again"
                );
                (ExitStatus::Usage, step.into())
            }
        }
    }
}

impl Advice for RecordingError {
    fn advice(&self) -> (ExitStatus, Cow<'static, str>) {
        let step = match self {
            full if full.is_disk_full() => {
                "free some space; what was recorded before is kept and can be read"
            }
            Self::Mcap { .. } => {
                "give the folder of a recording or its recording.mcap; `smartdepthsync verify` says \
                 what is wrong with one"
            }
            Self::Io { source, .. } => file_step(source.kind()),
            Self::NoRecording { .. } | Self::ForeignBag { .. } => {
                return (ExitStatus::Usage, bag_step(self).into());
            }
            _ => "check the folder and its rights",
        };
        (ExitStatus::Storage, step.into())
    }
}

/// Returns the next step for a path that is not a recording, or a bag in an unsupported form.
pub(crate) fn bag_step(error: &RecordingError) -> &'static str {
    match error {
        RecordingError::ForeignBag { .. } => {
            "`python3 -m pip install rosbags` for the command, and give the folder that it makes"
        }
        _ => "give the folder that `record` made, its recording.mcap, or the folder of a ROS 2 bag",
    }
}

/// Returns the scale of the board's IMU, which every command that reads samples needs.
pub(crate) fn imu_scale(setup: &ImuSetup) -> Result<Scale, Failure> {
    Ok(Scale::from_setup(setup).ok_or(SessionError::NoScale)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_address_is_answered_with_its_form() {
        let error = PhoneError::Address {
            address: "phone:0".to_owned(),
            reason: "its port is out of range",
        };
        assert!(phone_step(&error).unwrap().contains("<host>:<port>"));
        assert_eq!(Failure::from(error).status(), ExitStatus::Usage);
    }
}
