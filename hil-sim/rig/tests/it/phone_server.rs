//! A Python client that reads as the app's published one does runs on the simulated phone
//! (`python/phone_client.py` says what is special about it).

use std::path::Path;
use std::process::Command;

use rig::phone::SimPhone;
use rig::true_clock::TrueClock;

use crate::phone_bench::on_a_walk;

#[test]
fn the_python_client_gets_all_it_asks_for() {
    for version in ["v.0.1", "v.0.1.1"] {
        let clock = TrueClock::run_at(20.0);
        let (config, surroundings) = on_a_walk(30, &clock, |c| {
            c.version = version.to_owned();
            c.camera.rows = 120;
            c.camera.columns = 16;
            // It knows no sensors that still run, and relies on Nagle's algorithm.
            c.app.stop_ms = 0.0;
            c.app.gathers = true;
        });
        let phone = SimPhone::start(config, surroundings, 0).unwrap();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/phone_client.py");
        let address = phone.address();
        let output = Command::new("python3")
            .arg(script)
            .args([address.ip().to_string(), address.port().to_string()])
            .arg(version)
            .output()
            .expect("python3 is needed for this test");
        let said = String::from_utf8_lossy(&output.stderr);
        clock.stop();
        assert!(output.status.success(), "{said}");
    }
}
