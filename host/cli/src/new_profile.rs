//! The text of a new rig profile: the commented default with a depth camera's constants.

use toml_edit::{Array, DocumentMut, Item, value};

use crate::outcome::{ExitStatus, Failure};
use recording::camera::{Basis, Mode, Model};
use recording::profile::edit;
use recording::profile::{DEFAULT, Profile};

/// Default exposure of a camera whose exposure is set, µs.
const USUAL_EXPOSURE_US: f64 = 8_000.0;

/// The depth camera of a rig.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    pub(crate) model: &'static Model,
    pub(crate) mode: &'static Mode,
    /// Pulses a second.
    pub(crate) fps: u32,
    /// Its exposure, µs, where that is set.
    pub(crate) exposure_us: Option<f64>,
}

impl Camera {
    /// A model in its default mode, as fast as it goes there.
    pub(crate) fn new(model: &'static Model, mode: Option<&'static Mode>) -> Self {
        let mode = mode.unwrap_or(&model.default_mode);
        Self {
            model,
            mode,
            fps: mode.rates.iter().copied().max().unwrap_or(30),
            exposure_us: None,
        }
    }

    /// Returns the comment with the camera's properties, for the lines before its table.
    fn comment(&self) -> String {
        let Self { model, mode, .. } = self;
        let mut text = format!(
            "\n# {}: setting {}; pulses go to it through: {}.\n# Its own frame rate: {}.\n",
            model.name, model.sync_mode, model.pulse.through, model.own_rate
        );
        text += &format!(
            "# Middle of exposure {}: {}.\n",
            mode.basis.word(),
            mode.source
        );
        if mode.follows_exposure() {
            let given = match self.exposure_us {
                Some(exposure) => format!("{exposure} µs"),
                None => format!("{USUAL_EXPOSURE_US} µs, assumed"),
            };
            text += &format!(
                "# It follows the exposure (here {given}): fix it in the camera, then\n\
                 # `smartdepthsync setup --overwrite --exposure 8ms` with that exposure.\n"
            );
        }
        text
    }

    /// 1-sigma of the middle of exposure, µs: the model's, and with an exposure that is only
    /// assumed half of that too.
    fn sigma_us(&self) -> f64 {
        match (self.mode.follows_exposure(), self.exposure_us) {
            (true, None) => self.mode.sigma_us.hypot(0.5 * USUAL_EXPOSURE_US),
            _ => self.mode.sigma_us,
        }
    }
}

/// The default profile with this camera; what else is `set` is a path of keys and a value.
///
/// # Errors
///
/// Only by an error of the program.
pub(crate) fn text(camera: &Camera, set: &[(&[&str], Item)]) -> Result<String, Failure> {
    let broken = |error: String| {
        Failure::new(ExitStatus::Error, format!("the default profile: {error}"))
            .next_step("report this: it is an error of the program")
    };
    let mut document: DocumentMut = DEFAULT
        .parse()
        .map_err(|error: toml_edit::TomlError| broken(error.to_string()))?;
    let Camera { model, mode, .. } = camera;
    let exposure = camera.exposure_us.unwrap_or(USUAL_EXPOSURE_US);
    let own: [(&[&str], Item); 6] = [
        (&["depth", "camera"], value(&model.id)),
        (&["depth", "mode"], value(&mode.name)),
        (&["depth", "fps"], value(i64::from(camera.fps))),
        (
            &["depth", "center_offset_us"],
            value(mode.center_us(camera.fps, exposure)),
        ),
        (
            &["depth", "center_offset_sigma_us"],
            value(camera.sigma_us()),
        ),
        (&["depth", "pulse_width_us"], value(model.pulse.width_us)),
    ];
    for (path, new) in own.iter().chain(set) {
        let missing = || broken(format!("it has no {}", path.join(".")));
        let (key, tables) = path.split_last().ok_or_else(missing)?;
        let table = tables
            .iter()
            .try_fold(document.as_table_mut(), |table, key| {
                table.get_mut(key)?.as_table_mut()
            });
        edit::set(table.ok_or_else(missing)?, key, new.clone());
    }
    if let Some(table) = document.get_mut("depth").and_then(Item::as_table_mut) {
        table.decor_mut().set_prefix(camera.comment());
    }
    let text = document.to_string();
    Profile::parse(&text, None)?;
    Ok(text)
}

/// Program and arguments; the camera's own recorder by itself gets those that it needs.
pub(crate) fn recorder_command(text: &str, model: &Model, mode: &Mode) -> Array {
    let words: Vec<&str> = text.split_whitespace().collect();
    let own = model.recorder.first();
    match words.as_slice() {
        ["none"] => Array::new(),
        [program] if own.is_some_and(|own| program.rsplit('/').next() == Some(own)) => {
            let arguments = model.recorder.iter().skip(1);
            let arguments = arguments.map(|word| word.replace("{mode}", &mode.name));
            std::iter::once((*program).to_owned())
                .chain(arguments)
                .collect()
        }
        _ => words.into_iter().collect(),
    }
}

/// Returns true if a profile has the middle of exposure that is assumed for its camera's model,
/// and no measured bias, which has the error of it.
pub(crate) fn is_assumed(model: &Model, profile: &Profile) -> bool {
    let depth = &profile.depth;
    let exposure = USUAL_EXPOSURE_US;
    profile.frame_sync.bias_measured.is_none()
        && model.mode(&depth.mode).is_some_and(|mode| {
            let assumed_us = mode.center_us(depth.fps, exposure);
            let is_models = mode.follows_exposure() || depth.center_offset_us == assumed_us;
            matches!(mode.basis, Basis::Assumed) && is_models
        })
}

/// Returns the source of a camera's middle of exposure, in a line.
pub(crate) fn summary(model: &Model, profile: &Profile) -> String {
    let depth = &profile.depth;
    let basis = if is_assumed(model, profile) {
        ", assumed for this model"
    } else {
        ""
    };
    format!(
        "{}, {}: pulses of {} µs through: {}; middle of exposure {} ± {} µs after the edge{basis}",
        model.name,
        depth.mode,
        depth.pulse_width_us,
        model.pulse.through,
        depth.center_offset_us,
        depth.center_offset_sigma_us,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_profile_of_each_model_fits_its_camera_and_says_why() {
        for model in Model::all() {
            for mode in model.modes() {
                let camera = Camera::new(model, Some(mode));
                let recorder = recorder_command(&model.recorder[0], model, mode);
                let key: &[&str] = &["depth", "recorder", "command"];
                let text = text(&camera, &[(key, value(recorder))]).unwrap();
                let profile = Profile::parse(&text, None).unwrap();
                assert_eq!(profile.depth.camera, model.id);
                assert_eq!(profile.objections(model), [], "{text}");
                assert!(text.contains(&mode.source));
                assert!(text.contains("# From the trigger's edge"), "comments stay");
                assert!(profile.depth.recorder.command.len() > 4);
            }
        }
    }

    #[test]
    fn an_exposure_that_is_given_moves_the_middle_and_one_that_is_not_is_unsure() {
        let model = Model::find("realsense-d400").unwrap();
        let mut camera = Camera::new(model, None);
        let parsed = |camera: &Camera| Profile::parse(&text(camera, &[]).unwrap(), None).unwrap();
        assert!(parsed(&camera).depth.center_offset_sigma_us > 4_000.0);
        camera.exposure_us = Some(5_000.0);
        let depth = parsed(&camera).depth;
        assert_eq!(depth.center_offset_us, 3_290.0);
        assert_eq!(depth.center_offset_sigma_us, 50.0);
    }
}
