//! Constants of a rig that go into times, resolved once: from the profile that the user
//! gives, otherwise from the session's alignment, otherwise from the session's profile. The exposure
//! that was used or reported takes precedence over any profile's; the delay of the board's IMU is
//! that of the board's settings.

use protocol::ImuSensor;
use recording::error_budget::ErrorPart;
use recording::profile::{Phone, Profile};
use recording::session_file::{PhoneRecord, SessionFile};
use recording::strobes::SeenExposures;
use serde::Serialize;
use twist_sync::Prior;

/// Low-pass delay of the published system's setting (184/188 Hz), ns.
pub(crate) const PUBLISHED_DELAY_NS: i64 = 1_900_000;

/// Constants that go into the times of a phone, the board and the depth camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Constants {
    /// Low-pass delay subtracted from the board's IMU times (not in the topics
    /// layout), ns.
    pub board_imu_delay_ns: i64,
    /// Low-pass delay subtracted from the phone's IMU times, ns.
    pub phone_imu_delay_ns: i64,
    /// Time from the phone's frame timestamp (start of exposure of the first row) to the middle of
    /// exposure of the middle row, ns. Unknown contributions count as 0.
    pub color_middle_ns: i64,
    /// Time from the trigger pulse to the depth timestamp (centre of exposure), ns.
    pub depth_center_ns: i64,
    /// True if exposure and readout of the phone are both known.
    #[serde(skip)]
    pub(crate) is_middle_known: bool,
    /// True if the time from pulse to depth timestamp is known, for the mode of the profile.
    #[serde(skip)]
    pub(crate) is_center_known: bool,
    /// 1-sigma of the constant between depth and phone, µs.
    #[serde(skip)]
    pub(crate) constant_sigma_us: Option<f64>,
    /// Largest contribution to it.
    #[serde(skip)]
    pub(crate) constant_part: ErrorPart,
    /// The same without the depth camera's part; `None` if a measured bias includes it.
    #[serde(skip)]
    pub(crate) without_depth: Option<(f64, ErrorPart)>,
    /// The profile's measured middle of the depth exposure after the trigger's edge and its
    /// 1-sigma, µs.
    #[serde(skip)]
    pub(crate) measured_depth: Option<[f64; 2]>,
    /// Model of the board's IMU.
    #[serde(skip)]
    pub(crate) board_sensor: ImuSensor,
    /// Relation of the clocks that the session found.
    #[serde(skip)]
    pub(crate) prior: Option<Prior>,
}

impl Constants {
    /// Returns the constants of the phone that the trigger was aligned to. A `given` profile
    /// replaces the session's. Absurd values count as unknown.
    pub(crate) fn for_reference(session: Option<&SessionFile>, given: Option<&Profile>) -> Self {
        let Some(profile) = given.or(session.map(|session| &session.profile)) else {
            return Self::default();
        };
        let alignment = session.and_then(|session| session.alignment.as_ref());
        let reference = session.and_then(SessionFile::reference);
        let reported = reference.and_then(|phone| phone.video?.exposure_us());
        let used = alignment.map(|alignment| alignment.exposure_us);
        let exposure_us = used.or(reported).unwrap_or(profile.phone.exposure_us);
        // A measured bias means that the depth image is exposed later than its nominal centre,
        // relative to the phone's middle row.
        let own = (
            profile.phone.middle_row_us(),
            profile.depth.center_offset_us + profile.frame_sync.bias_us,
        );
        let aligned = alignment.filter(|_| given.is_none());
        let (row_us, center_us) = aligned.map_or(own, |aligned| {
            let center_us = aligned.center_offset_us + aligned.bias_us;
            (aligned.middle_row_us, center_us)
        });
        let center = nanos(center_us);
        let imu = session.and_then(|session| session.imu.as_ref());
        let constants = Self {
            board_imu_delay_ns: imu.map_or(0, |imu| i64::from(imu.scale.gyro_delay_us) * 1000),
            phone_imu_delay_ns: nanos(profile.phone.gyro_delay_us).unwrap_or(0),
            depth_center_ns: center.unwrap_or(0),
            is_center_known: center.is_some(),
            constant_sigma_us: Some(profile.constant_sigma_us(exposure_us)),
            constant_part: profile.constant_part(exposure_us),
            without_depth: without_depth(profile, exposure_us),
            measured_depth: measured_depth(profile),
            board_sensor: imu.map_or_else(ImuSensor::default, |imu| imu.setup.sensor),
            prior: session.and_then(SessionFile::clock).map(Prior::Relation),
            ..Self::default()
        };
        constants.with_middle(nanos(exposure_us), nanos(row_us))
    }

