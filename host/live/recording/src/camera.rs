//! Models of depth cameras: what a maker says, or somebody has measured, of the pulse that
//! a camera follows and of the moment at which it then exposes.
//!
//! Each is a file of `cameras/`, with its sources. A value that nobody has published is an
//! assumption and says so; what is wrong with it stands in its 1-sigma until
//! `smartdepthsync evaluate precision --calibrate` has measured what is left of it.

use std::sync::LazyLock;

use serde::Deserialize;

use crate::profile::Profile;

/// A profile's middle of exposure is another mode's or camera's, if it is so many sigmas off.
/// The published rig's hand-tuned constant was 8 sigmas of the Azure Kinect's below the
/// nominal one, and pulses do begin later than their edge.
const FAR_SIGMAS: f64 = 20.0;

/// Word in a profile for the camera of the published rig.
pub const DEFAULT_CAMERA: &str = "azure-kinect-dk";

/// The models, the published rig's first.
const FILES: [&str; 6] = [
    include_str!("cameras/azure_kinect_dk.toml"),
    include_str!("cameras/femto_bolt.toml"),
    include_str!("cameras/femto_mega.toml"),
    include_str!("cameras/gemini_330.toml"),
    include_str!("cameras/realsense_d400.toml"),
    include_str!("cameras/oak.toml"),
];

/// A model of depth camera.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// Word in profiles and options.
    pub id: String,
    /// As its maker calls it.
    pub name: String,
    /// Setting in which it follows the trigger, as its maker calls it.
    pub sync_mode: String,
    /// The pulse that it follows.
    pub pulse: Pulse,
    /// Pulses a second that it can be given beside a phone at 30 frames a second.
    pub rates: Vec<u32>,
    /// Its own frame rate, by the pulses that it is given.
    pub own_rate: String,
    /// The program that records it, and its arguments; `{mode}`, and as in a profile `{fps}`
    /// and `{folder}`, are filled in.
    pub recorder: Vec<String>,
    /// The mode that it has unless another is chosen.
    pub default_mode: Mode,
    /// Its other depth modes.
    pub other_modes: Vec<Mode>,
}

/// A trigger pulse; all of them are active high, and the rising edge counts.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pulse {
    /// Length that the profile gets, µs.
    pub width_us: f64,
    /// Length that the maker asks for at least, µs.
    pub shortest_us: f64,
    /// Circuit between a pin of 3 V and the camera's input, in words.
    pub through: String,
}

/// A depth mode.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// As the camera's programs call it.
    pub name: String,
    /// Pulses a second in this mode, of the model's.
    pub rates: Vec<u32>,
    /// From the edge to the middle of exposure.
    pub center: Center,
    /// 1-sigma of it, µs.
    pub sigma_us: f64,
    /// How it is known.
    pub basis: Basis,
    /// Where from.
    pub source: String,
}

/// From the rising edge to the middle of exposure.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Center {
    /// Always the same, µs.
    #[serde(rename = "fixed_us")]
    Fixed(f64),
    /// The exposure begins so many µs after the edge.
    #[serde(rename = "begins_us")]
    Begins(f64),
    /// The exposure ends with the pulse that follows.
    EndsAtNext,
}

/// How a value is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// Its maker says so.
    Maker,
    /// Somebody has measured it.
    Measured,
    /// Nobody has published it.
    Assumed,
}

impl Basis {
    /// In a word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Maker => "maker's",
            Self::Measured => "measured by a user",
            Self::Assumed => "assumed",
        }
    }
}

impl Model {
    /// All models, the published rig's first.
    #[must_use]
    pub fn all() -> &'static [Self] {
        // Each file can be read: a test does.
        static ALL: LazyLock<Vec<Model>> =
            LazyLock::new(|| FILES.into_iter().flat_map(toml::from_str).collect());
        &ALL
    }

    /// The model of that word.
    #[must_use]
    pub fn find(id: &str) -> Option<&'static Self> {
        Self::all().iter().find(|model| model.id == id)
    }

    /// The words of all models, for messages.
    #[must_use]
    pub fn ids() -> String {
        let ids: Vec<&str> = Self::all().iter().map(|model| model.id.as_str()).collect();
        ids.join(", ")
    }

    /// Its modes, the default first.
    pub fn modes(&self) -> impl Iterator<Item = &Mode> {
        std::iter::once(&self.default_mode).chain(&self.other_modes)
    }

    /// Its mode of that name.
    #[must_use]
    pub fn mode(&self, name: &str) -> Option<&Mode> {
        self.modes()
            .find(|mode| mode.name.eq_ignore_ascii_case(name))
    }

    /// The names of its modes, for messages.
    #[must_use]
    pub fn mode_names(&self) -> String {
        let names: Vec<&str> = self.modes().map(|mode| mode.name.as_str()).collect();
        names.join(", ")
    }
}

