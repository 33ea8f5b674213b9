//! Checks the values of a profile. The first wrong value is reported, in the order of the checks
//! here.

use std::ops::RangeInclusive;

use board::imu::{ACCEL_RANGES, GYRO_RANGES, LOW_PASSES};
use protocol::ImuConfig;

use crate::camera::Model;

use super::error::shortened;
use super::{Depth, Learnt, Lidar, Phone, Profile, ProfileError, TriggerOutput};

/// Key of a table, its value, the accepted range, and the unit.
type Row = (&'static str, f64, RangeInclusive<f64>, &'static str);

/// Accepted spans of time, µs.
const SPAN: RangeInclusive<f64> = 0.0..=1e6;

/// Accepted differences of times, µs.
const SIGNED: RangeInclusive<f64> = -1e6..=1e6;

fn check_outputs(outputs: &[TriggerOutput]) -> Result<(), ProfileError> {
    for (index, sensor) in outputs.iter().enumerate() {
        if !(2..=4).contains(&sensor.output) {
            return Err(wrong(
                "outputs.output",
                sensor.output.to_string(),
                "2, 3 or 4",
            ));
        }
        let earlier = outputs.get(..index).unwrap_or_default();
        if earlier.iter().any(|other| other.output == sensor.output) {
            let found = format!("{} twice", sensor.output);
            return Err(wrong("outputs.output", found, "each output once"));
        }
        check_sensor_name("outputs.name", &sensor.name, earlier)?;
        within(
            "outputs",
            &[
                ("every", f64::from(sensor.every), 1.0..=30.0, "pulses"),
                ("delay_us", sensor.delay_us, SPAN, "µs"),
                ("width_us", sensor.width_us, 50.0..=1e6, "µs"),
            ],
        )?;
    }
    Ok(())
}

fn check_lidar(lidar: &Lidar, outputs: &[TriggerOutput]) -> Result<(), ProfileError> {
    check_sensor_name("lidar.name", &lidar.name, outputs)?;
    let baud = lidar.baud.to_string();
    if board::gnss::parse_baud(&baud).is_err() {
        let expected = "9600 or 115200 (Bd)";
        return Err(wrong("lidar.baud", baud, expected));
    }
    Ok(())
}

fn check_sensor_name(
    key: &'static str,
    name: &str,
    others: &[TriggerOutput],
) -> Result<(), ProfileError> {
    if name.trim().is_empty() || others.iter().any(|other| other.name == name) {
        let expected = "a name of its own for each sensor";
        return Err(wrong(key, format!("{name:?}"), expected));
    }
    Ok(())
}

fn check_phones(profile: &Profile) -> Result<(), ProfileError> {
    for (index, phone) in profile.all_phones().enumerate() {
        check_phone(phone)?;
        let mut earlier = profile.all_phones().take(index);
        if earlier.any(|other| other.name.eq_ignore_ascii_case(&phone.name)) {
            let found = format!("{:?} twice", phone.name);
            return Err(wrong(
                "phones.name",
                found,
                "a name of its own for each phone",
            ));
        }
    }
    Ok(())
}

fn check_phone(phone: &Phone) -> Result<(), ProfileError> {
    if crate::folder::check_name(&phone.name).is_err() || phone.name.contains('=') {
        return Err(wrong(
            "phone.name",
            format!("{:?}", phone.name),
            "a name that can be a folder's, without a slash or '='",
        ));
    }
    // The published rig's has none.
    if !phone.address.is_empty() && ::phone::client::check_address(&phone.address).is_err() {
        return Err(wrong(
            "phone.address",
            format!("{:?}", phone.address),
            "<host> or <host>:<port>, with a port of 1 to 65535",
        ));
    }
    within(
        "phone",
        &[
            ("exposure_us", phone.exposure_us, SPAN, "µs"),
            ("readout_us", phone.readout_us, SPAN, "µs"),
            ("readout_sigma_us", phone.readout_sigma_us, SPAN, "µs"),
            ("rows", f64::from(phone.rows), 2.0..=1e5, ""),
        ],
    )?;
    if let Some(row) = phone.middle_row
        && !(0.0..=f64::from(phone.rows - 1)).contains(&row)
    {
        return Err(wrong(
            "phone.middle_row",
            row.to_string(),
            "0 to the last row",
        ));
    }
    within(
        "phone",
        &[
            ("gyro_delay_us", phone.gyro_delay_us, SIGNED, "µs"),
            ("gyro_delay_sigma_us", phone.gyro_delay_sigma_us, SPAN, "µs"),
            (
                "measured.exposure_us",
                (phone.measured.as_ref()).map_or(0.0, |measured| measured.exposure_us),
                SPAN,
                "µs",
            ),
            ("twist_s", f64::from(phone.twist_s), 3.0..=60.0, "s"),
        ],
    )?;
    if let Some(pose) = &phone.from_imu {
        pose.check("phone.from_imu")?;
    }
    for (index, camera) in phone.cameras.iter().enumerate() {
        camera.check()?;
        let earlier = phone.cameras.iter().take(index);
        if earlier
            .into_iter()
            .any(|other| other.size() == camera.size())
        {
            let found = format!("{} × {} twice", camera.width, camera.height);
            return Err(wrong("phone.cameras", found, "each size of images once"));
        }
    }
    phone.learnt.as_ref().map_or(Ok(()), check_learnt)
}

