//! The blocking client of the app.

use std::path::Path;
use std::time::{Duration, Instant};

use super::answer::{MalformedAnswer, ServerVersion};
use super::connection::Connection;
use super::download::{SavedVideo, check_free, receive};
use super::error::{PROBE, PhoneError};
use super::requests::{Asked, ImuBody, ImuRequest, SMALL_ANSWER, VideoHeader, VideoStart};
use super::samples::PhoneSample;
use super::settings::Settings;
use clock::PhoneNanos;
use system::Cancel;

/// TCP port of the app.
const DEFAULT_PORT: u16 = 6969;

/// Time after which the app itself gives up waiting for frames in `video_start`.
const APP_PHASE_TIMEOUT: Duration = Duration::from_secs(10);

/// Time for which stopping the video of an unreachable phone is retried.
const UNREACHABLE: Duration = Duration::from_secs(5);

/// The same for a phone that refuses the connection: the app has ended, and its video with it.
const REFUSED: Duration = Duration::from_millis(1_500);

/// Longest single attempt to stop a video: one answer may be lost and the next arrive.
const KNOCK: Duration = Duration::from_secs(3);

/// Largest video that is accepted, bytes.
const MAX_VIDEO: u64 = 64 << 30;

/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(250);

/// Request that finds out whether the app's sensors are free. It names both sensors of a data
/// set, because an old app enables those that are requested and disables the others.
const SHORTEST_IMU: ImuRequest = ImuRequest {
    duration: Duration::from_millis(1),
    accelerometer: true,
};

/// Duration of a recording that contains at least a few samples.
const SHORT_IMU: Duration = Duration::from_millis(300);

/// A client of the app on one phone. Each call blocks until the app has answered or a deadline has
/// passed ([`Settings`]).
#[derive(Debug)]
pub struct PhoneClient {
    address: String,
    settings: Settings,
    connection: Option<Connection>,
    /// The app has answered on this connection, so it serves no other client.
    served: bool,
    version: Option<ServerVersion>,
}

impl PhoneClient {
    /// Connects to the app at `address`, which is `<host>` or `<host>:<port>`.
    ///
    /// # Errors
    ///
    /// The address is invalid, or nothing accepts the connection in time.
    pub fn connect(address: &str, settings: Settings) -> Result<Self, PhoneError> {
        let address = with_port(address)?;
        let connection = Connection::open(&address, &settings)?;
        Ok(Self {
            address,
            settings,
            connection: Some(connection),
            served: false,
            version: None,
        })
    }

    /// Returns the version of the app, which is known from its first answer on.
    #[must_use]
    pub fn version(&self) -> Option<ServerVersion> {
        self.version
    }

    /// Opens a new connection with the same settings, after an error closed the last one.
    ///
    /// # Errors
    ///
    /// Nothing accepts the connection in time.
    pub fn reconnect(&mut self) -> Result<(), PhoneError> {
        // The app serves one client at a time: leave before knocking again.
        self.connection = None;
        self.served = false;
        self.connection = Some(Connection::open(&self.address, &self.settings)?);
        Ok(())
    }

    /// Returns the version of the app, without any effect on it: sends an empty line, which the
    /// app answers with an error.
    ///
    /// # Errors
    ///
    /// The connection fails, or the answer is not one of the app.
    pub fn probe(&mut self) -> Result<ServerVersion, PhoneError> {
        let margin = self.settings.margin;
        let answer = self.in_step(|connection| {
            connection.send(PROBE, "\n")?;
            connection.answer(PROBE, SMALL_ANSWER, margin, |_, _| Ok(()))
        });
        let version = match answer {
            Ok(version) | Err(PhoneError::Refused { version, .. }) => version,
            Err(error) => return Err(error),
        };
        self.served = true;
        self.version = Some(version);
        Ok(version)
    }

    /// Sends a request and reads its answer. The first one on a connection is sent only after the
    /// app has answered an empty line: the app would carry out a request that queues behind
    /// another client later, even if its sender has gone.
    fn exchange(
        &mut self,
        request: &'static str,
        line: &str,
        limit: u64,
        first: Duration,
        body: impl FnMut(u64, &str) -> Result<(), MalformedAnswer>,
    ) -> Result<(), PhoneError> {
        if !self.served {
            self.probe()?;
        }
        let version = self.in_step(|connection| {
            connection.send(request, line)?;
            connection.answer(request, limit, first, body)
        })?;
        self.version = Some(version);
        Ok(())
    }

