//! `smartdepthsync record` with further cameras and a lidar in the profile: they
//! join the aligned trigger, and the recording has them by name.

use crate::turn;
use crate::whole_rig::{SPEED, Session, WholeRig};
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};

const FURTHER: &str = r#"
[[outputs]]
output = 2
name = "left"
every = 6

[[outputs]]
output = 4
name = "right"
every = 1
delay_us = 160.0

[lidar]
name = "VLP-16"
"#;

#[test]
fn further_sensors_are_recorded_by_name_on_pulses_of_the_trigger() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(5, SPEED);
    let profile = rig.profile() + FURTHER;
    let mut command = rig.record_with("further", &profile, &["--duration", "12s"]);
    let said = Session::start(&mut command).ends_with(0);
    assert!(said.contains("left on output 2"), "{said}");
    assert!(said.contains("UTC for VLP-16"), "{said}");

    let folder = rig.recording("further");
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Good));
    assert_eq!(session.counts.lost(), 0);
    assert!(session.counts.outputs.received > 100);
    assert!(session.counts.pps.received >= 9);

    let mut trigger = Vec::new();
    let mut left = Vec::new();
    let mut right = Vec::new();
    let mut seconds = Vec::new();
    for entry in Reader::open(&folder).unwrap() {
        let entry = entry.unwrap();
        match entry.item {
            Item::Pulse(pulse) => trigger.push(pulse.ticks),
            Item::Output(pulse) => match pulse.header.frame_id.as_str() {
                "left" => left.push(pulse.ticks),
                "right" => right.push(pulse.ticks),
                other => panic!("{other}"),
            },
            Item::Gnss(pulse) => {
                assert_eq!(pulse.source, "VLP-16");
                seconds.push((entry.at, pulse.time_ref.nanos()));
            }
            _ => {}
        }
    }
    // Every sixth pulse of the trigger, each at its very tick.
    let begin = trigger.iter().position(|&at| at == left[0]).unwrap();
    let sixths: Vec<u64> = trigger[begin..].iter().step_by(6).copied().collect();
    assert!(left.len() > 10, "{}", left.len());
    assert_eq!(sixths[..left.len()], left[..]);
    // 160 µs after each pulse: 7,680 ticks.
    let begin = trigger
        .iter()
        .position(|&at| at + 7_680 == right[0])
        .unwrap();
    let later = trigger[begin..].iter().map(|at| at + 7_680);
    assert!(later.zip(&right).all(|(expected, &at)| at == expected));
    assert!(right.len() > 60, "{}", right.len());
    // One relation of board time and the pretended GNSS time, on whole seconds.
    let offset = |&(at, utc): &(protocol::Ticks, i64)| {
        assert_eq!(at.0 % 48_000_000, 0);
        utc - (at.0 / 48_000_000) as i64 * 1_000_000_000
    };
    assert!(
        seconds
            .iter()
            .all(|second| offset(second) == offset(&seconds[0]))
    );
}
