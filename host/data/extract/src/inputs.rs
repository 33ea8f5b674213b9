//! Inputs of an extraction: finds the files of a recording, and reads its session file.

pub(crate) mod board_data;
pub(crate) mod phone_rows;
pub(crate) mod survey;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::constants::{Constants, nanos};
use crate::depth::DepthInput;
use crate::depth::ros2_bag::Ros2Bag;
use crate::geometry::CameraFacts;
use crate::options::Options;
use phone::adb::get_files_command;
use phone::coverage::AssumedFrames;
use phone::video_files::{self, FilesError, VideoFiles};
use recording::RecordingError;
use recording::bag::{is_bag, mcap_in};
use recording::camera::{DEFAULT_CAMERA, Model};
use recording::depth_files::{depth_recordings, is_mkv};
use recording::profile::{Intrinsics, Phone, Pose, Profile};
use recording::rosbag2::METADATA_FILE;
use recording::session_file::{PHONES_FOLDER, PhoneRecord, SessionFile};
use recording::strobes::StrobeTrain;
use recording::verify::assumed_frames;

/// Phone and its files.
#[derive(Clone, Debug, Default)]
pub(crate) struct PhoneInput {
    /// Name in the rig profile, if there is a session.
    pub(crate) name: Option<String>,
    /// The phone's files.
    pub(crate) files: Option<VideoFiles>,
    /// Constants that go into its times.
    pub(crate) constants: Constants,
    /// The phone in the rig profile.
    pub(crate) profile: Option<Phone>,
    /// Clock of its sensors minus clock of its frames, ns.
    pub(crate) boot_minus_frames_ns: i64,
    /// Its frames as the session assumed them.
    pub(crate) assumed: Option<AssumedFrames>,
    /// Command that copies the files from the phone, if the session has its video.
    pub(crate) copy: Option<String>,
    /// Folder below the output; empty, for the output itself, if the trigger was aligned to
    /// this phone.
    pub(crate) folder: PathBuf,
}

impl PhoneInput {
    /// Returns true unless the trigger was aligned to this phone.
    pub(crate) fn is_other(&self) -> bool {
        !self.folder.as_os_str().is_empty()
    }

    /// Returns the phone's name, unless the trigger was aligned to it.
    pub(crate) fn other_name(&self) -> Option<&str> {
        let name = self.name.as_deref().unwrap_or_default();
        self.is_other().then_some(name)
    }

    /// Returns a text about the phone, after its name unless the trigger was aligned to it.
    pub(crate) fn about(&self, text: &str) -> String {
        match self.other_name() {
            Some(name) => format!("{name}: {text}"),
            None => text.to_owned(),
        }
    }

    /// Returns the known properties of the camera for images of a size.
    pub(crate) fn camera(&self, size: Option<(u32, u32)>) -> CameraFacts {
        let Some(phone) = &self.profile else {
            return CameraFacts::default();
        };
        let has_size = |camera: &&Intrinsics| Some(camera.size()) == size;
        let last = i64::from(phone.rows.saturating_sub(1));
        CameraFacts {
            intrinsics: phone.cameras.iter().find(has_size).cloned(),
            from_imu: phone.from_imu,
            shutter: nanos(phone.readout_us)
                .filter(|_| last > 0)
                .map(|readout| (readout / last, phone.readout_direction)),
        }
    }
}

/// Files of a recording, and facts from its session.
#[derive(Clone, Debug)]
pub(crate) struct Inputs {
    /// Name of the recording's folder.
    pub(crate) name: String,
    /// Board's recording, an MCAP file.
    pub(crate) board: PathBuf,
    /// Phone that the trigger was aligned to.
    pub(crate) phone: PhoneInput,
    /// Other phones.
    pub(crate) others: Vec<PhoneInput>,
    /// Depth recording.
    pub(crate) depth: Option<DepthInput>,
    /// Unique ID of the board.
    pub(crate) board_id: Option<String>,
    /// Name of the lidar, if there is a profile.
    pub(crate) lidar: Option<String>,
    /// Task that the recording shows, if the rig profile names one.
    pub(crate) task: Option<String>,
    /// Model of the depth camera; the published rig's if no profile names one.
    pub(crate) camera: Option<&'static Model>,
    /// Mode of the depth camera in the rig profile, if there is one.
    pub(crate) depth_mode: Option<String>,
    /// Exposure of the depth camera's colour images, ns, if the profile has it.
    pub(crate) color_exposure_ns: Option<i64>,
    /// Pose in the profile: from the board's IMU to the depth camera's colour camera.
    pub(crate) color_from_imu: Option<Pose>,
    /// Begin and end of the recorded span in board time, ns; the trigger was on its grid in it.
    pub(crate) recorded: Option<(i64, i64)>,
    /// Remarks for the report.
    pub(crate) remarks: Vec<String>,
}