    /// As [`PhoneClient::exchange`], for an answer of a few lines. Returns the lines of its body.
    fn short_exchange(
        &mut self,
        request: &'static str,
        line: &str,
        first: Duration,
    ) -> Result<Vec<String>, PhoneError> {
        let mut body = Vec::new();
        self.exchange(request, line, SMALL_ANSWER, first, |_, line| {
            body.push(line.to_owned());
            Ok(())
        })?;
        Ok(body)
    }

    /// Records the gyroscope for `duration` and returns its samples. The app refuses this while it
    /// records a video; the request is repeated for [`Settings::busy`].
    ///
    /// # Errors
    ///
    /// The connection fails, the app refuses, or the recording is missing or far too short.
    pub fn gyroscope(&mut self, duration: Duration) -> Result<Vec<PhoneSample>, PhoneError> {
        let request = ImuRequest::gyroscope(duration);
        let samples = self.imu_within(request, self.settings.busy)?;
        let samples = samples.ok_or(PhoneError::NoGyroscope)?;
        request.check_length(&samples)?;
        Ok(samples)
    }

    /// Repeats a request for up to `patience` while the sensors are busy.
    fn imu_within(
        &mut self,
        request: ImuRequest,
        patience: Duration,
    ) -> Result<Option<Vec<PhoneSample>>, PhoneError> {
        let until = Instant::now() + patience;
        loop {
            match self.imu_once(request) {
                Err(error) if error.is_busy() && Instant::now() < until => self.pause("imu")?,
                other => return other,
            }
        }
    }

    fn imu_once(&mut self, request: ImuRequest) -> Result<Option<Vec<PhoneSample>>, PhoneError> {
        let line = request.line()?;
        let first = request.duration.saturating_add(self.settings.margin);
        let mut body = ImuBody::default();
        self.exchange(
            "imu",
            &line,
            request.answer_limit(),
            first,
            |number, line| body.line(number, line),
        )?;
        body.finish().map_err(|source| self.damaged("imu", source))
    }

    /// Returns true if the app's sensors are in use, because it records or closes a video (with
    /// the sensors, which its settings must enable). Requests the shortest IMU recording, which
    /// leaves a short file on a phone whose sensors are free.
    ///
    /// # Errors
    ///
    /// The connection fails.
    pub fn is_recording(&mut self) -> Result<bool, PhoneError> {
        match self.wait_until_free(Duration::ZERO) {
            Err(error) if error.is_busy() => Ok(true),
            other => other.map(|()| false),
        }
    }

    /// Waits until the app's sensors are free, which they are once the last video is closed.
    ///
    /// # Errors
    ///
    /// The connection fails, or the sensors are still busy after `patience`.
    pub fn wait_until_free(&mut self, patience: Duration) -> Result<(), PhoneError> {
        match self.imu_within(SHORTEST_IMU, patience) {
            // The app checks whether it is busy before it checks for sensors.
            Err(error) if error.is_busy() || !matches!(error, PhoneError::Refused { .. }) => {
                Err(error)
            }
            _ => Ok(()),
        }
    }

    /// Returns the time of the last sample of a short recording of the gyroscope, which is the
    /// phone's boot clock a moment ago. `None` if there was no sample. A phone that records a
    /// video refuses this.
    ///
    /// # Errors
    ///
    /// The connection fails, or the app refuses.
    pub fn clock(&mut self) -> Result<Option<PhoneNanos>, PhoneError> {
        let request = ImuRequest {
            duration: SHORT_IMU,
            ..SHORTEST_IMU
        };
        let samples = self.imu_within(request, self.settings.busy)?;
        Ok(samples.and_then(|samples| Some(samples.last()?.time)))
    }

    fn pause(&self, request: &'static str) -> Result<(), PhoneError> {
        if self.settings.cancel.is_requested() {
            return Err(PhoneError::Cancelled { request });
        }
        std::thread::sleep(PAUSE);
        Ok(())
    }

    /// Starts a video and waits for the phase of its frames, about 2 s.
    ///
    /// The app toggles: while a video runs, this request stops it, and the answer is the phase of
    /// that video at once or an error after 10 s. So an answer that is earlier than the new
    /// video's frames can be is an error. `asked` holds the phone's clocks at the request; without
    /// it this computer's clock is used ([`VideoStart::checked`]). A start that fails may still
    /// have started a video: see [`PhoneClient::undo_start`].
    ///
    /// # Errors
    ///
    /// The connection fails, the app refuses, or the phase is that of another video.
    pub fn start_video(&mut self, asked: Option<Asked>) -> Result<VideoStart, PhoneError> {
        const REQUEST: &str = "video_start";
        if !self.served {
            self.probe()?;
        }
        let begun = Instant::now();
        let first = APP_PHASE_TIMEOUT.saturating_add(self.settings.margin);
        let body = self.short_exchange(REQUEST, "video_start\n", first)?;
        let start = VideoStart::parse(&body).map_err(|source| self.damaged(REQUEST, source))?;
        start.checked(asked, begun.elapsed(), first)
    }

