//! Orbbec Femto Bolt and Femto Mega: the depth sensor of the Azure Kinect DK in another
//! housing, with another input.

use super::{Basis, Input, Mode, Model, Pulse, Recording, Trap, azure_kinect_dk};

const PULSE: Pulse = Pulse {
    // Orbbec, Multi-Device-Synchronization-Example, docs/FemtoSeries.md: a positive pulse
    // of 100 µs, 1.8 V CMOS, high impedance.
    width_us: 110.0,
    shortest_us: 100.0,
    input: Input::V1p8,
};

const MODES: [Mode; 4] = azure_kinect_dk::modes(
    2_000.0,
    Basis::Assumed,
    "the Azure Kinect's train of infrared pulses: the maker says that modes are the same, not when \
     they begin",
);

const RATE: Trap = Trap {
    text: "the pulses must come at the sensor's own rate, which may be 30.015 where it says 30: if frames \
           are lost, measure the rate without a trigger",
    source: "docs/FemtoSeries.md",
};

const FLASH: Trap = Trap {
    text: "the sync mode (SECONDARY) is written into the camera and stays after power-off: set it back for other uses",
    source: "docs/FemtoSeries.md",
};

const OFFSETS: Trap = Trap {
    text: "the recorder of the K4A wrapper writes other start offsets than Microsoft's: frames are matched by \
           time, so nothing is to be done",
    source: "OrbbecSDK-K4A-Wrapper #94",
};

pub(super) const BOLT: Model = Model {
    id: "femto-bolt",
    name: "Orbbec Femto Bolt",
    sync_mode: "SECONDARY (SUBORDINATE in the K4A wrapper)",
    pulse: PULSE,
    rates: &[30, 15, 5],
    own_rate: "the same",
    recording: Recording::Mkv,
    modes: &MODES,
    traps: &[
        RATE,
        FLASH,
        OFFSETS,
        Trap {
            text: "it has no software trigger: without pulses there are no frames",
            source: "docs/FemtoSeries.md",
        },
    ],
};

pub(super) const MEGA: Model = Model {
    id: "femto-mega",
    name: "Orbbec Femto Mega",
    traps: &[RATE, FLASH, OFFSETS],
    ..BOLT
};
