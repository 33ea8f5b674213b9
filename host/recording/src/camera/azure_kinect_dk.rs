//! Azure Kinect DK. End of life; its SDK's issue 1971 names Orbbec as the successor.
//!
//! Its first frame comes on pulse 2 or 3. Its clock runs at 90 kHz, hundreds of ppm off
//! (SDK #1384), and older firmware sets it to zero at the first pulse (#1240).

use super::{Basis, Center, Input, Mode, Model, Pulse, Recording, Trap};

/// The modes of the sensor, which Femto cameras have too, with how well the middle of
/// exposure is known: half of the train of nine infrared pulses of 125 µs, 1,575 µs from one
/// to the next, and 2,515 µs in WFOV_UNBINNED.
pub(super) const fn modes(sigma_us: f64, basis: Basis, source: &'static str) -> [Mode; 4] {
    const FAST: &[u32] = &[30, 15, 5];
    const fn mode(
        name: &'static str,
        (rates, center_us): (&'static [u32], f64),
        (sigma_us, basis, source): (f64, Basis, &'static str),
    ) -> Mode {
        Mode {
            name,
            rates,
            center: Center::Fixed(center_us),
            sigma_us,
            basis,
            source,
        }
    }
    let known = (sigma_us, basis, source);
    [
        mode("NFOV_UNBINNED", (FAST, 6_362.5), known),
        mode("NFOV_2X2BINNED", (FAST, 6_362.5), known),
        mode("WFOV_2X2BINNED", (FAST, 6_362.5), known),
        mode("WFOV_UNBINNED", (&[15, 5], 10_122.5), known),
    ]
}

pub(super) const MODEL: Model = Model {
    id: "azure-kinect-dk",
    name: "Azure Kinect DK",
    sync_mode: "SUBORDINATE",
    pulse: Pulse {
        // Maker's page on external synchronisation: active high, longer than 8 µs, 5 V;
        // its threshold is 3.5 V (SDK #1844); its own pulses are 12 µs long (#1404).
        width_us: 12.0,
        shortest_us: 8.0,
        input: Input::V5,
    },
    rates: &[30, 15, 5],
    own_rate: "the same",
    recording: Recording::Mkv,
    modes: &MODES,
    traps: &[
        Trap {
            text: "a pin of 3 V is below the input's threshold of 3.5 V: use the 5 V buffer",
            source: "SDK #1844",
        },
        Trap {
            text: "start the camera before the trigger; it keeps streaming when the pulses stop, so \
                   frames do not prove that it follows",
            source: "SDK #1850",
        },
        Trap {
            text: "pulses that jitter or jump give black or purple frames: let the phase move in small \
                   steps (align.slew_us)",
            source: "SDK #1404, #1227",
        },
        Trap {
            text: "triggering may fail after the first run: unplug the camera's supply between runs if it does",
            source: "SDK #987",
        },
        Trap {
            text: "with colour on, depth is later by half of what the colour exposure is longer",
            source: "SDK #868",
        },
    ],
};

const MODES: [Mode; 4] = modes(
    100.0,
    Basis::Maker,
    "maker's table of multi-camera delays; the delay before the first pulse is not published",
);
