//! What is shown of the phone's clock while it is followed.

use serde::Serialize;

/// State of the lock on the phone's clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Tracked {
    /// By how much the trigger is late on the phone's frames, µs.
    pub(crate) phase_us: f64,
    /// 1-sigma of it, µs.
    pub(crate) sigma_us: f64,
    /// Temperature of the phone's battery, °C.
    pub(crate) temperature: Option<f64>,
    /// Whether both clocks are heard.
    pub(crate) holds: bool,
}

impl Tracked {
    /// Whether the lock holds, and the phone's temperature.
    pub(crate) fn text(&self) -> String {
        let lock = if self.holds { "locked" } else { "LOCK LOST" };
        let celsius = self.temperature;
        celsius.map_or(lock.to_owned(), |celsius| {
            format!("{lock}, phone {celsius:.1} °C")
        })
    }
}
