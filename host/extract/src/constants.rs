//! The constants of a rig that go into times, resolved once: what the user gives goes before
//! what the session says, and that before the rig profile.

use protocol::ImuSensor;
use recording::error_budget::ErrorPart;
use recording::profile::{Phone, Profile};
use recording::session_file::{PhoneRecord, SessionFile};
use serde::Serialize;
use twist_sync::Prior;

use super::gyro_clock::prior;
use super::options::Options;

/// The published system's low-pass setting: 184/188 Hz, delay 1.9 ms.
const PUBLISHED_DELAY_NS: i64 = 1_900_000;

/// Constants that go into the times of a phone, the board and the depth camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Constants {
    /// Low-pass delay subtracted from the board's IMU times (not in the topics
    /// layout), ns.
    pub board_imu_delay_ns: i64,
    /// The same of the phone, ns.
    pub phone_imu_delay_ns: i64,
    /// From the phone's frame timestamp (start of exposure of the first row) to the middle of
    /// exposure of the middle row, ns. Parts that are not known count as 0.
    pub color_middle_ns: i64,
    /// From the trigger pulse to the depth timestamp, ns.
    pub depth_center_ns: i64,
    /// Exposure and readout of the phone are both known.
    #[serde(skip)]
    pub(crate) is_middle_known: bool,
    /// Where the time from pulse to depth timestamp comes from.
    #[serde(skip)]
    pub(crate) center_source: CenterSource,
    /// 1-sigma of the constant between depth and phone, µs; nothing where the user gives it.
    #[serde(skip)]
    pub(crate) constant_sigma_us: Option<f64>,
    /// The largest part of that.
    #[serde(skip)]
    pub(crate) constant_part: ErrorPart,
    /// The board's IMU.
    #[serde(skip)]
    pub(crate) board_sensor: ImuSensor,
    /// The relation of the clocks that the session knows.
    #[serde(skip)]
    pub(crate) prior: Option<Prior>,
}

/// Where the time from pulse to depth timestamp comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum CenterSource {
    /// The user: the whole of it.
    Given,
    /// The session, for the mode and the settings of its profile.
    Session,
    /// It is not known.
    #[default]
    Unknown,
}

impl Constants {
    /// Those of the phone that the trigger was aligned to. Values out of reason are left out.
    pub(crate) fn of(session: Option<&SessionFile>, options: &Options) -> Self {
        let given = Self {
            board_imu_delay_ns: options.board_imu_delay_ns.unwrap_or(0),
            phone_imu_delay_ns: options.phone_imu_delay_ns.unwrap_or(0),
            depth_center_ns: options.depth_center_ns.unwrap_or(0),
            center_source: match options.depth_center_ns {
                Some(_) => CenterSource::Given,
                None => CenterSource::Unknown,
            },
            ..Self::default()
        };
        let middle_row = options.readout_ns.map(|readout| readout / 2);
        let Some(session) = session else {
            return given.with_middle(options.exposure_ns, middle_row);
        };
        let profile = &session.profile;
        let alignment = session.alignment.as_ref();
        let video = session.reference().and_then(|phone| phone.video);
        let reported = video.and_then(|video| video.exposure_ns);
        let exposure = match (alignment, reported) {
            (Some(alignment), _) => nanos(alignment.exposure_us),
            (None, Some(exposure)) => i64::try_from(exposure).ok(),
            (None, None) => nanos(profile.phone.exposure_us),
        };
        let row_us = alignment.map_or(profile.phone.middle_row_us(), |a| a.middle_row_us);
        let constants = Self {
            board_imu_delay_ns: options.board_imu_delay_ns.unwrap_or_else(|| {
                let imu = session.imu.as_ref();
                imu.map_or(0, |imu| i64::from(imu.scale.gyro_delay_us) * 1000)
            }),
            phone_imu_delay_ns: (options.phone_imu_delay_ns)
                .or(nanos(profile.phone.gyro_delay_us))
                .unwrap_or(0),
            board_sensor: session
                .imu
                .as_ref()
                .map_or_else(ImuSensor::default, |imu| imu.setup.sensor),
            prior: session.clock().map(prior),
            ..given
        };
        constants.with_center(alignment, profile).with_middle(
            options.exposure_ns.or(exposure),
            middle_row.or(nanos(row_us)),
        )
    }