    /// Returns the constants of another phone with its session `record`; those of the rig stay.
    pub(crate) fn for_other(
        self,
        phone: &Phone,
        record: Option<&PhoneRecord>,
        profile: &Profile,
    ) -> Self {
        let reported = record.and_then(|record| record.video?.exposure_us());
        let exposure_us = reported.unwrap_or(phone.exposure_us);
        let constants = Self {
            phone_imu_delay_ns: nanos(phone.gyro_delay_us).unwrap_or(0),
            prior: record.and_then(|record| record.clock).map(Prior::Relation),
            constant_sigma_us: Some(profile.other_constant_sigma_us(phone, exposure_us)),
            ..self
        };
        constants.with_middle(nanos(exposure_us), nanos(phone.middle_row_us()))
    }

    /// Takes the time from pulse to depth timestamp from a photodiode. Returns its difference from
    /// the one before, ns, with true if that was measured and is another one; `None` if a bias was
    /// measured that includes the error of that.
    pub(crate) fn see_depth(&mut self, seen: &SeenExposures) -> Option<(i64, bool)> {
        let (others_us, part) = self.without_depth?;
        let center_ns = nanos(seen.center_us)?;
        let change_ns = center_ns - self.depth_center_ns;
        let disagrees = (self.measured_depth)
            .is_some_and(|[before_us, sigma_us]| seen.disagree_with(before_us, sigma_us));
        self.depth_center_ns = center_ns;
        self.constant_sigma_us = Some(others_us.hypot(seen.sigma_us));
        self.constant_part = part;
        Some((change_ns, disagrees))
    }

    /// Makes depth timestamps later by `by_ns`.
    pub(crate) const fn delay_depth(&mut self, by_ns: i64) {
        self.depth_center_ns = self.depth_center_ns.saturating_add(by_ns);
    }

    /// Sets the time to the middle of exposure, from exposure and middle row in ns.
    fn with_middle(self, exposure: Option<i64>, middle_row: Option<i64>) -> Self {
        let half_exposure = exposure.unwrap_or(0) / 2;
        Self {
            color_middle_ns: half_exposure.saturating_add(middle_row.unwrap_or(0)),
            is_middle_known: exposure.is_some() && middle_row.is_some(),
            ..self
        }
    }
}

/// Returns the middle of the depth exposure and its 1-sigma, µs, if a photodiode has measured it in
/// the profile's mode.
fn measured_depth(profile: &Profile) -> Option<[f64; 2]> {
    let (part, sigma_us) = profile.depth.center_part();
    (part == ErrorPart::MeasuredDepth).then_some([profile.depth.center_offset_us, sigma_us])
}

/// Returns the 1-sigma of a profile's constant without the depth camera's part, µs, and its largest
/// part.
fn without_depth(profile: &Profile, exposure_us: f64) -> Option<(f64, ErrorPart)> {
    let (of_depth, _) = profile.depth.center_part();
    let parts = profile.constant_parts(exposure_us);
    let others = parts.iter().filter(|part| part.0 != of_depth);
    let largest = others.clone().max_by(|a, b| a.1.total_cmp(&b.1))?.0;
    profile.frame_sync.bias_measured.is_none().then(|| {
        let sigma_us = others.fold(0.0, |sum: f64, part| sum.hypot(part.1));
        (sigma_us, largest)
    })
}

/// Converts microseconds to whole nanoseconds; `None` beyond ±1 s.
pub(crate) fn nanos(us: f64) -> Option<i64> {
    let within = us.is_finite() && us.abs() <= 1e6;
    within.then(|| (us * 1000.0).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_row_is_the_profiles_without_an_alignment() {
        let profile = |text: &str| Profile::parse(text, None).unwrap();
        let middle = |text: &str, given: Option<&Profile>| {
            let session = SessionFile::new(String::from("walk"), profile(text));
            Constants::for_reference(Some(&session), given).color_middle_ns
        };
        let phone = "[phone]\nexposure_us = 8000\nreadout_us = 10000\nrows = 1001\n";
        assert_eq!(middle(phone, None), 4_000_000 + 5_000_000);
        let row = format!("{phone}middle_row = 250\n");
        assert_eq!(middle(&row, None), 4_000_000 + 2_500_000);
        // The user's profile takes precedence.
        let given = profile("[phone]\nexposure_us = 6000\nreadout_us = 12000\n");
        assert_eq!(middle(&row, Some(&given)), 3_000_000 + 6_000_000);
    }
}
