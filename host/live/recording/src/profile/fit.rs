//! Compares a profile with the model of its depth camera.

use super::Profile;
use crate::camera::{Center, Mode, Model, TriggerPulse};

/// Distance, in sigmas, from which a profile's middle of exposure is taken for that of another
/// mode or camera. The published rig's hand-tuned constant was 8 sigmas of the Azure Kinect's
/// below the nominal one, and pulses do begin later than their edge.
const FAR_SIGMAS: f64 = 20.0;

/// A setting of a profile that does not fit the camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Objection {
    /// The setting, and the reason why it does not fit.
    pub found: String,
    /// Change that resolves it.
    pub next_step: String,
}

impl Profile {
    /// Returns the settings that do not fit a model of camera.
    #[must_use]
    pub fn objections(&self, model: &Model) -> Vec<Objection> {
        let depth = &self.depth;
        let mut objections = Vec::new();
        let mut object = |found: String, next_step: String| {
            objections.push(Objection { found, next_step });
        };
        let TriggerPulse {
            width_us,
            shortest_us,
            ..
        } = &model.pulse;
        if depth.pulse_width_us < *shortest_us {
            object(
                format!(
                    "pulses of {} µs, but {} needs {shortest_us} µs",
                    depth.pulse_width_us, model.name
                ),
                format!("set depth.pulse_width_us to {width_us}"),
            );
        }
        if self.align.slew_us == 0.0 {
            object(
                format!(
                    "the phase would jump, and {} may lose frames then",
                    model.name
                ),
                String::from("set align.slew_us to 100"),
            );
        }
        let recorder = &depth.recorder.command;
        let is_microsofts = recorder
            .first()
            .is_some_and(|program| program.ends_with("k4arecorder"));
        if is_microsofts
            && !recorder
                .iter()
                .any(|word| word == "sub" || word == "subordinate")
        {
            object(
                String::from("the recorder does not tell the camera to follow the trigger"),
                String::from("add \"--external-sync\", \"sub\" to command in [depth.recorder]"),
            );
        }
        let Some(mode) = model.mode(&depth.mode) else {
            object(
                format!("{} has no mode {:?}", model.name, depth.mode),
                format!("set depth.mode to one of {}", model.mode_names()),
            );
            return objections;
        };
        if !mode.rates.contains(&depth.fps) {
            let rates: Vec<String> = mode.rates.iter().map(u32::to_string).collect();
            object(
                format!(
                    "{} does not run at {} frames a second",
                    mode.name, depth.fps
                ),
                format!("set depth.fps to {}", rates.join(" or ")),
            );
        }
        if let Center::Fixed(center) = mode.center
            && depth.measured.is_none()
        {
            let given = depth.center_offset_us;
            let is_of = |other: &Mode| matches!(other.center, Center::Fixed(at) if at == given);
            let off = (given - center).abs();
            let is_far = off > FAR_SIGMAS * mode.sigma_us.hypot(depth.center_offset_sigma_us);
            // The train of pulses is known where the delay before it is not.
            if is_far || given != center && model.modes().any(is_of) {
                object(
                    format!(
                        "depth.center_offset_us is {given} µs, but the middle of exposure of {} comes {center} µs \
                         after the edge ({})",
                        mode.name,
                        mode.basis.word()
                    ),
                    String::from(
                        "take the model's, and measure what is left: `smartdepthsync record --shift 4ms \
                         --duration 1m` ends with the command",
                    ),
                );
            }
        }
        objections
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn objections(text: &str) -> Vec<String> {
        let profile = Profile::parse(text, None).unwrap();
        let objections = profile.objections(profile.depth.model().unwrap());
        objections
            .into_iter()
            .map(|objection| objection.found)
            .collect()
    }

    #[test]
    fn the_published_profile_fits_its_camera() {
        assert_eq!(objections(""), [""; 0]);
    }

    #[test]
    fn settings_that_do_not_fit_are_reported() {
        let found = objections(
            "[depth]\ncamera = \"femto-bolt\"\n[align]\nslew_us = 0\n\
             [depth.recorder]\ncommand = [\"/opt/k4arecorder\", \"depth.mkv\"]\n",
        );
        let [pulse, jump, recorder] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert!(
            pulse.contains("12 µs") && pulse.contains("needs 100 µs"),
            "{pulse}"
        );
        assert!(jump.contains("jump"), "{jump}");
        assert!(recorder.contains("follow the trigger"), "{recorder}");
        let found = objections("[depth]\nmode = \"WFOV_UNBINNED\"\n");
        let [rate, center] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert!(rate.contains("30 frames"), "{rate}");
        assert!(
            center.contains("6362.5") && center.contains("10122.5"),
            "{center}"
        );
        let found = objections("[depth]\ncamera = \"oak\"\npulse_width_us = 200\n");
        assert!(
            found.len() == 1 && found[0].contains("no mode"),
            "{found:?}"
        );
    }
}