/// Reason why there is nothing to extract from.
#[derive(Debug, thiserror::Error)]
pub enum InputsError {
    /// A file cannot be read.
    #[error("reading {path}: {error}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// The path is not a recording, or a bag of an unsupported form.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The phone's files cannot be found.
    #[error(transparent)]
    Phone(#[from] FilesError),
    /// The session does not know a phone.
    #[error("the recording has no phone called {name:?}; expected {}", known.join(", "))]
    UnknownPhone {
        /// The name that the user gave.
        name: String,
        /// Names of the session's phones.
        known: Vec<String>,
    },
    /// There are several depth recordings.
    #[error("{path} holds several depth recordings ({}); name one with --depth", names.join(", "))]
    SeveralDepth {
        /// The folder.
        path: PathBuf,
        /// Their names.
        names: Vec<String>,
    },
    /// The given depth recording is of another kind.
    #[error(
        "{path} is not a depth recording: expected a file that ends in .mkv, or a ROS 2 bag (its folder, or its file .mcap)"
    )]
    NotDepth {
        /// The file.
        path: PathBuf,
    },
}

impl Inputs {
    /// Returns the flashes of the depth camera in the profile's mode.
    pub(crate) fn train(&self) -> Option<StrobeTrain> {
        self.camera?.mode(self.depth_mode.as_deref()?)?.train
    }
}

fn unreadable(path: &Path) -> impl Fn(io::Error) -> InputsError {
    move |error| InputsError::Io {
        path: path.to_owned(),
        error,
    }
}

/// Finds the inputs, in the recording or where the user says. `phone` is the
/// folder of the phone that the trigger was aligned to.
///
/// # Errors
///
/// Fails if there is no recording, or if it is not clear which files belong to it.
pub(crate) fn find(
    recording: &Path,
    phone: Option<&Path>,
    depth: Option<&Path>,
    options: &Options,
) -> Result<Inputs, InputsError> {
    let folder = fs::metadata(recording)
        .map_err(unreadable(recording))?
        .is_dir();
    let board = mcap_in(recording)?;
    let mut remarks = Vec::new();
    let session = match SessionFile::load(system::folder_of(&board)) {
        Ok(session) => Some(session),
        Err(error) => {
            remarks.push(format!("the session's constants are not known: {error}"));
            None
        }
    };
    let given = options.profile.as_ref();
    let constants = Constants::for_reference(session.as_ref(), given);
    let topic = options.depth_topic.as_deref();
    let own = folder.then_some(recording);
    let (mut phone, others) = match &session {
        Some(session) => {
            let profile = given.unwrap_or(&session.profile);
            find_phones(session, profile, own, constants, phone, &options.phones)?
        }
        None => {
            check_names(&options.phones, &[])?;
            let files = find_phone(own, phone)?;
            let phone = PhoneInput {
                files,
                constants,
                ..PhoneInput::default()
            };
            (phone, Vec::new())
        }
    };
    if let Some(given) = given {
        phone.profile = Some(given.phone.clone());
    }
    let depth = match depth {
        Some(path) => Some(depth_file(path, topic)?),
        None if folder => find_depth(recording, topic)?,
        None => None,
    };
    let name = match recording.canonicalize() {
        Ok(path) => path
            .file_name()
            .map(|name| name.to_string_lossy().into_owned()),
        Err(_) => None,
    };
    let profile = given.or(session.as_ref().map(|session| &session.profile));
    let alignment = session.as_ref().and_then(|session| session.alignment);
    if let Some(shift_us) = alignment.map(|a| a.shift_us).filter(|&us| us != 0.0) {
        remarks.push(format!(
            "the trigger was shifted on purpose: the depth images are {shift_us:+.1} µs earlier than \
             aligned ones, and the distances of the pairs show it"
        ));
    }
    Ok(Inputs {
        name: name.unwrap_or_else(|| "recording".into()),
        board,
        phone,
        others,
        depth,
        board_id: session
            .as_ref()
            .and_then(|session| Some(session.board.as_ref()?.id.clone())),
        lidar: profile.map(|profile| profile.lidar_name().to_owned()),
        task: profile.and_then(|profile| profile.task.clone()),
        camera: Model::find(profile.map_or(DEFAULT_CAMERA, |profile| &profile.depth.camera)),
        depth_mode: profile.map(|profile| profile.depth.mode.clone()),
        color_exposure_ns: profile
            .and_then(|profile| profile.depth.color_exposure_us)
            .and_then(nanos),
        color_from_imu: profile.and_then(|profile| profile.depth.color_from_imu),
        recorded: session.and_then(|session| {
            let span = session.recorded?;
            let nanos = |ticks: protocol::Ticks| i64::try_from(ticks.as_nanos()).ok();
            Some((nanos(span.from)?, nanos(span.to)?))
        }),
        remarks,
    })
}

/// Checks that the session knows each phone that the user names.
fn check_names(given: &[(String, PathBuf)], known: &[String]) -> Result<(), InputsError> {
    match given.iter().find(|(name, _)| !known.contains(name)) {
        None => Ok(()),
        Some((name, _)) => Err(InputsError::UnknownPhone {
            name: name.clone(),
            known: known.to_vec(),
        }),
    }
}