fn check_learnt(learnt: &Learnt) -> Result<(), ProfileError> {
    let (period, sigma) = (learnt.frame_period_ns, learnt.frame_period_sigma_ns);
    let or_0 = |value: Option<f64>| value.unwrap_or(0.0);
    let jitter = or_0(learnt.frame_jitter_ns);
    within(
        "phone.learnt",
        &[
            ("frame_period_ns", period, 1e6..=1e9, "ns"),
            ("frame_period_sigma_ns", sigma, 0.0..=1e6, "ns"),
            ("frame_jitter_ns", jitter, 0.0..=1e7, "ns"),
            ("exposure_us", or_0(learnt.exposure_us), SPAN, "µs"),
            ("skew", or_0(learnt.skew), -1e-3..=1e-3, ""),
            ("skew_sigma", or_0(learnt.skew_sigma), 0.0..=1e-3, ""),
            (
                "board_temperature_c",
                or_0(learnt.board_temperature_c),
                -100.0..=200.0,
                "°C",
            ),
        ],
    )
}

fn check_depth(depth: &Depth) -> Result<(), ProfileError> {
    let Some(model) = depth.model() else {
        return Err(wrong(
            "depth.camera",
            format!("{:?}", depth.camera),
            format!("one of {}", Model::ids()),
        ));
    };
    if !model.rates.contains(&depth.fps) {
        let rates: Vec<String> = model.rates.iter().map(u32::to_string).collect();
        let expected = format!("{} for {}", rates.join(", "), model.name);
        return Err(wrong("depth.fps", depth.fps.to_string(), expected));
    }
    if let Some(pose) = &depth.color_from_imu {
        pose.check("depth.color_from_imu")?;
    }
    let (center, sigma) = (depth.center_offset_us, depth.center_offset_sigma_us);
    within(
        "depth",
        &[
            ("center_offset_us", center, SIGNED, "µs"),
            ("center_offset_sigma_us", sigma, SPAN, "µs"),
            ("pulse_width_us", depth.pulse_width_us, 8.0..=10_000.0, "µs"),
            (
                "color_exposure_us",
                depth.color_exposure_us.unwrap_or(0.0),
                SPAN,
                "µs",
            ),
        ],
    )
}

impl Profile {
    /// Checks that each value is within its accepted range.
    pub(crate) fn check(&self) -> Result<(), ProfileError> {
        check_outputs(&self.outputs)?;
        if let Some(lidar) = &self.lidar {
            check_lidar(lidar, &self.outputs)?;
        }
        check_phones(self)?;
        check_depth(&self.depth)?;
        let (align, sync) = (&self.align, &self.frame_sync);
        let sigma = align.max_offset_sigma_us;
        within(
            "align",
            &[
                ("slew_us", align.slew_us, 0.0..=16_000.0, "µs"),
                ("max_offset_sigma_us", sigma, 1.0..=10_000.0, "µs"),
            ],
        )?;
        within(
            "frame_sync",
            &[
                ("bias_us", sync.bias_us, SIGNED, "µs"),
                ("bias_sigma_us", sync.bias_sigma_us, SPAN, "µs"),
                ("shift_us", sync.shift_us, SIGNED, "µs"),
            ],
        )?;
        self.imu_config().map(drop)
    }

    /// Returns the settings of the board's IMU.
    ///
    /// # Errors
    ///
    /// Returns an error if the sensor has no such setting.
    pub fn imu_config(&self) -> Result<ImuConfig, ProfileError> {
        let imu = &self.imu;
        let divider = Some(imu.rate_hz)
            .filter(|&rate| rate > 0 && 1_000 % rate == 0)
            .and_then(|rate| u8::try_from(1_000 / rate - 1).ok())
            .ok_or_else(|| {
                let expected = "1000 divided by a whole number up to 256";
                wrong("imu.rate_hz", imu.rate_hz.to_string(), expected)
            })?;
        Ok(ImuConfig {
            divider,
            low_pass: setting("imu.low_pass_hz", imu.low_pass_hz, &LOW_PASSES)?,
            gyro_range: setting("imu.gyro_range_dps", imu.gyro_range_dps, &GYRO_RANGES)?,
            accel_range: setting("imu.accel_range_g", imu.accel_range_g, &ACCEL_RANGES)?,
        })
    }
}

/// Returns the sensor's setting for a number in a profile.
fn setting<T: Copy>(key: &str, number: u32, settings: &[(u32, T)]) -> Result<T, ProfileError> {
    let setting = board::imu::setting(number, settings);
    setting.map_err(|expected| wrong(key, number.to_string(), expected))
}

/// Refuses the first value of a table that is out of its range.
pub(super) fn within(table: &str, rows: &[Row]) -> Result<(), ProfileError> {
    for (key, value, bounds, unit) in rows {
        if !bounds.contains(value) {
            let unit = match *unit {
                "" => String::new(),
                unit => format!(" ({unit})"),
            };
            let expected = format!("{} to {}{unit}", bounds.start(), bounds.end());
            return Err(wrong(format!("{table}.{key}"), value.to_string(), expected));
        }
    }
    Ok(())
}

pub(super) fn wrong(
    key: impl Into<String>,
    found: String,
    expected: impl Into<String>,
) -> ProfileError {
    ProfileError::Value {
        path: None,
        line: None,
        key: key.into(),
        found: shortened(&found),
        expected: expected.into(),
    }
}
