//! More devices than two on one body.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use twist_sync::network::Pair;
use twist_sync::{ClockCourse, GyroTrack, Options, estimate_offset};

use super::{
    ClockPath, Rates, Seen, Sensor, Twist, TwistSpec, moving_until, on_path, record, rotation,
};

/// Recording a of a `pair` that [`super::twist`] made of this spec and seed, beside that of a
/// third gyroscope, which is firmly held to it: with a mounting, a clock and noise of its own.
#[must_use]
pub fn third(pair: &Twist, spec: &TwistSpec, seed: u64, sensor: &Sensor) -> Twist {
    let mut motion = Pcg64::seed_from_u64(seed);
    let rates = Rates::new(&mut motion, spec.motion, spec.rest_s, moving_until(spec));
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x7812_d000);
    let skew = 1e-6 * spec.skew_ppm * rng.random_range(-1.0..=1.0);
    let offset_s: f64 = rng.random_range(-4000.0..1e6);
    let end = spec.duration_s + spec.b_starts_s.max(0.0);
    let path = ClockPath::new(seed, skew, 0.0, end, 0.5 * end);
    let turn = rotation(&mut rng);
    let of_third = |t: f64| -> Vector3<f64> { rates.at(t) };
    let seen = Seen::new(&of_third, sensor, 0.0, end);
    let starts_s = 0.5 * spec.b_starts_s;
    let (t, w) = record(&mut rng, sensor, &seen, &turn, starts_s, spec.duration_s);
    Twist {
        b: on_path(pair.boot_s + offset_s, &path, 0.0, (&t, w)),
        skew,
        offset_s,
        path,
        ..pair.clone()
    }
}

/// The relation of each pair of recordings, in the order of a [`twist_sync::network::Network`];
/// `None` if one is refused.
#[must_use]
pub fn related(tracks: &[&GyroTrack]) -> Option<Vec<Pair>> {
    let numbers = 0..tracks.len();
    let pairs = numbers.flat_map(|a| (a + 1..tracks.len()).map(move |b| (a, b)));
    let related = |(a, b): (usize, usize)| {
        let estimate = estimate_offset(tracks[a], tracks[b], &Options::default()).ok()?;
        let course = ClockCourse::from_estimates(&[estimate.clock], estimate.clock.wander)?;
        Some(Pair { a, b, course })
    };
    pairs.map(related).collect()
}
