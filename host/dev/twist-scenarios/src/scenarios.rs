//! The simulated scenarios of the tests and the bench, with the requirements for each.

use super::{Grip, Motion, SENSOR_B, Sensor, TwistSpec};

/// A scenario with the requirements for its estimates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scenario {
    /// Name of the scenario.
    pub name: &'static str,
    /// Recordings of the scenario.
    pub spec: TwistSpec,
    /// Largest rms error of the offset, µs; `None` if a refusal is required.
    pub rmse_us: Option<f64>,
    /// True if the offset's error over its sigma must be near one: the model of the noise holds.
    pub honest: bool,
    /// True if the skew's error over its sigma must be near one.
    pub honest_skew: bool,
    /// Least part of the twists that must be accepted; the others may have too many faults.
    pub accepted: f64,
}

impl Scenario {
    /// Creates a scenario of changed base twists with a largest rms error.
    fn new(name: &'static str, rmse_us: f64, change: impl FnOnce(&mut TwistSpec)) -> Self {
        Self {
            rmse_us: Some(rmse_us),
            honest: true,
            honest_skew: true,
            accepted: 1.0,
            ..Self::refused(name, change)
        }
    }

    /// Creates a scenario of twists that must be refused.
    fn refused(name: &'static str, change: impl FnOnce(&mut TwistSpec)) -> Self {
        let mut spec = TwistSpec::default();
        change(&mut spec);
        Self {
            name,
            spec,
            rmse_us: None,
            honest: false,
            honest_skew: false,
            accepted: 0.0,
        }
    }

    /// Lowers the required part of accepted twists.
    const fn mostly(mut self, accepted: f64) -> Self {
        self.accepted = accepted;
        self
    }

    /// Marks a sigma that is not due to noise, but to the numerical floor or to faults.
    const fn not_by_noise(mut self) -> Self {
        self.honest = false;
        self.honest_skew = false;
        self
    }

    /// Marks a wider sigma of the offset: the zero of a sawtooth that jumps once is unknown.
    const fn of_unknown_zero(mut self) -> Self {
        self.honest = false;
        self
    }
}

/// A phone with all known faults: copies and displaced samples every 10, a sawtooth of the
/// stamps.
const SEVERAL_FAULTS: Sensor = Sensor {
    faulty: true,
    faulty_next_s: -0.43e-3,
    sawtooth_s: Some((57e-6, 1.3)),
    ..SENSOR_B
};

/// Peaks about the axes of the published rig's twist, rad/s.
pub const REAL_STRENGTH: Motion = Motion::Axes([1.14, 0.37, 0.015]);

fn sample_both_at(spec: &mut TwistSpec, rate_hz: f64) {
    spec.a.rate_hz = rate_hz;
    spec.b.rate_hz = rate_hz * 1.0001;
}

fn filter(spec: &mut TwistSpec, damping: f64) {
    for (sensor, hz) in [(&mut spec.a, 188.0), (&mut spec.b, 60.0)] {
        sensor.filter_hz = Some(hz);
        sensor.filter_damping = damping;
    }
}

fn silence(sensor: &mut Sensor) {
    sensor.noise = 0.0;
    sensor.lsb = 0.0;
}

