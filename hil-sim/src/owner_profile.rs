//! The rig profile that the owner of a simulated rig would have: the constants
//! that are measured once on a real rig, taken from the models here, and nothing
//! that a session finds out by itself (clocks, frame period, phase).

use anyhow::{Context, Result};

use crate::phone::SimPhone;
use crate::rig_config::RigConfig;

/// The profile as TOML, for `smartdepthsync record --profile`.
///
/// # Errors
///
/// The rig has no depth camera.
pub fn owner_profile(config: &RigConfig, phone: &SimPhone) -> Result<String> {
    let depth = config
        .depth_camera
        .context("the rig has no depth camera, so it has no profile")?;
    let center_ns =
        depth.flash_delay.as_nanos() as f64 + depth.mode.flashes().center_offset_ns() as f64;
    let of_phone = phone.config();
    let camera = &of_phone.camera;
    Ok(format!(
        "# Constants of a simulated rig, as its owner would have measured them.\n\
         name = \"simulated rig, seed {seed}\"\n\n\
         [phone]\naddress = \"{address}\"\nrows = {rows}\nreadout_us = {readout:.4}\n\
         gyro_delay_us = {delay}\n\n\
         [depth]\nfps = {fps}\ncenter_offset_us = {center}\ncenter_offset_sigma_us = 0.1\n",
        seed = config.seed.0,
        address = phone.address(),
        rows = camera.rows,
        readout = camera.readout_ns() * 1e-3,
        delay = of_phone.gyroscope.low_pass.delay_s * 1e6,
        fps = depth.fps,
        center = center_ns * 1e-3,
    ))
}
