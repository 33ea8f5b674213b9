//! The blocking client.

use std::path::Path;
use std::time::{Duration, Instant};

use super::DEFAULT_PORT;
use super::answer::{MalformedAnswer, ServerVersion};
use super::connection::Connection;
use super::download::{SavedVideo, check_free, receive};
use super::error::{PROBE, PhoneError};
use super::requests::{Asked, ImuBody, ImuRequest, SMALL_ANSWER, VideoHeader, VideoStart};
use super::samples::PhoneSample;
use super::settings::Settings;
use clock::PhoneNanos;
use system::Cancel;

/// How long the app itself waits for frames before it gives up on `video_start`.
const APP_PHASE_TIMEOUT: Duration = Duration::from_secs(10);

/// How long a phone that cannot be reached is tried again to stop its video.
const UNREACHABLE: Duration = Duration::from_secs(5);

/// The same of a phone that is there and refuses: the app has ended, and its video with it.
const REFUSED: Duration = Duration::from_millis(1_500);

/// How long one try to stop a video lasts: an answer may be lost, and the next one not.
const KNOCK: Duration = Duration::from_secs(3);

/// Largest video that is accepted, bytes.
const MAX_VIDEO: u64 = 64 << 30;

/// Pause between two tries of what may soon succeed.
const PAUSE: Duration = Duration::from_millis(250);

/// What asks the app whether its sensors are free; the answer says no more. Both sensors
/// of a data set: an old app ticks what it is asked for, and nothing else.
const SHORTEST_IMU: ImuRequest = ImuRequest {
    duration: Duration::from_millis(1),
    accelerometer: true,
};

/// A recording of this length has some samples in it.
const SHORT_IMU: Duration = Duration::from_millis(300);

/// A connection to the app.
#[derive(Debug)]
pub struct PhoneClient {
    address: String,
    settings: Settings,
    connection: Option<Connection>,
    /// The app has answered on this connection: it serves nobody else.
    served: bool,
    version: Option<ServerVersion>,
}

impl PhoneClient {
    /// Connects to the app at `address`, `<host>` or `<host>:<port>`.
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

    /// Version of the app, known from its first answer on.
    #[must_use]
    pub fn version(&self) -> Option<ServerVersion> {
        self.version
    }

    /// Opens a new connection after an error, with the same settings.
    pub fn reconnect(&mut self) -> Result<(), PhoneError> {
        // The app serves one client at a time: leave before knocking again.
        self.connection = None;
        self.served = false;
        self.connection = Some(Connection::open(&self.address, &self.settings)?);
        Ok(())
    }

    /// Asks whether the app is there and which version it is, without any
    /// effect on it: an empty line, which the app answers with an error.
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

    /// Sends a request and reads its answer. The first one on a connection is sent only
    /// when the app has answered an empty line: what waits behind another client is
    /// carried out later, even if nobody waits for it any more.
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

    /// As [`PhoneClient::exchange`], for an answer of a few lines; gives those of its body.
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

    /// Records the gyroscope for this duration, which this call lasts as well. The app refuses it while it records a video; it is tried again for
    /// [`Settings::busy`].
    ///
    /// # Errors
    ///
    /// The link, the app's refusal, no file, or a recording that is far too short.
    pub fn gyroscope(&mut self, duration: Duration) -> Result<Vec<PhoneSample>, PhoneError> {
        let request = ImuRequest::gyroscope(duration);
        let samples = self.imu_within(request, self.settings.busy)?;
        let samples = samples.ok_or(PhoneError::NoGyroscope)?;
        request.check_length(&samples)?;
        Ok(samples)
    }

    /// Asks again for `patience` while the sensors are busy.
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

    /// Whether the app's sensors are in use: it records a video (with its sensors, as its
    /// settings must have it here), or closes one. Asked by the shortest IMU recording
    /// that there is, which leaves a short file on a phone that is free.
    ///
    /// # Errors
    ///
    /// As [`PhoneClient::gyroscope`], but for that.
    pub fn is_recording(&mut self) -> Result<bool, PhoneError> {
        match self.wait_until_free(Duration::ZERO) {
            Err(error) if error.is_busy() => Ok(true),
            other => other.map(|()| false),
        }
    }

    /// Waits until the app's sensors are free: then the video before is closed.
    ///
    /// # Errors
    ///
    /// As [`PhoneClient::gyroscope`]; the app's own refusal if that lasts longer than
    /// `patience`.
    pub fn wait_until_free(&mut self, patience: Duration) -> Result<(), PhoneError> {
        match self.imu_within(SHORTEST_IMU, patience) {
            // The app looks whether it is busy before it looks for sensors.
            Err(error) if error.is_busy() || !matches!(error, PhoneError::Refused { .. }) => {
                Err(error)
            }
            _ => Ok(()),
        }
    }

    /// The phone's clock by now, or a little before: the time of the last sample of a short
    /// recording of its gyroscope. `None` if no sample came. A phone that records a video
    /// refuses.
    ///
    /// # Errors
    ///
    /// As [`PhoneClient::gyroscope`].
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
    /// The app toggles: asked while a video runs, it stops that one, and answers at once
    /// with that one's phase, or with an error 10 s later. So an answer that comes before
    /// the frames can is refused. `asked` is what is known of the phone's clocks by now;
    /// without it the time of this system counts ([`VideoStart::checked`]). Whether a video was begun by a start
    /// that fails is not known: see [`PhoneClient::undo_start`].
    ///
    /// # Errors
    ///
    /// The link, the app's refusal, or the phase of another video.
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

    /// After a start that failed: sees to it that no video runs that it may have begun.
    /// Gives the failure on, with what has become of it.
    ///
    /// It lasts as long as the app may still be at that start, and a request to stop does
    /// not end it.
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
        // Leave: the app hears the next client only when this one is gone.
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

    /// Stops the video. The app answers with success even if none was running, and before
    /// the video has ended: see [`PhoneClient::wait_until_free`].
    ///
    /// # Errors
    ///
    /// The link, or the app's refusal.
    pub fn stop_video(&mut self) -> Result<(), PhoneError> {
        let margin = self.settings.margin;
        self.short_exchange("video_stop", "video_stop\n", margin)?;
        Ok(())
    }

    /// Downloads the last video into the folder `out`, or as the file `out`; `progress` gets
    /// bytes received and bytes in all.
    ///
    /// The file appears only when it is whole. The app is asked only once its sensors
    /// are free: with its storage access framework it hangs for good if it is asked while
    /// a video is recorded or closed. Without any video since it was opened, the app ends
    /// at this request: make one first.
    ///
    /// # Errors
    ///
    /// The link, the app's refusal, the disk, or the app hangs.
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
            // Only a new connection tells a slow app from one that hangs.
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

    /// What the answer says is not what belongs there: the connection is out of step.
    fn damaged(&mut self, request: &'static str, source: MalformedAnswer) -> PhoneError {
        self.connection = None;
        PhoneError::Malformed { request, source }
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