    /// Stops the video that a failed start may have started. Returns the failure `cause` together
    /// with the outcome.
    ///
    /// Takes as long as the app may still be carrying out that start, and ignores
    /// [`Settings::cancel`].
    #[must_use]
    pub fn undo_start(&mut self, cause: PhoneError) -> PhoneError {
        if cause.is_before_request() {
            return cause;
        }
        let cause = Box::new(cause);
        let mut calm = Self {
            address: self.address.clone(),
            settings: Settings {
                cancel: Cancel::default(),
                margin: self.settings.margin.min(KNOCK),
                ..self.settings.clone()
            },
            connection: None,
            served: false,
            version: self.version,
        };
        // The app serves the next client only after this one has disconnected.
        self.connection = None;
        self.served = false;
        let begun = Instant::now();
        let patience = APP_PHASE_TIMEOUT.saturating_add(self.settings.margin);
        loop {
            let why = match calm.reconnect().and_then(|()| calm.stop_video()) {
                Ok(()) => return PhoneError::StartUndone { cause },
                Err(why) => why,
            };
            let patience = match &why {
                refused if refused.is_app_gone() => REFUSED,
                PhoneError::Connect { .. } => UNREACHABLE,
                _ => patience,
            };
            if begun.elapsed() >= patience {
                let why = Box::new(why);
                return PhoneError::MayRecord { cause, why };
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Stops the video. The app reports success even if none was running, and before the file is
    /// closed: see [`PhoneClient::wait_until_free`].
    ///
    /// # Errors
    ///
    /// The connection fails, or the app refuses.
    pub fn stop_video(&mut self) -> Result<(), PhoneError> {
        let margin = self.settings.margin;
        self.short_exchange("video_stop", "video_stop\n", margin)?;
        Ok(())
    }

    /// Downloads the last video into the folder `out`, or as the file `out`. `progress` receives
    /// the bytes so far and the size of the file.
    ///
    /// The file appears only once it is complete. The request is sent only once the app's sensors
    /// are free: an app that saves through the storage access framework hangs for good if it is
    /// asked while a video is recorded or closed. An app that has recorded no video since it was
    /// opened ends at this request.
    ///
    /// # Errors
    ///
    /// The connection fails, the app refuses or hangs, or the file cannot be written.
    pub fn get_video(
        &mut self,
        out: &Path,
        overwrite: bool,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<SavedVideo, PhoneError> {
        if !out.is_dir() {
            check_free(out, overwrite)?;
        }
        self.wait_until_free(self.settings.video_ready)?;
        let header = self.video_header()?;
        self.in_step(|connection| receive(connection, header, out, overwrite, progress))
    }

    fn video_header(&mut self) -> Result<VideoHeader, PhoneError> {
        const REQUEST: &str = "get_video";
        let asked = self.short_exchange(REQUEST, "get_video\n", self.settings.video_ready);
        if let Err(PhoneError::Timeout { waited, .. }) = asked {
            // Only a new connection distinguishes a slow app from one that hangs.
            let answers = self.reconnect().and_then(|()| self.probe());
            self.connection = None;
            if matches!(answers, Err(PhoneError::Timeout { .. })) {
                return Err(PhoneError::Hangs { waited });
            }
        }
        let header = VideoHeader::parse(&asked?).map_err(|source| self.damaged(REQUEST, source))?;
        if header.size > MAX_VIDEO {
            self.connection = None;
            let (size, limit) = (header.size, MAX_VIDEO);
            return Err(PhoneError::VideoTooLarge { size, limit });
        }
        Ok(header)
    }

    /// Closes the connection after a damaged answer, and returns the error.
    fn damaged(&mut self, request: &'static str, source: MalformedAnswer) -> PhoneError {
        self.connection = None;
        PhoneError::Malformed { request, source }
    }

    /// Runs one exchange. Closes the connection after any error but a refusal, as the position in
    /// the stream is then unknown.
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

/// Checks the form of a phone's address; nothing is contacted.
///
/// # Errors
///
/// It has no host, or a port that is none.
pub fn check_address(address: &str) -> Result<(), PhoneError> {
    with_port(address).map(drop)
}

/// Returns `address` with the app's port unless it names one, and an IPv6 address in brackets.
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
