//! Orbbec Gemini 330 family, USB: stereo with a global shutter.

use super::{Basis, Center, Input, Mode, Model, Pulse, Recording, Trap};

const BEGIN: Mode = Mode {
    name: "848x480",
    rates: &[30, 15, 10, 5],
    center: Center::Begins(0.0),
    sigma_us: 1_000.0,
    basis: Basis::Assumed,
    source: "the exposure begins with the edge; the delay is not published",
};

pub(super) const MODEL: Model = Model {
    id: "gemini-330",
    name: "Orbbec Gemini 330 family (USB)",
    sync_mode: "SECONDARY_SYNCED",
    pulse: Pulse {
        // Orbbec, Multi-Device-Synchronization-Example, docs/Gemini330Series.md: as the
        // Femto series; the 335Le takes 3.3 V.
        width_us: 110.0,
        shortest_us: 100.0,
        input: Input::V1p8,
    },
    rates: &[30, 15, 10, 5],
    own_rate: "the same; in HARDWARE_TRIGGERING more than the pulses times framesPerTrigger",
    recording: Recording::Ros2Bag,
    modes: &[
        BEGIN,
        Mode {
            name: "1280x800",
            ..BEGIN
        },
    ],
    traps: &[
        Trap {
            text: "the sync mode is gone after power-off: set it before each session",
            source: "docs/Gemini330Series.md",
        },
        Trap {
            text: "switch auto-exposure off: the middle of exposure moves by half of each change",
            source: "follows from the exposure's begin",
        },
        Trap {
            text: "on GMSL models the pulses may come at half of the frame rate at most",
            source: "docs/Gemini330Series.md",
        },
    ],
};