    /// Those of another phone, of which the session says `said`; what is the rig's stays.
    pub(crate) fn of_other(
        self,
        phone: &Phone,
        said: Option<&PhoneRecord>,
        profile: &Profile,
    ) -> Self {
        let reported = said
            .and_then(|said| said.video?.exposure_ns)
            .filter(|&exposure| exposure > 0)
            .and_then(|exposure| i64::try_from(exposure).ok());
        let exposure = reported.or_else(|| nanos(phone.exposure_us));
        let exposure_us = exposure.unwrap_or_default() as f64 * 1e-3;
        let sigma_us = profile.other_constant_sigma_us(phone, exposure_us);
        let constants = Self {
            phone_imu_delay_ns: nanos(phone.gyro_delay_us).unwrap_or(0),
            prior: said.and_then(|said| said.clock).map(prior),
            constant_sigma_us: self.constant_sigma_us.map(|_| sigma_us),
            ..self
        };
        constants.with_middle(exposure, nanos(phone.middle_row_us()))
    }

    /// Takes what is known of the published system's settings, which its bags do not say;
    /// whether anything had to be taken.
    pub(crate) fn take_published(&mut self, options: &Options) -> bool {
        let is_open = options.board_imu_delay_ns.is_none();
        if is_open {
            self.board_imu_delay_ns = PUBLISHED_DELAY_NS;
        }
        is_open
    }

    /// Puts the depth timestamp later.
    pub(crate) const fn delay_depth(&mut self, by_ns: i64) {
        self.depth_center_ns = self.depth_center_ns.saturating_add(by_ns);
    }

    fn with_center(
        mut self,
        alignment: Option<&recording::session_file::Alignment>,
        profile: &Profile,
    ) -> Self {
        if self.center_source == CenterSource::Given {
            return self;
        }
        let exposure_us = alignment.map_or(profile.phone.exposure_us, |a| a.exposure_us);
        self.constant_sigma_us = Some(profile.constant_sigma_us(exposure_us));
        self.constant_part = profile.constant_part(exposure_us);
        let center = alignment.map_or(profile.depth.center_offset_us, |a| a.center_offset_us);
        // A measured bias says that the depth image is exposed later than its nominal centre,
        // against the phone's middle row.
        let bias = alignment.map_or(profile.frame_sync.bias_us, |a| a.bias_us);
        if let Some(center) = nanos(center + bias) {
            self.depth_center_ns = center;
            self.center_source = CenterSource::Session;
        }
        self
    }

    fn with_middle(self, exposure: Option<i64>, middle_row: Option<i64>) -> Self {
        let half_exposure = exposure.unwrap_or(0) / 2;
        Self {
            color_middle_ns: half_exposure.saturating_add(middle_row.unwrap_or(0)),
            is_middle_known: exposure.is_some() && middle_row.is_some(),
            ..self
        }
    }
}

/// Microseconds in whole nanoseconds, within ±1 s.
pub(crate) fn nanos(us: f64) -> Option<i64> {
    let within = us.is_finite() && us.abs() <= 1e6;
    within.then(|| (us * 1000.0).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_row_is_the_profile_s_where_nothing_was_aligned() {
        let middle = |text: &str, options: &Options| {
            let profile = Profile::parse(text, None).unwrap();
            let session = SessionFile::new(String::from("walk"), profile);
            Constants::of(Some(&session), options).color_middle_ns
        };
        let phone = "[phone]\nexposure_us = 8000\nreadout_us = 10000\nrows = 1001\n";
        let none = Options::default();
        assert_eq!(middle(phone, &none), 4_000_000 + 5_000_000);
        let row = format!("{phone}middle_row = 250\n");
        assert_eq!(middle(&row, &none), 4_000_000 + 2_500_000);
        // The user's word goes before.
        let given = Options {
            readout_ns: Some(12_000_000),
            ..Options::default()
        };
        assert_eq!(middle(&row, &given), 4_000_000 + 6_000_000);
    }
}
