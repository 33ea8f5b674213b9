//! The blocking client.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use super::DEFAULT_PORT;
use super::answer::ServerVersion;
use super::connection::Connection;
use super::download::{Pace, SavedVideo, VideoTarget, check_free, receive};
use super::error::PhoneError;
use super::requests::{
    ImuBody, ImuRecording, ImuRequest, SMALL_ANSWER, VideoHeaderBody, VideoStart, VideoStartBody,
};

/// How long the app itself waits for frames before it gives up on `video_start`.
const APP_PHASE_TIMEOUT: Duration = Duration::from_secs(10);

/// Deadlines and limits of a client.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Longest time to connect.
    pub connect: Duration,
    /// Patience beyond the time that a request takes by its nature: an IMU
    /// recording its duration, `video_start` the app's own 10 s. Also the
    /// longest pause within a download.
    pub margin: Duration,
    /// How long `get_video` may take to begin: while the app still writes the
    /// file, it makes the client wait.
    pub video_ready: Duration,
    /// Largest video that is accepted, in bytes.
    pub max_video: u64,
    /// Ends a request under way, with [`PhoneError::Cancelled`], within about
    /// 100 ms of turning true.
    pub stop: StopSignal,
}

/// A question that is asked while waiting: is it time to stop?
#[derive(Clone)]
pub struct StopSignal(Arc<dyn Fn() -> bool + Send + Sync>);

impl StopSignal {
    /// Stops when `question` answers true.
    pub fn new(question: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(question))
    }

    pub(super) fn is_set(&self) -> bool {
        (self.0)()
    }
}

impl Default for StopSignal {
    /// Never stops.
    fn default() -> Self {
        Self::new(|| false)
    }
}

impl fmt::Debug for StopSignal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("StopSignal").field(&self.is_set()).finish()
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            connect: Duration::from_secs(5),
            margin: Duration::from_secs(15),
            video_ready: Duration::from_secs(120),
            max_video: 64 << 30,
            stop: StopSignal::default(),
        }
    }
}

/// A connection to the app.
#[derive(Debug)]
pub struct PhoneClient {
    address: String,
    settings: Settings,
    connection: Option<Connection>,
    version: Option<ServerVersion>,
}

impl PhoneClient {
    /// Connects to the app at `address`, `<host>` or `<host>:<port>`.
    pub fn connect(address: &str, settings: Settings) -> Result<Self, PhoneError> {
        let address = with_port(address)?;
        let connection = Connection::open(&address, settings.connect, settings.stop.clone())?;
        Ok(Self {
            address,
            settings,
            connection: Some(connection),
            version: None,
        })
    }

    /// The address with its port.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Version of the app, known from its first answer on.
    #[must_use]
    pub fn version(&self) -> Option<ServerVersion> {
        self.version
    }

