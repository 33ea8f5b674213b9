//! The rig profile that the owner of a simulated rig would have: the constants
//! that are measured once on a real rig, taken from the models here, and nothing
//! that a session finds out by itself (clocks, frame period, phase).

use anyhow::{Context, Result};

use crate::depth_camera::DepthCameraConfig;
use crate::phone::PhoneConfig;
use crate::whole_rig::config::RigConfig;

/// The profile as TOML, for `smartdepthsync record --profile`: of phones, each with its address,
/// by these names, or of the first one without a name where there are none. The trigger is
/// aligned to the first phone.
///
/// # Errors
///
/// The rig has no depth camera, or there is no phone.
pub(crate) fn owner_profile<'a>(
    config: &RigConfig,
    phones: impl Iterator<Item = (String, &'a PhoneConfig)>,
    names: &[&str],
) -> Result<String> {
    const NO_CAMERA: &str = "the rig has no depth camera, so it has no profile";
    let center = config.center_offset_us().context(NO_CAMERA)?;
    let names = match names {
        [] => vec![String::new()],
        _ => names
            .iter()
            .map(|name| format!("name = \"{name}\"\n"))
            .collect(),
    };
    let mut phones = names.into_iter().zip(phones).map(constants);
    let first = phones.next().context("the rig has no phone")?;
    let mut text = format!(
        "# Constants of a simulated rig, as its owner would have measured them.\n\
         name = \"simulated rig, seed {seed}\"\n\n\
         [phone]\n{first}\n\
         [depth]\nfps = {fps}\ncenter_offset_us = {center:.4}\ncenter_offset_sigma_us = 0.1\n",
        seed = config.seed.0,
        fps = DepthCameraConfig::FPS,
    );
    for phone in phones {
        text += &format!("\n[[phones]]\n{phone}");
    }
    Ok(text)
}

/// Lines of a phone's table.
fn constants((name, (address, config)): (String, (String, &PhoneConfig))) -> String {
    let camera = &config.camera;
    format!(
        "{name}address = \"{address}\"\nrows = {rows}\nreadout_us = {readout:.4}\n\
         exposure_locked = {locked}\nreadout_sigma_us = 0.0\ngyro_delay_us = {delay}\ngyro_delay_sigma_us = 0.0\n",
        rows = camera.rows,
        locked = camera.is_exposure_locked(),
        readout = camera.readout_ns() * 1e-3,
        delay = config.gyroscope.low_pass.delay_s * 1e6,
    )
}
