//! Models of depth cameras: the trigger pulse that a camera follows, and the time from its edge
//! to the middle of exposure, as the maker states or somebody has measured them.
//!
//! Each model is a file in `cameras/`, with its sources. A value that nobody has published is
//! marked as an assumption; its 1-sigma covers its error until
//! `smartdepthsync evaluate precision --calibrate` has measured the rest.

use std::sync::LazyLock;

use serde::Deserialize;

use crate::strobes::StrobeTrain;

/// Word in a profile for the camera of the published rig.
pub const DEFAULT_CAMERA: &str = "azure-kinect-dk";

/// Files of the models, the published rig's first.
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
    /// Word for the model in profiles and options.
    pub id: String,
    /// Name given by its maker.
    pub name: String,
    /// Maker's name of the setting in which it follows the trigger.
    pub sync_mode: String,
    /// The pulse that it follows.
    pub pulse: TriggerPulse,
    /// Rates of the trigger that it accepts beside a phone at 30 frames a second, pulses per
    /// second.
    pub rates: Vec<u32>,
    /// Setting of its own frame rate for a rate of the trigger, in words.
    pub own_rate: String,
    /// Program that records it, with arguments; `{mode}` is replaced by the mode, `{fps}` and
    /// `{folder}` as in a profile.
    pub recorder: Vec<String>,
    /// Depth mode unless another one is chosen.
    pub default_mode: Mode,
    /// Its other depth modes.
    pub other_modes: Vec<Mode>,
}

/// A trigger pulse; all of them are active high, and the rising edge counts.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriggerPulse {
    /// Length that a new profile gets, µs.
    pub width_us: f64,
    /// Shortest length that the maker allows, µs.
    pub shortest_us: f64,
    /// Circuit between a pin of 3 V and the camera's input, in words.
    pub through: String,
}

/// A depth mode.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// Name in the camera's own programs.
    pub name: String,
    /// Rates of the trigger in this mode, pulses per second; a part of the model's.
    pub rates: Vec<u32>,
    /// Time from the edge to the middle of exposure.
    pub center: Center,
    /// Infrared flashes of one exposure; none of a camera whose emitter is on, if it has one.
    pub train: Option<StrobeTrain>,
    /// 1-sigma of that time, µs.
    pub sigma_us: f64,
    /// Origin of that time.
    pub basis: Basis,
    /// Document or measurement that states it.
    pub source: String,
}

/// Time from the rising edge to the middle of exposure.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Center {
    /// A constant, µs.
    #[serde(rename = "fixed_us")]
    Fixed(f64),
    /// The exposure begins this long after the edge, µs.
    #[serde(rename = "begins_us")]
    Begins(f64),
    /// The exposure ends when the next pulse comes.
    EndsAtNext,
}

/// Origin of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// Stated by the maker.
    Maker,
    /// Measured by somebody.
    Measured,
    /// Assumed: nobody has published it.
    Assumed,
}

impl Basis {
    /// Returns the origin in a few words.
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
    /// Returns all models, the published rig's first.
    #[must_use]
    pub fn all() -> &'static [Self] {
        // Each file can be read: a test does.
        static ALL: LazyLock<Vec<Model>> =
            LazyLock::new(|| FILES.into_iter().flat_map(toml::from_str).collect());
        &ALL
    }

    /// Returns the model with that word.
    #[must_use]
    pub fn find(id: &str) -> Option<&'static Self> {
        Self::all().iter().find(|model| model.id == id)
    }

    /// Returns the words of all models, separated by commas.
    #[must_use]
    pub fn ids() -> String {
        let ids: Vec<&str> = Self::all().iter().map(|model| model.id.as_str()).collect();
        ids.join(", ")
    }

    /// Iterates over the modes, the default first.
    pub fn modes(&self) -> impl Iterator<Item = &Mode> {
        std::iter::once(&self.default_mode).chain(&self.other_modes)
    }

    /// Returns the mode with that name, whatever its case.
    #[must_use]
    pub fn mode(&self, name: &str) -> Option<&Mode> {
        self.modes()
            .find(|mode| mode.name.eq_ignore_ascii_case(name))
    }

    /// Returns the names of the modes, separated by commas.
    #[must_use]
    pub fn mode_names(&self) -> String {
        let names: Vec<&str> = self.modes().map(|mode| mode.name.as_str()).collect();
        names.join(", ")
    }
}

impl Mode {
    /// Returns the time from the rising edge to the middle of exposure, µs, for `rate` pulses
    /// per second and an exposure of `exposure_us`. Neither changes a fixed one.
    #[must_use]
    pub fn center_us(&self, rate: u32, exposure_us: f64) -> f64 {
        match self.center {
            Center::Fixed(center) => center,
            Center::Begins(delay) => delay + 0.5 * exposure_us,
            Center::EndsAtNext => 1e6 / f64::from(rate) - 0.5 * exposure_us,
        }
    }

    /// Returns true if that time depends on the exposure.
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
