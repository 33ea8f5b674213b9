//! A short piece of the long run, over a wrap of the counter.

use std::process::Command;

use serde_json::Value;

/// `cargo xtask hil-sim long-run` is this for hours. A process, since it looks at its own memory.
#[test]
fn two_minutes_are_exact_on_all_pins_with_flat_memory() {
    let output = Command::new(env!("CARGO_BIN_EXE_hil-sim"))
        .args([
            "long-run",
            "--for",
            "2min",
            "--seed",
            "3",
            "--full-link",
            "20",
            "--json",
        ])
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = |name: &str| report[name].as_u64().unwrap();
    assert_eq!(count("full_link_s"), 20);
    assert_eq!(count("lost"), 0);
    assert!(count("pulses") >= 3_600, "{report}");
    assert_eq!(count("pulses_reported"), count("pulses"));
    assert!(count("samples") >= 60_000, "{report}");
    assert!(count("captures") >= 18 * 3_590, "{report}");
    assert!(count("wraps") >= 1, "{report}");
    assert!(count("link_bytes") > 20 * 400_000, "{report}");
    assert!(count("stack_used") < count("stack_size") / 2, "{report}");
    let at = &report["growth"][0];
    assert!(
        at["to_bytes"].as_u64() > at["from_bytes"].as_u64(),
        "{at:?}"
    );
}
