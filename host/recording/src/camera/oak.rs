//! Luxonis OAK with global-shutter sensors (OV9282, OV9782), frame sync as input.
//!
//! Its clock runs at 1 MHz; the stamp is the begin of the read-out (maker's timing drawing).

use super::{Basis, Center, Input, Mode, Model, Pulse, Recording, Trap};

const ENDS: Mode = Mode {
    name: "800P",
    rates: &[30, 15, 10, 5],
    center: Center::EndsAtNext,
    sigma_us: 1_000.0,
    basis: Basis::Assumed,
    source: "maker's timing drawing: a frame is exposed before the read-out that the next pulse begins; no \
             delays are given",
};

pub(super) const MODEL: Model = Model {
    id: "oak",
    name: "Luxonis OAK (global shutter)",
    sync_mode: "setFrameSyncMode(INPUT)",
    pulse: Pulse {
        // Maker's page on frame sync: 1.8 V at the sensor, 12 to 24 V at the M8 connector
        // (S2, Pro PoE); a shortest length is not given.
        width_us: 110.0,
        shortest_us: 100.0,
        input: Input::Isolated,
    },
    rates: &[30, 15, 10, 5],
    own_rate: "the same",
    recording: Recording::Ros2Bag,
    modes: &[
        ENDS,
        Mode {
            name: "400P",
            ..ENDS
        },
    ],
    traps: &[
        Trap {
            text: "ToF and OAK4 models take 5 V at their M8 connector, not 12 V; bare modules 1.8 V",
            source: "maker's page on frame sync",
        },
        Trap {
            text: "without pulses within a second of the start older firmware crashes: depthai 2.23 or newer",
            source: "depthai forum, d/2303",
        },
        Trap {
            text: "switch auto-exposure off: the middle of exposure moves by half of each change",
            source: "follows from the timing drawing",
        },
    ],
};