/// Something of a profile that does not fit its camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Objection {
    /// What.
    pub found: String,
    /// What to do.
    pub next_step: String,
}

impl Model {
    /// What of a profile does not fit this camera, as far as a profile shows it.
    #[must_use]
    pub fn objections(&self, profile: &Profile) -> Vec<Objection> {
        let depth = &profile.depth;
        let mut objections = Vec::new();
        let mut object = |found: String, next_step: String| {
            objections.push(Objection { found, next_step });
        };
        let Pulse {
            width_us,
            shortest_us,
            ..
        } = &self.pulse;
        if depth.pulse_width_us < *shortest_us {
            object(
                format!(
                    "pulses of {} µs, but {} needs {shortest_us} µs",
                    depth.pulse_width_us, self.name
                ),
                format!("set depth.pulse_width_us to {width_us}"),
            );
        }
        if profile.align.slew_us == 0.0 {
            object(
                format!(
                    "the phase would jump, and {} may lose frames then",
                    self.name
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
        let Some(mode) = self.mode(&depth.mode) else {
            object(
                format!("{} has no mode {:?}", self.name, depth.mode),
                format!("set depth.mode to one of {}", self.mode_names()),
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
        if let Center::Fixed(center) = mode.center {
            let given = depth.center_offset_us;
            let is_of = |other: &Mode| matches!(other.center, Center::Fixed(at) if at == given);
            let off = (given - center).abs();
            let is_far = off > FAR_SIGMAS * mode.sigma_us.hypot(depth.center_offset_sigma_us);
            // The train of pulses is known where the delay before it is not.
            if is_far || given != center && self.modes().any(is_of) {
                object(
                    format!(
                        "depth.center_offset_us is {given} µs, but the middle of exposure of {} comes {center} µs \
                         after the edge ({})",
                        mode.name,
                        mode.basis.word()
                    ),
                    String::from(
                        "take the model's, and measure what is left with `smartdepthsync evaluate \
                         precision --calibrate`",
                    ),
                );
            }
        }
        objections
    }
}

impl Mode {
    /// From the rising edge to the middle of exposure, µs, at so many pulses a second and
    /// with an exposure of so many µs; a fixed one is what it is.
    #[must_use]
    pub fn center_us(&self, rate: u32, exposure_us: f64) -> f64 {
        match self.center {
            Center::Fixed(center) => center,
            Center::Begins(delay) => delay + 0.5 * exposure_us,
            Center::EndsAtNext => 1e6 / f64::from(rate) - 0.5 * exposure_us,
        }
    }

    /// Whether the exposure has a say in it.
    #[must_use]
    pub const fn follows_exposure(&self) -> bool {
        !matches!(self.center, Center::Fixed(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_exposure_by_hand() {
        let azure = Model::find(DEFAULT_CAMERA).unwrap();
        let wide = azure.mode("wfov_unbinned").unwrap();
        // Nine pulses of 125 µs, 2,515 µs from one to the next: half of 20.245 ms.
        assert_eq!(wide.center_us(15, 0.0), 10_122.5);
        let real_sense = Model::find("realsense-d400").unwrap();
        let mode = &real_sense.default_mode;
        // 790 µs to the begin, and half of 8 ms.
        assert_eq!(mode.center_us(30, 8_000.0), 4_790.0);
        // Ends when the next begins: 33.333 ms less half of 10 ms.
        let oak = &Model::find("oak").unwrap().default_mode;
        assert!((oak.center_us(30, 10_000.0) - 28_333.333).abs() < 0.001);
        assert!(oak.follows_exposure() && !wide.follows_exposure());
    }

    fn objections(text: &str) -> Vec<String> {
        let profile = Profile::parse(text, None).unwrap();
        let objections = profile.depth.model().unwrap().objections(&profile);
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
    fn what_does_not_fit_is_said() {
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

    #[test]
    fn every_model_can_be_used() {
        for file in FILES {
            let model: Model = toml::from_str(file).unwrap();
            assert_eq!(Model::find(&model.id), Some(&model));
            assert!(model.recorder.len() > 4, "{}", model.id);
            assert!(
                model.pulse.width_us > model.pulse.shortest_us,
                "{}",
                model.id
            );
            assert!(
                model.rates.iter().all(|rate| 30 % rate == 0),
                "{}",
                model.id
            );
            for mode in model.modes() {
                let is_rate = |rate: &u32| model.rates.contains(rate);
                assert!(
                    !mode.rates.is_empty() && mode.rates.iter().all(is_rate),
                    "{}",
                    mode.name
                );
                assert!(mode.sigma_us > 0.0, "{}: {}", model.id, mode.name);
            }
        }
    }
}
