//! The simulated recordings of the tests and the bench, and what is demanded of each.

use super::{Grip, Motion, SENSOR_A, SENSOR_B, Sensor, TwistSpec};

/// A scenario with the error that is demanded of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scenario {
    /// Name.
    pub name: &'static str,
    /// The recordings.
    pub spec: TwistSpec,
    /// Largest rms error of the offset, µs; `None`: a refusal is demanded.
    pub rmse_us: Option<f64>,
    /// Whether error over sigma must be near one: the model of the noise holds.
    pub honest: bool,
    /// Part of the twists that must be accepted; of the rest the faults may be too many.
    pub accepted: f64,
}

impl Scenario {
    /// The same, but this part of the twists must be accepted.
    const fn mostly(mut self, accepted: f64) -> Self {
        self.accepted = accepted;
        self
    }

    /// The numerical floor, not noise, makes the sigma.
    const fn with_a_floor(mut self) -> Self {
        self.honest = false;
        self
    }
}

/// A phone as bad as they come: copies and displaced samples every 10, a swing of the
/// content of up to 30 µs, a sawtooth of the stamps.
const SEVERAL_FAULTS: Sensor = Sensor {
    faulty: true,
    faulty_next_s: -0.43e-3,
    swing_s: 30e-6,
    sawtooth_s: Some((57e-6, 1.3)),
    ..SENSOR_B
};

