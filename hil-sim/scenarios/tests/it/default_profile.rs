//! Sessions with the default profile, on rigs whose constants nobody has measured: judged by
//! what the program itself states.

use recording::profile::Profile;
use recording::session_file::SessionFile;
use scenarios::judge::Truth;
use stm32f4_sim::time::SimDuration;

use crate::bench::Twisted;

/// The depth camera's delay to its first flash, the delay of the phone's gyroscope, and its
/// readout, ms: about the ends of the ranges in `hil-sim/rig/ranges.md`. An error beyond half a
/// frame period would be another frame's.
const RIGS: [(f64, f64, f64); 2] = [(0.3, 8.0, 6.0), (9.5, 2.0, 20.0)];

#[test]
fn constants_that_were_not_measured_widen_the_stated_error() {
    for (number, (flash_ms, gyro_ms, readout_ms)) in [1, 3].into_iter().zip(RIGS) {
        let mut rig = Twisted::with(number, |config, phone| {
            if let Some(depth) = &mut config.depth_camera {
                depth.flash_delay = SimDuration::from_secs_f64(flash_ms * 1e-3);
                depth.photodiode = false;
            }
            phone.gyroscope.low_pass.delay_s = gyro_ms * 1e-3;
            phone.camera.row_time_ns = readout_ms * 1e6 / (phone.camera.rows - 1) as f64;
        });
        let mut profile = Profile::published().unwrap();
        let owners = &rig.bench.profile;
        profile.phone.address.clone_from(&owners.phone.address);
        (profile.phone.twist_s, profile.align.slew_us) = (6, 1_000.0);
        rig.bench.profile = profile;
        rig.record("default", 5);

        let folder = rig.recording("default");
        let session = SessionFile::load(&folder).unwrap();
        let alignment = session.alignment.unwrap();
        let summary = report::session::summary(&folder, &session, None);
        let truth = Truth::from_run(rig.bench.stop().unwrap()).unwrap();
        let verdict = truth.judge(&folder).unwrap();
        let (error_us, sigma_us) = (verdict.phase.start_us, alignment.phase_sigma_us);
        println!("{number}: phase {error_us:+.0} µs, stated ± {sigma_us:.0} µs");
        assert!(error_us.abs() < 2.5 * sigma_us, "{error_us} {sigma_us}");
        // And no more than a person can expect, independent of the stated error.
        assert!((3_000.0..8_000.0).contains(&sigma_us), "{sigma_us}");
        assert!(error_us.abs() < 14_000.0, "{error_us}");
        // It is what is read first.
        let first = summary.text.split('.').next().unwrap();
        assert!(
            !alignment.bias_is_measured && first.starts_with("Cameras expose together to ± 6"),
            "{first}"
        );
    }
}