    /// Whether the connection is in step and the phone has not closed it meanwhile,
    /// as far as this system has heard: a request would at least be sent.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        self.connection.as_ref().is_some_and(Connection::is_alive)
    }

    /// Opens a new connection after an error, with the same settings.
    pub fn reconnect(&mut self) -> Result<(), PhoneError> {
        // The app serves one client at a time: leave before knocking again.
        self.connection = None;
        self.connection = Some(Connection::open(
            &self.address,
            self.settings.connect,
            self.settings.stop.clone(),
        )?);
        Ok(())
    }

    /// Asks whether the app is there and which version it is, without any
    /// effect on it: an empty line, which the app answers with an error.
    pub fn probe(&mut self) -> Result<ServerVersion, PhoneError> {
        const REQUEST: &str = "an empty request";
        let margin = self.settings.margin;
        let answer = self.in_step(|connection| {
            connection.send(REQUEST, "\n", margin)?;
            connection.answer(REQUEST, SMALL_ANSWER, margin, |_, _| Ok(()))
        });
        let version = match answer {
            Ok(version) | Err(PhoneError::Refused { version, .. }) => version,
            Err(error) => return Err(error),
        };
        self.version = Some(version);
        Ok(version)
    }

    /// Records motion sensors for the duration of the request, which this call
    /// lasts as well. The app refuses it while it records a video.
    pub fn imu(&mut self, request: ImuRequest) -> Result<ImuRecording, PhoneError> {
        let line = request.line()?;
        let margin = self.settings.margin;
        let (version, recording) = self.in_step(|connection| {
            connection.send("imu", &line, margin)?;
            let mut body = ImuBody::new(request);
            let patience = request.duration.saturating_add(margin);
            let version =
                connection.answer("imu", request.answer_limit(), patience, |number, line| {
                    body.line(number, line)
                })?;
            let recording = body.finish().map_err(|source| PhoneError::Malformed {
                request: "imu",
                source,
            })?;
            Ok((version, recording))
        })?;
        self.version = Some(version);
        Ok(recording)
    }

    /// Starts a video and waits for the phase of its frames, about 2 s.
    ///
    /// The app toggles: asked while a video runs, it stops that one and answers
    /// with an error 10 s later.
    pub fn start_video(&mut self) -> Result<VideoStart, PhoneError> {
        const REQUEST: &str = "video_start";
        let margin = self.settings.margin;
        let (version, start) = self.in_step(|connection| {
            connection.send(REQUEST, "video_start\n", margin)?;
            let mut body = VideoStartBody::default();
            let patience = APP_PHASE_TIMEOUT.saturating_add(margin);
            let version = connection.answer(REQUEST, SMALL_ANSWER, patience, |number, line| {
                body.line(number, line)
            })?;
            let start = body.finish().map_err(|source| PhoneError::Malformed {
                request: REQUEST,
                source,
            })?;
            Ok((version, start))
        })?;
        self.version = Some(version);
        Ok(start)
    }

    /// Stops the video. The app answers with success even if none was running.
    pub fn stop_video(&mut self) -> Result<(), PhoneError> {
        const REQUEST: &str = "video_stop";
        let margin = self.settings.margin;
        let version = self.in_step(|connection| {
            connection.send(REQUEST, "video_stop\n", margin)?;
            connection.answer(REQUEST, SMALL_ANSWER, margin, |_, _| Ok(()))
        })?;
        self.version = Some(version);
        Ok(())
    }

    /// Downloads the last video to `target`; `progress` gets bytes received and
    /// bytes in all.
    ///
    /// The target appears only when it is whole. While a video is being
    /// recorded the app does not answer: stop it first.
    pub fn get_video(
        &mut self,
        target: &VideoTarget,
        overwrite: bool,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<SavedVideo, PhoneError> {
        const REQUEST: &str = "get_video";
        if let VideoTarget::File(path) = target {
            check_free(path, overwrite)?;
        }
        let Settings {
            margin,
            video_ready,
            max_video,
            ..
        } = self.settings.clone();
        let (version, saved) = self.in_step(|connection| {
            connection.send(REQUEST, "get_video\n", margin)?;
            let mut body = VideoHeaderBody::default();
            let version =
                connection.answer(REQUEST, SMALL_ANSWER, video_ready, |number, line| {
                    body.line(number, line)
                })?;
            let header = body.finish().map_err(|source| PhoneError::Malformed {
                request: REQUEST,
                source,
            })?;
            if header.size > max_video {
                return Err(PhoneError::VideoTooLarge {
                    size: header.size,
                    limit: max_video,
                });
            }
            let pace = Pace {
                idle: margin,
                window: margin.saturating_mul(2),
            };
            let saved = receive(connection, header, target, overwrite, pace, progress)?;
            Ok((version, saved))
        })?;
        self.version = Some(version);
        Ok(saved)
    }

    /// Runs one exchange; closes the connection if it ends out of step.
    fn in_step<T>(
        &mut self,
        exchange: impl FnOnce(&mut Connection) -> Result<T, PhoneError>,
    ) -> Result<T, PhoneError> {
        let connection = self.connection.as_mut().ok_or(PhoneError::NotConnected)?;
        let result = exchange(connection);
        if result
            .as_ref()
            .is_err_and(|e| !matches!(e, PhoneError::Refused { .. }))
        {
            self.connection = None;
        }
        result
    }
}

/// `address` with the app's port unless it names one. IPv6 goes into brackets.
fn with_port(address: &str) -> Result<String, PhoneError> {
    let wrong = |reason| PhoneError::Address {
        address: address.to_owned(),
        reason,
    };
    if let Ok(ip) = address.parse::<std::net::Ipv6Addr>() {
        return Ok(format!("[{ip}]:{DEFAULT_PORT}"));
    }
    let (host, port) = match address.rsplit_once(':') {
        Some((host, port)) if !address.ends_with(']') => (host, Some(port)),
        _ => (address, None),
    };
    if host.is_empty() || host.contains(char::is_whitespace) || host.contains('/') {
        return Err(wrong("the host is missing or not a host name"));
    }
    match port {
        None => Ok(format!("{host}:{DEFAULT_PORT}")),
        Some(port) => match port.parse::<u16>() {
            Ok(port) if port != 0 => Ok(format!("{host}:{port}")),
            _ => Err(wrong("the port is not a number from 1 to 65535")),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_get_the_app_s_port() {
        for (given, full) in [
            ("192.168.1.48", "192.168.1.48:6969"),
            ("phone.local:7000", "phone.local:7000"),
            ("::1", "[::1]:6969"),
            ("[::1]", "[::1]:6969"),
            ("[::1]:70", "[::1]:70"),
        ] {
            assert_eq!(with_port(given).unwrap(), full);
        }
        for bad in [
            "",
            ":6969",
            "phone:",
            "phone:0",
            "phone:99999",
            "a b",
            "http://x",
        ] {
            let e = with_port(bad).unwrap_err();
            assert!(matches!(e, PhoneError::Address { .. }), "{bad:?}: {e}");
        }
    }
}