/// All scenarios of the tests and the bench.
#[must_use]
pub fn scenarios() -> Vec<Scenario> {
    let base = TwistSpec::default();
    let scenario = |name, spec, rmse_us: f64| Scenario {
        name,
        spec,
        rmse_us: Some(rmse_us),
        honest: true,
        accepted: 1.0,
    };
    let with_b = |b: Sensor| TwistSpec { b, ..base };
    let both = |rate: f64| TwistSpec {
        a: Sensor {
            rate_hz: rate,
            ..SENSOR_A
        },
        b: Sensor {
            rate_hz: rate * 1.0001,
            ..SENSOR_B
        },
        ..base
    };
    let refused = |name, spec| Scenario {
        name,
        spec,
        rmse_us: None,
        honest: false,
        accepted: 0.0,
    };
    let held = |name, grip| scenario(name, TwistSpec { grip, ..base }, 6.0);
    let silent = |s: Sensor| Sensor {
        noise: 0.0,
        lsb: 0.0,
        ..s
    };
    let jittered = |s: Sensor| Sensor {
        jitter_s: 20e-6,
        ..s
    };
    vec![
        scenario("base", base, 4.0),
        scenario(
            "jitter 20 µs",
            TwistSpec {
                a: jittered(SENSOR_A),
                b: jittered(SENSOR_B),
                ..base
            },
            4.0,
        ),
        scenario(
            "single axis",
            TwistSpec {
                motion: Motion::SingleAxis(2.0, 4.0),
                ..base
            },
            4.0,
        ),
        scenario(
            "sawtooth 57 µs",
            with_b(Sensor {
                sawtooth_s: Some((57e-6, 0.9)),
                ..SENSOR_B
            }),
            6.0,
        ),
        scenario(
            "filters 188 and 60 Hz",
            TwistSpec {
                a: Sensor {
                    filter_hz: Some(188.0),
                    ..SENSOR_A
                },
                b: Sensor {
                    filter_hz: Some(60.0),
                    ..SENSOR_B
                },
                ..base
            },
            6.0,
        ),
        scenario(
            "weak, 1.1 rad/s",
            TwistSpec {
                motion: Motion::Twist(1.1, 1.1),
                ..base
            },
            13.0,
        ),
        scenario(
            "clipped at 250 deg/s",
            TwistSpec {
                motion: Motion::Twist(5.0, 7.0),
                a: Sensor {
                    range: Some(250.0_f64.to_radians()),
                    ..SENSOR_A
                },
                ..base
            },
            4.0,
        ),
        scenario(
            "skew up to 115 ppm",
            TwistSpec {
                skew_ppm: 115.0,
                ..base
            },
            4.0,
        ),
        scenario("1 kHz", both(1000.0), 4.0),
        scenario("208 Hz", both(208.0), 6.0),
        scenario(
            "a at 1 kHz, b at 208 Hz",
            TwistSpec {
                a: Sensor {
                    rate_hz: 1000.0,
                    ..SENSOR_A
                },
                b: Sensor {
                    rate_hz: 208.0,
                    ..SENSOR_B
                },
                ..base
            },
            5.0,
        ),
        scenario(
            "gaps, 5 % lost",
            TwistSpec {
                a: Sensor {
                    lost: 0.05,
                    ..SENSOR_A
                },
                b: Sensor {
                    lost: 0.05,
                    ..SENSOR_B
                },
                ..base
            },
            6.0,
        ),
        scenario(
            "half overlap",
            TwistSpec {
                b_starts_s: 4.5,
                ..base
            },
            6.0,
        ),
        scenario(
            "60 s, moved for 7 s",
            TwistSpec {
                duration_s: 60.0,
                rest_s: 26.5,
                ..base
            },
            4.0,
        ),
        Scenario {
            honest: false,
            ..scenario(
                "faulty stream b",
                with_b(Sensor {
                    faulty: true,
                    sawtooth_s: Some((57e-6, 1.3)),
                    ..SENSOR_B
                }),
                30.0,
            )
        },
        scenario(
            "noiseless",
            TwistSpec {
                a: silent(SENSOR_A),
                b: silent(SENSOR_B),
                ..base
            },
            0.05,
        )
        .with_a_floor(),
        held("held 1 s late", Grip::Late(0.5, 1.5)),
        held("let go 1 s early", Grip::LetGo(0.5, 1.5)),
        held("slip of 2° to 15°", Grip::Slip(2.0, 15.0)),
        held("wrong grip for 0.3 to 1 s", Grip::Wrong(0.3, 1.0)),
        scenario(
            "mount flexes, 15 to 40 Hz",
            TwistSpec {
                grip: Grip::Flexing(15.0, 40.0),
                ..base
            },
            8.0,
        ),
        scenario(
            "mount flexes by axis, 12 to 60 Hz",
            TwistSpec {
                grip: Grip::FlexingByAxis(12.0, 60.0),
                ..base
            },
            8.0,
        ),
        scenario("several faults of b", with_b(SEVERAL_FAULTS), 12.0),
        scenario(
            "hardly any noise",
            TwistSpec {
                a: Sensor {
                    noise: 1e-9,
                    lsb: 0.0,
                    ..SENSOR_A
                },
                b: Sensor {
                    noise: 0.0,
                    lsb: 0.0,
                    rate_hz: 500.0,
                    ..SENSOR_B
                },
                ..base
            },
            0.05,
        )
        .with_a_floor(),
        scenario(
            "two phones with faults",
            TwistSpec {
                a: Sensor {
                    faulty: true,
                    faulty_period: 10.37,
                    sawtooth_s: Some((57e-6, 0.9)),
                    ..SENSOR_B
                },
                b: SEVERAL_FAULTS,
                ..base
            },
            20.0,
        )
        .mostly(0.95),
        scenario(
            "Butterworth, 188 and 60 Hz",
            TwistSpec {
                a: Sensor {
                    filter_hz: Some(188.0),
                    filter_damping: std::f64::consts::FRAC_1_SQRT_2,
                    ..SENSOR_A
                },
                b: Sensor {
                    filter_hz: Some(60.0),
                    filter_damping: std::f64::consts::FRAC_1_SQRT_2,
                    ..SENSOR_B
                },
                ..base
            },
            8.0,
        ),
        refused(
            "still",
            TwistSpec {
                motion: Motion::Still,
                ..base
            },
        ),
        refused(
            "held for the last second only",
            TwistSpec {
                grip: Grip::Late(5.5, 6.5),
                ..base
            },
        ),
        refused(
            "unrelated",
            TwistSpec {
                unrelated: true,
                ..base
            },
        ),
        refused(
            "unrelated, single axis",
            TwistSpec {
                motion: Motion::SingleAxis(2.0, 4.0),
                unrelated: true,
                ..base
            },
        ),
    ]
}
