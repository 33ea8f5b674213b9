//! `cargo xtask demo --rig multi`, short: two phones, four cameras and a lidar in one
//! session, each extracted in board time and judged against the ground truth. This is the
//! test of `outputs/NAME.csv`, too.

use crate::whole_chain::{near_truth, programs};
use scenarios::whole_chain::several::{self, SeveralPlan};

#[test]
fn every_sensor_of_a_large_rig_is_extracted_in_board_time() {
    let out = tempfile::tempdir().unwrap();
    let plan = SeveralPlan {
        seed: 7,
        seconds: 20,
        small: true,
    };
    let figures = several::run(&plan, &programs(), &out.path().join("multi"), |_| {}).unwrap();
    println!("{}", figures.table());
    assert!(figures.good(), "{figures:?}");
    assert_eq!((figures.phones.len(), figures.session.len()), (2, 1));
    assert!(figures.outputs.iter().all(|output| output.pulses > 80));
    assert!(figures.lidar.seconds >= 18, "{:?}", figures.lidar);
    for phone in &figures.phones {
        assert!(phone.middle.count > 600, "{phone:?}");
        let limit = 6.0 * phone.sigma_us.hypot(1.0);
        assert!(phone.middle.largest_us < limit, "{phone:?}");
        assert!(phone.grid_error_us.abs() < limit, "{phone:?}");
        let largest = phone.middle.largest_us.max(phone.grid_error_us.abs());
        assert!(largest < 50.0, "{phone:?}");
    }
    // What the session had said of the phone that is not followed.
    let said = &figures.session[0];
    near_truth(&said.offset_start, 30.0, 50.0);
    near_truth(&said.offset_end, 30.0, 50.0);
    assert!(
        said.placement.error_us.abs() < 5.0 * said.placement.sigma_us.hypot(1.5),
        "{said:?}"
    );
    assert!(said.placement.error_us.abs() < 100.0, "{said:?}");
    assert!(
        said.drift_error_us_per_min.abs() < 5.0 * said.drift_sigma_us_per_min,
        "{said:?}"
    );
    assert!(said.drift_error_us_per_min.abs() < 300.0, "{said:?}");
    let report = std::fs::read(figures.data.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let named = |name: &str| {
        let sensors = report["sensors"].as_array().unwrap();
        let is_it = sensors.iter().find(|sensor| sensor["name"] == name);
        is_it.unwrap()["pulses"].as_u64().unwrap() as usize
    };
    assert_eq!(report["sensors"].as_array().unwrap().len(), 4);
    assert_eq!(named("VLP-16"), figures.lidar.seconds);
    for output in &figures.outputs {
        assert_eq!(named(&output.name), output.pulses);
    }
    // Files by name, and nothing of one phone in the other's place.
    for path in [
        "mav0/cam0/data.csv",
        "mav0/imu1/data.csv",
        "phones/right phone/mav0/cam0/data.csv",
        "phones/right phone/mav0/imu1/data.csv",
        "phones/right phone/pairs.csv",
    ] {
        assert!(figures.data.join(path).is_file(), "{path}");
    }
    assert!(!figures.data.join("phones/left phone").exists());
}