/// All scenarios of the tests and the bench.
#[must_use]
pub fn scenarios() -> Vec<Scenario> {
    let wandering = |name, rmse_us, rms, memory| {
        Scenario::new(name, rmse_us, |s| s.b.wander_s = Some((rms, memory)))
    };
    let cut = |name, rate_hz, resolution_s| {
        Scenario::new(name, 20.0, |s| {
            s.b.rate_hz = rate_hz;
            s.b.resolution_s = resolution_s;
            s.b.wander_s = Some((3e-6, 0.5));
        })
        .of_unknown_zero()
    };
    let held = |name, grip| Scenario::new(name, 6.0, |s| s.grip = grip);
    vec![
        Scenario::new("base", 4.0, |_| ()),
        Scenario::new("jitter 20 µs", 4.0, |s| {
            s.a.jitter_s = 20e-6;
            s.b.jitter_s = 20e-6;
        }),
        Scenario::new("single axis", 4.0, |s| {
            s.motion = Motion::SingleAxis(2.0, 4.0);
        }),
        Scenario::new("sawtooth 57 µs", 6.0, |s| {
            s.b.sawtooth_s = Some((57e-6, 0.9));
        }),
        // Like the published rig's twist, which has one reset in 9.8 s.
        Scenario::new("sawtooth 57 µs, 5 to 20 s", 20.0, |s| {
            s.b.sawtooth_s = Some((57e-6, 5.0));
            s.b.longest_sawtooth_s = 20.0;
        })
        .of_unknown_zero(),
        wandering("wander 2 µs, 0.5 s", 4.0, 2e-6, 0.5),
        wandering("wander 2 µs, 2 s", 4.0, 2e-6, 2.0),
        wandering("wander 5 µs, 0.5 s", 5.0, 5e-6, 0.5),
        // It hardly shows within a twist, and the sigma is too small.
        wandering("wander 5 µs, 2 s", 6.0, 5e-6, 2.0).not_by_noise(),
        wandering("wander 20 µs, 0.5 s", 12.0, 20e-6, 0.5),
        // A counter of 32,768 Hz, and one at which a step of the samples is nearly whole.
        cut("stamps cut to 30.5 µs", 500.06, 30.517_578e-6),
        cut("stamps cut to 28.8 µs", 455.0, 28.8e-6),
        cut("the same at 416 Hz", 416.3, 28.8e-6),
        Scenario::new("one noisy axis of a", 5.0, |s| s.a.noisy_z = 5.0),
        Scenario::new("one noisy axis of b", 5.0, |s| s.b.noisy_z = 5.0),
        Scenario::new("as strong as the real one", 13.0, |s| {
            s.motion = REAL_STRENGTH
        }),
        Scenario::new("filters 188 and 60 Hz", 6.0, |s| filter(s, 1.0)),
        Scenario::new("weak, 1.1 rad/s", 13.0, |s| {
            s.motion = Motion::Twist(1.1, 1.1);
        }),
        Scenario::new("clipped at 250 deg/s", 4.0, |s| {
            s.motion = Motion::Twist(5.0, 7.0);
            s.a.range = Some(250.0_f64.to_radians());
        }),
        Scenario::new("skew up to 115 ppm", 4.0, |s| s.skew_ppm = 115.0),
        Scenario::new("1 kHz", 4.0, |s| sample_both_at(s, 1000.0)),
        Scenario::new("208 Hz", 6.0, |s| sample_both_at(s, 208.0)),
        Scenario::new("a at 1 kHz, b at 208 Hz", 5.0, |s| {
            s.a.rate_hz = 1000.0;
            s.b.rate_hz = 208.0;
        }),
        Scenario::new("gaps, 5 % lost", 6.0, |s| {
            s.a.lost = 0.05;
            s.b.lost = 0.05;
        }),
        Scenario::new("half overlap", 6.0, |s| s.b_starts_s = 4.5),
        Scenario::new("60 s, moved for 7 s", 4.0, |s| {
            s.duration_s = 60.0;
            s.rest_s = 26.5;
        }),
        Scenario::new("faulty stream b", 30.0, |s| {
            s.b.faulty = true;
            s.b.sawtooth_s = Some((57e-6, 1.3));
        })
        .not_by_noise(),
        Scenario::new("noiseless", 0.05, |s| {
            silence(&mut s.a);
            silence(&mut s.b);
        })
        .not_by_noise(),
        held("held 1 s late", Grip::Late(0.5, 1.5)),
        held("let go 1 s early", Grip::LetGo(0.5, 1.5)),
        held("slip of 2° to 15°", Grip::Slip(2.0, 15.0)),
        held("wrong grip for 0.3 to 1 s", Grip::Wrong(0.3, 1.0)),
        // A delay by the mount is not noise.
        Scenario::new("mount flexes, 15 to 40 Hz", 35.0, |s| {
            s.grip = Grip::Flexing(15.0, 40.0);
        })
        .not_by_noise(),
        Scenario::new("several faults of b", 12.0, |s| s.b = SEVERAL_FAULTS),
        Scenario::new("hardly any noise", 0.05, |s| {
            silence(&mut s.a);
            s.a.noise = 1e-9;
            silence(&mut s.b);
            s.b.rate_hz = 500.0;
        })
        .not_by_noise(),
        Scenario::new("two phones with faults", 20.0, |s| {
            s.a = Sensor {
                faulty: true,
                faulty_period: 10.37,
                sawtooth_s: Some((57e-6, 0.9)),
                ..SENSOR_B
            };
            s.b = SEVERAL_FAULTS;
        })
        .mostly(0.95),
        Scenario::new("Butterworth, 188 and 60 Hz", 8.0, |s| {
            filter(s, std::f64::consts::FRAC_1_SQRT_2);
        }),
        Scenario::refused("still", |s| s.motion = Motion::Still),
        Scenario::refused("held for the last second only", |s| {
            s.grip = Grip::Late(5.5, 6.5);
        }),
        Scenario::refused("unrelated", |s| s.unrelated = true),
        Scenario::refused("unrelated, single axis", |s| {
            s.motion = Motion::SingleAxis(2.0, 4.0);
            s.unrelated = true;
        }),
    ]
}
