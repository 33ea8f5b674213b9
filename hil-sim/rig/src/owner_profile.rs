//! The rig profile that the owner of a simulated rig would have: the constants
//! that are measured once on a real rig, taken from the models here, and nothing
//! that a session finds out by itself (clocks, frame period, phase).

use anyhow::{Context, Result};

use crate::phone::PhoneConfig;
use crate::rig_config::RigConfig;

/// A phone as its owner knows it.
#[derive(Clone, Debug)]
pub struct Handset<'a> {
    /// Where it is reached.
    pub address: String,
    /// What it was made from.
    pub config: &'a PhoneConfig,
}

/// The profile as TOML, for `smartdepthsync record --profile`.
///
/// # Errors
///
/// The rig has no depth camera.
pub fn owner_profile(config: &RigConfig, phone: &Handset<'_>) -> Result<String> {
    const NO_CAMERA: &str = "the rig has no depth camera, so it has no profile";
    let depth = config.depth_camera.context(NO_CAMERA)?;
    let center = config.center_offset_us().context(NO_CAMERA)?;
    Ok(format!(
        "# Constants of a simulated rig, as its owner would have measured them.\n\
         name = \"simulated rig, seed {seed}\"\n\n\
         [phone]\n{phone}\n\
         [depth]\nfps = {fps}\ncenter_offset_us = {center:.4}\ncenter_offset_sigma_us = 0.1\n",
        seed = config.seed.0,
        phone = constants(phone),
        fps = depth.fps,
    ))
}

/// The same for several phones by name; the trigger is aligned to the first.
///
/// # Errors
///
/// The rig has no depth camera, or there is no phone.
pub(crate) fn owner_profile_of(
    config: &RigConfig,
    phones: &[(&str, Handset<'_>)],
) -> Result<String> {
    let ((name, first), others) = phones.split_first().context("the rig has no phone")?;
    let mut text = owner_profile(config, first)?;
    text = text.replace("[phone]\n", &format!("[phone]\nname = \"{name}\"\n"));
    for (name, phone) in others {
        let constants = constants(phone);
        text += &format!("\n[[phones]]\nname = \"{name}\"\n{constants}");
    }
    Ok(text)
}

/// What is in the table of a phone.
fn constants(phone: &Handset<'_>) -> String {
    let config = phone.config;
    let camera = &config.camera;
    format!(
        "address = \"{address}\"\nrows = {rows}\nreadout_us = {readout:.4}\n\
         gyro_delay_us = {delay}\n",
        address = phone.address,
        rows = camera.rows,
        readout = camera.readout_ns() * 1e-3,
        delay = config.gyroscope.low_pass.delay_s * 1e6,
    )
}
