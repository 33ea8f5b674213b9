//! The rig profile that the owner of a simulated rig would have: the constants
//! that are measured once on a real rig, taken from the models here, and nothing
//! that a session finds out by itself (clocks, frame period, phase).

use anyhow::{Context, Result};

use crate::depth_camera::DepthCameraConfig;
use crate::phone::Handset;
use crate::rig_config::RigConfig;

/// The profile as TOML, for `smartdepthsync record --profile`; the trigger is aligned to the
/// first phone.
///
/// # Errors
///
/// The rig has no depth camera, or there is no phone.
pub fn owner_profile(config: &RigConfig, phones: &[Handset<'_>]) -> Result<String> {
    const NO_CAMERA: &str = "the rig has no depth camera, so it has no profile";
    let (first, others) = phones.split_first().context("the rig has no phone")?;
    let center = config.center_offset_us().context(NO_CAMERA)?;
    let mut text = format!(
        "# Constants of a simulated rig, as its owner would have measured them.\n\
         name = \"simulated rig, seed {seed}\"\n\n\
         [phone]\n{phone}\n\
         [depth]\nfps = {fps}\ncenter_offset_us = {center:.4}\ncenter_offset_sigma_us = 0.1\n",
        seed = config.seed.0,
        phone = constants(first),
        fps = DepthCameraConfig::FPS,
    );
    for phone in others {
        text += &format!("\n[[phones]]\n{}", constants(phone));
    }
    Ok(text)
}

/// The profile of a running rig: of its phones by their names, or of the first without one
/// where there are no names.
pub(crate) fn owner_profile_of<'a>(
    config: &RigConfig,
    phones: impl Iterator<Item = Handset<'a>>,
    names: &'a [&str],
) -> Result<String> {
    let phones: Vec<Handset<'_>> = match names {
        [] => phones.take(1).collect(),
        _ => phones
            .zip(names)
            .map(|(phone, name)| Handset {
                name: Some(name),
                ..phone
            })
            .collect(),
    };
    owner_profile(config, &phones)
}

/// Lines of a phone's table.
fn constants(phone: &Handset<'_>) -> String {
    let config = phone.config;
    let camera = &config.camera;
    let name = phone.name.map(|name| format!("name = \"{name}\"\n"));
    format!(
        "{name}address = \"{address}\"\nrows = {rows}\nreadout_us = {readout:.4}\n\
         exposure_locked = {locked}\nreadout_sigma_us = 0.0\ngyro_delay_us = {delay}\ngyro_delay_sigma_us = 0.0\n",
        name = name.unwrap_or_default(),
        address = phone.address,
        rows = camera.rows,
        locked = camera.is_exposure_locked(),
        readout = camera.readout_ns() * 1e-3,
        delay = config.gyroscope.low_pass.delay_s * 1e6,
    )
}
