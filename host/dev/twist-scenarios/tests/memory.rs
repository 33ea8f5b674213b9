//! Peak memory of an estimate, as a multiple of its input.
//!
//! The allocator counts for the whole process, so each figure is measured in a separate one.

use peak_alloc::PeakAlloc;
use std::process::Command;

use twist_scenarios::{Grip, Motion, Twist, TwistSpec};
use twist_sync::{GyroTrack, Options, estimate_offset};

#[global_allocator]
static ALLOCATED: PeakAlloc = PeakAlloc;

/// Peak over input for samples without gaps, as stated in "Sync math".
const MULTIPLE: f64 = 24.0;
/// Peak over input if gaps leave 10 samples a second on average.
const MULTIPLE_SPARSE: f64 = 110.0;
/// Constant part of the peak, bytes: threads, plans of the Fourier transform.
const BASE: f64 = 2e6;

/// Bytes of a track's times and rates.
fn size(track: &GyroTrack) -> usize {
    track.t.len() * size_of::<f64>() + track.w.len() * size_of::<[f64; 3]>()
}

/// Peak of one estimate above the usage before it, minus the constant part, over the input.
fn multiple(a: &GyroTrack, b: &GyroTrack) -> f64 {
    let before = ALLOCATED.current_usage();
    ALLOCATED.reset_peak_usage();
    let result = estimate_offset(a, b, &Options::default());
    let peak = ALLOCATED.peak_usage() - before;
    drop(result);
    (peak as f64 - BASE) / (size(a) + size(b)) as f64
}

/// Returns the recordings of the twist with the stamps `stamp(k)`.
fn stamped(twist: &Twist, stamp: impl Fn(usize) -> f64) -> (GyroTrack, GyroTrack) {
    [&twist.a, &twist.b]
        .map(|track| GyroTrack {
            t: (0..track.len()).map(&stamp).collect(),
            ..track.clone()
        })
        .into()
}

#[test]
#[ignore = "run in a process of its own by `the_peak_is_a_stated_multiple_of_the_input`"]
fn measured() {
    let mut most: f64 = 0.0;
    let mut check = |name: &str, (a, b): (GyroTrack, GyroTrack), limit: f64| {
        let found = multiple(&a, &b);
        println!("{name}: {found:.1} times the input above {BASE} bytes");
        assert!(found < limit, "{name}: {found:.1}");
        most = most.max(found);
    };
    let names = [
        "base",
        "208 Hz",
        "60 s, moved for 7 s",
        "slip of 2° to 15°",
        "two phones with faults",
    ];
    for scenario in twist_scenarios::scenarios() {
        if names.contains(&scenario.name) {
            let twist = twist_scenarios::twist(&scenario.spec, 52_000);
            check(scenario.name, (twist.a, twist.b), MULTIPLE);
        }
    }
    // Minutes of being carried around: 156,000 samples each.
    for grip in [Grip::Firm, Grip::Slip(5.0, 5.0)] {
        let mut minutes = TwistSpec {
            motion: Motion::Natural(0.8, 1.6),
            duration_s: 780.0,
            grip,
            ..TwistSpec::default()
        };
        (minutes.a.rate_hz, minutes.b.rate_hz) = (200.0, 200.02);
        let twist = twist_scenarios::twist(&minutes, 54_000);
        check("13 min of 200 Hz", (twist.a, twist.b), MULTIPLE);
    }
    let long = TwistSpec {
        duration_s: 40.0,
        ..TwistSpec::default()
    };
    let long = twist_scenarios::twist(&long, 53_000);
    let n = long.a.len();
    let regular = |k: usize| 0.002 * k as f64;
    let scattered = |k: usize| (k * 7919 % n) as f64 * 1e3;
    let wild = |k: usize| if k % 10 == 3 { 1e300 } else { regular(k) };
    let later = |k: usize| regular(k) + if k > n / 2 { 1e9 } else { 0.0 };
    let parts = |k: usize| regular(k) + 59.0 * (k / 590) as f64;
    let mut hostile = |name: &str, stamp: &dyn Fn(usize) -> f64, limit: f64| {
        check(name, stamped(&long, stamp), limit);
    };
    hostile("40 s", &regular, MULTIPLE);
    hostile("nanoseconds for seconds", &|k| 2e6 * k as f64, MULTIPLE);
    hostile("seconds for nanoseconds", &|k| 2e-12 * k as f64, MULTIPLE);
    hostile("all equal", &|_| 1.0, MULTIPLE);
    hostile("backwards", &|k| -regular(k), MULTIPLE);
    hostile("scattered over years", &scattered, MULTIPLE);
    hostile("not a number", &|_| f64::NAN, MULTIPLE);
    hostile("every tenth at the end of time", &wild, MULTIPLE);
    hostile("half of it 30 years later", &later, MULTIPLE);
    hostile("gaps of a minute", &parts, MULTIPLE_SPARSE);
    hostile(
        "10 samples a second",
        &|k| 0.0999 * k as f64,
        MULTIPLE_SPARSE,
    );
    println!("at most {most:.1} times");
}

#[test]
fn the_peak_is_a_stated_multiple_of_the_input() {
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "memory::measured", "--ignored", "--nocapture"])
        .output()
        .unwrap();
    let reported = String::from_utf8_lossy(&child.stdout);
    println!("{reported}");
    assert!(
        child.status.success(),
        "{reported}{}",
        String::from_utf8_lossy(&child.stderr)
    );
    // The one test did run.
    assert!(reported.contains("at most"), "{reported}");
}
