//! RealSense D400 series (D435, D455 and kin): stereo with a global shutter. Its maker no
//! longer supports an external trigger; what is here is from users.
//!
//! Its clock runs at 1 MHz; the stamp is taken when the frame's transfer begins
//! (librealsense #15188).

use super::{Basis, Center, Input, Mode, Model, Pulse, Recording, Trap};

const BEGIN: Mode = Mode {
    name: "848x480",
    rates: &[30, 15, 5],
    center: Center::Begins(790.0),
    sigma_us: 50.0,
    basis: Basis::Measured,
    source: "librealsense #9220: light against trigger of one D435; spread not given, 50 µs assumed",
};

pub(super) const MODEL: Model = Model {
    id: "realsense-d400",
    name: "RealSense D400 series",
    sync_mode: "inter_cam_sync_mode 4 (genlock), depth only",
    pulse: Pulse {
        // Maker's white paper on multiple cameras: 100 µs, 1.8 V; pin 5 signal, pin 9
        // ground.
        width_us: 110.0,
        shortest_us: 100.0,
        input: Input::V1p8,
    },
    rates: &[30, 15, 5],
    own_rate: "twice the pulses or more (60 for 30): the camera waits for each",
    recording: Recording::Ros2Bag,
    modes: &[
        BEGIN,
        Mode {
            name: "1280x720",
            rates: &[15, 5],
            center: Center::Begins(880.0),
            ..BEGIN
        },
    ],
    traps: &[
        Trap {
            text: "the maintainers no longer support genlock: try it before you build on it",
            source: "librealsense #15119",
        },
        Trap {
            text: "a frame may come out with the pulse that follows, and after hours a frame later until the \
                   camera is unplugged: look at both pictures of something that moves",
            source: "librealsense #9528, #12877",
        },
        Trap {
            text: "D455 and D435iF with firmware 5.16.0.1 do not follow pulses",
            source: "realsense-ros #3360",
        },
        Trap {
            text: "switch auto-exposure off: the middle of exposure moves by half of each change",
            source: "follows from the exposure's begin",
        },
        Trap {
            text: "set global_time_enabled to false, or the stamps are the computer's estimate",
            source: "realsense2_camera, README",
        },
    ],
};
