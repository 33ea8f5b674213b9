//! What the values of a profile may be.
//!
//! The first that is wrong is told, in the order of the checks here.

use std::ops::RangeInclusive;

use protocol::{AccelRange, GyroRange, ImuConfig, LowPass};

use crate::camera::Model;

use super::{Depth, Learnt, Lidar, Phone, Profile, ProfileError, TriggerOutput};

/// A key, its value, what it may be at least and at most, and the unit.
type Row = (&'static str, f64, RangeInclusive<f64>, &'static str);

/// For spans of time in µs.
const SPAN: RangeInclusive<f64> = 0.0..=1e6;

/// For differences of times in µs.
const SIGNED: RangeInclusive<f64> = -1e6..=1e6;

pub(super) fn check(profile: &Profile) -> Result<(), ProfileError> {
    check_outputs(&profile.outputs)?;
    if let Some(lidar) = &profile.lidar {
        check_lidar(lidar, &profile.outputs)?;
    }
    check_phones(profile)?;
    check_depth(&profile.depth)?;
    let (align, sync) = (&profile.align, &profile.frame_sync);
    within(&[
        ("align.slew_us", align.slew_us, 0.0..=16_000.0, "µs"),
        (
            "align.max_offset_sigma_us",
            align.max_offset_sigma_us,
            1.0..=10_000.0,
            "µs",
        ),
        ("frame_sync.bias_us", sync.bias_us, SIGNED, "µs"),
        ("frame_sync.bias_sigma_us", sync.bias_sigma_us, SPAN, "µs"),
    ])?;
    profile.imu_config().map(drop)
}

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
        within(&[
            (
                "outputs.every",
                f64::from(sensor.every),
                1.0..=30.0,
                "pulses",
            ),
            ("outputs.delay_us", sensor.delay_us, SPAN, "µs"),
            ("outputs.width_us", sensor.width_us, 50.0..=1e6, "µs"),
        ])?;
    }
    Ok(())
}

fn check_lidar(lidar: &Lidar, outputs: &[TriggerOutput]) -> Result<(), ProfileError> {
    check_sensor_name("lidar.name", &lidar.name, outputs)?;
    let baud = lidar.baud.to_string();
    if board::gnss::parse_baud(&baud).is_err() {
        let expected = "4800, 9600, 19200, 38400, 57600 or 115200 (Bd)";
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
    within(&[
        ("phone.exposure_us", phone.exposure_us, SPAN, "µs"),
        ("phone.readout_us", phone.readout_us, SPAN, "µs"),
        ("phone.rows", f64::from(phone.rows), 2.0..=1e5, ""),
    ])?;
    if let Some(row) = phone.middle_row
        && !(0.0..=f64::from(phone.rows - 1)).contains(&row)
    {
        return Err(wrong(
            "phone.middle_row",
            row.to_string(),
            "0 to the last row",
        ));
    }
    within(&[
        ("phone.gyro_delay_us", phone.gyro_delay_us, SPAN, "µs"),
        (
            "phone.gyro_delay_sigma_us",
            phone.gyro_delay_sigma_us,
            SPAN,
            "µs",
        ),
        ("phone.twist_s", f64::from(phone.twist_s), 3.0..=60.0, "s"),
    ])?;
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
    let (skew, sigma) = (learnt.skew.unwrap_or(0.0), learnt.skew_sigma.unwrap_or(0.0));
    within(&[
        (
            "phone.learnt.frame_period_ns",
            learnt.frame_period_ns,
            1e6..=1e9,
            "ns",
        ),
        (
            "phone.learnt.frame_period_sigma_ns",
            learnt.frame_period_sigma_ns,
            0.0..=1e6,
            "ns",
        ),
        (
            "phone.learnt.frame_jitter_ns",
            learnt.frame_jitter_ns.unwrap_or(0.0),
            0.0..=1e7,
            "ns",
        ),
        (
            "phone.learnt.exposure_us",
            learnt.exposure_us.unwrap_or(0.0),
            SPAN,
            "µs",
        ),
        ("phone.learnt.skew", skew, -1e-3..=1e-3, ""),
        ("phone.learnt.skew_sigma", sigma, 0.0..=1e-3, ""),
    ])
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
    within(&[
        (
            "depth.center_offset_us",
            depth.center_offset_us,
            SIGNED,
            "µs",
        ),
        (
            "depth.center_offset_sigma_us",
            depth.center_offset_sigma_us,
            SPAN,
            "µs",
        ),
        (
            "depth.pulse_width_us",
            depth.pulse_width_us,
            8.0..=10_000.0,
            "µs",
        ),
    ])
}

impl Profile {
    /// Settings of the board's IMU.
    ///
    /// # Errors
    ///
    /// The sensor has no such setting.
    pub fn imu_config(&self) -> Result<ImuConfig, ProfileError> {
        let imu = &self.imu;
        let divider = Some(imu.rate_hz)
            .filter(|&rate| rate > 0 && 1_000 % rate == 0)
            .and_then(|rate| u8::try_from(1_000 / rate - 1).ok())
            .ok_or_else(|| {
                let expected = "1000 divided by a whole number up to 256";
                wrong("imu.rate_hz", imu.rate_hz.to_string(), expected)
            })?;
        let low_pass = match imu.low_pass_hz {
            188 => Ok(LowPass::Hz188),
            98 => Ok(LowPass::Hz98),
            42 => Ok(LowPass::Hz42),
            20 => Ok(LowPass::Hz20),
            10 => Ok(LowPass::Hz10),
            5 => Ok(LowPass::Hz5),
            other => Err(wrong(
                "imu.low_pass_hz",
                other.to_string(),
                "188, 98, 42, 20, 10 or 5",
            )),
        }?;
        let gyro_range = match imu.gyro_range_dps {
            250 => Ok(GyroRange::Dps250),
            500 => Ok(GyroRange::Dps500),
            1_000 => Ok(GyroRange::Dps1000),
            2_000 => Ok(GyroRange::Dps2000),
            other => Err(wrong(
                "imu.gyro_range_dps",
                other.to_string(),
                "250, 500, 1000 or 2000",
            )),
        }?;
        let accel_range = match imu.accel_range_g {
            2 => Ok(AccelRange::G2),
            4 => Ok(AccelRange::G4),
            8 => Ok(AccelRange::G8),
            16 => Ok(AccelRange::G16),
            other => Err(wrong(
                "imu.accel_range_g",
                other.to_string(),
                "2, 4, 8 or 16",
            )),
        }?;
        Ok(ImuConfig {
            divider,
            low_pass,
            gyro_range,
            accel_range,
        })
    }
}

/// Refuses the first value that is out of its bounds.
pub(super) fn within(rows: &[Row]) -> Result<(), ProfileError> {
    for (key, value, bounds, unit) in rows {
        if !bounds.contains(value) {
            let unit = match *unit {
                "" => String::new(),
                unit => format!(" ({unit})"),
            };
            let expected = format!("{} to {}{unit}", bounds.start(), bounds.end());
            return Err(wrong(key, value.to_string(), expected));
        }
    }
    Ok(())
}

pub(super) fn wrong(key: &'static str, found: String, expected: impl Into<String>) -> ProfileError {
    ProfileError::Value {
        path: None,
        line: None,
        key,
        found,
        expected: expected.into(),
    }
}