/// Finds the phones of a session: the one that the trigger was aligned to, and the others.
/// `profile` has the constants of the rig, `phone` and `places` are the folders that the user gives.
fn find_phones(
    session: &SessionFile,
    profile: &Profile,
    recording: Option<&Path>,
    constants: Constants,
    phone: Option<&Path>,
    places: &[(String, PathBuf)],
) -> Result<(PhoneInput, Vec<PhoneInput>), InputsError> {
    let names: Vec<String> = session
        .profile
        .all_phones()
        .map(|phone| phone.name.clone())
        .collect();
    check_names(places, &names)?;
    let several = names.len() > 1;
    let files_of = |name: &str, place: Option<&Path>| {
        let named = places.iter().find(|(given, _)| given == name);
        let place = named.map(|(_, place)| place.as_path()).or(place);
        let own = recording.map(|folder| folder.join(session.phone_folder(name)));
        // With several phones, one whose files were never fetched has no folder.
        let own = own.filter(|own| !several || own.is_dir());
        find_phone(own.as_deref(), place)
    };
    let copy = |record: Option<&PhoneRecord>| {
        let (record, folder) = (record?, recording?);
        let place = folder.join(session.phone_folder(&record.name));
        Some(get_files_command(record.video?.phase, &place, true))
    };
    let boot_minus_frames_ns = |record: Option<&PhoneRecord>| {
        let video = record.and_then(|record| record.video);
        video.map_or(0, |video| video.boot_minus_frames_ns)
    };
    let reference = PhoneInput {
        name: Some(session.profile.phone.name.clone()),
        files: files_of(&session.profile.phone.name, phone)?,
        constants,
        profile: Some(session.profile.phone.clone()),
        boot_minus_frames_ns: boot_minus_frames_ns(session.reference()),
        copy: copy(session.reference()),
        assumed: session
            .reference()
            .and_then(|record| assumed_frames(session, record)),
        folder: PathBuf::new(),
    };
    let mut others = Vec::new();
    for phone in &session.profile.phones {
        let record = session.phone(&phone.name);
        others.push(PhoneInput {
            name: Some(phone.name.clone()),
            files: files_of(&phone.name, None)?,
            constants: constants.for_other(phone, record, profile),
            profile: Some(phone.clone()),
            boot_minus_frames_ns: boot_minus_frames_ns(record),
            copy: copy(record),
            assumed: record.and_then(|record| assumed_frames(session, record)),
            folder: Path::new(PHONES_FOLDER).join(&phone.name),
        });
    }
    Ok((reference, others))
}

/// Finds a phone's files in the folder that the user names, with the video that the
/// session fetched into the recording's folder; without such a folder, all of them there.
fn find_phone(
    recording: Option<&Path>,
    place: Option<&Path>,
) -> Result<Option<VideoFiles>, FilesError> {
    let Some(place) = place else {
        return recording.map_or(Ok(None), |folder| video_files::find(folder, None));
    };
    let own = recording.and_then(|folder| video_files::find(folder, None).ok().flatten());
    let fetched = own.filter(|own| own.video.is_some());
    let name = fetched.as_ref().map(|own| own.name.as_str());
    let found = video_files::find(place, name)?;
    Ok(found.map(|found| VideoFiles {
        video: found
            .video
            .clone()
            .or_else(|| fetched.and_then(|own| own.video)),
        ..found
    }))
}

/// Returns the names of files.
fn names(paths: &[PathBuf]) -> Vec<String> {
    let names = paths.iter().filter_map(|path| path.file_name());
    names
        .map(|name| name.to_string_lossy().into_owned())
        .collect()
}

/// Recognises the kind of a depth recording.
fn depth_file(path: &Path, topic: Option<&str>) -> Result<DepthInput, InputsError> {
    fs::metadata(path).map_err(unreadable(path))?;
    // A file in a bag's folder stands for it.
    let is_metadata = path.file_name().is_some_and(|name| name == METADATA_FILE);
    let path = if is_metadata {
        system::folder_of(path)
    } else {
        path
    };
    if is_mkv(path) {
        Ok(DepthInput::Mkv(path.to_owned()))
    } else if is_bag(path) {
        mcap_in(path)?;
        Ok(DepthInput::Ros2(Ros2Bag {
            path: path.to_owned(),
            topic: topic.map(str::to_owned),
        }))
    } else {
        Err(InputsError::NotDepth {
            path: path.to_owned(),
        })
    }
}

/// Finds the depth recording in a recording's folder.
fn find_depth(folder: &Path, topic: Option<&str>) -> Result<Option<DepthInput>, InputsError> {
    let found = depth_recordings(folder).map_err(unreadable(folder))?;
    match found.as_slice() {
        [] => Ok(None),
        [one] => depth_file(one, topic).map(Some),
        several => Err(InputsError::SeveralDepth {
            path: folder.to_owned(),
            names: names(several),
        }),
    }
}
