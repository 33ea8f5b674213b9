//! The simulated recordings of the tests and the bench, and what is demanded of each.

use super::{Motion, SENSOR_A, SENSOR_B, Sensor, TwistSpec};

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
}

/// All scenarios of the tests and the bench.
#[must_use]
pub fn scenarios() -> Vec<Scenario> {
    let base = TwistSpec::default();
    let scenario = |name, spec, rmse_us: f64| Scenario {
        name,
        spec,
        rmse_us: Some(rmse_us),
        honest: true,
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
    };
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
        Scenario {
            honest: false,
            ..scenario(
                "noiseless",
                TwistSpec {
                    a: silent(SENSOR_A),
                    b: silent(SENSOR_B),
                    ..base
                },
                0.05,
            )
        },
        refused(
            "still",
            TwistSpec {
                motion: Motion::Still,
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
