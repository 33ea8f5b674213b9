//! `smartdepthsync record` with two phones in the profile: one twist relates both
//! clocks, both record, and what is said of each is true.

use crate::turn;
use crate::whole_rig::{SPEED, Session, WholeRig};
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use scenarios::demo::judge::Truth;

#[test]
fn two_phones_are_related_by_one_twist_and_placed_against_the_grid() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with_phones(31, SPEED, 2, |_, _| {});
    let profile = rig.profile_of(&["left", "right"]);
    let arguments = ["--duration", "10s", "--second-twist", "--fetch-video"];
    let mut command = rig.record_with("two", &profile, &arguments);
    let said = Session::start(&mut command).ends_with(0);
    for words in ["twist 1, left", "twist 1, right", "it cannot be shifted"] {
        assert!(said.contains(words), "{words}: {said}");
    }

    let folder = rig.recording("two");
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Good));
    assert_eq!(session.profile.phone.name, "left");
    let right = &session.phones[1];
    assert_eq!((right.name.as_str(), right.twists.len()), ("right", 2));
    // Each phone's files are in its own folder, and are all there.
    for file in &session.files {
        assert!(folder.join(file).is_file(), "{file}");
    }
    for name in ["left", "right"] {
        let own = |ending: &str| {
            let begins = format!("phones/{name}/");
            let ours = |file: &&String| file.starts_with(&begins) && file.ends_with(ending);
            session.files.iter().filter(ours).count()
        };
        assert_eq!((own("_phone_gyro.csv"), own(".mp4")), (2, 1), "{name}");
    }
    let mut sources = Vec::new();
    for entry in Reader::open(&folder).unwrap() {
        if let Item::PhoneClock(clock) = entry.unwrap().item {
            sources.push((clock.header.frame_id, clock.source));
        }
    }
    let source = |text: &str| (String::from("right"), String::from(text));
    assert_eq!(
        sources,
        [source("twist 1"), source("twists at begin and end")]
    );

    let truth = Truth::of(rig.rig.stop().unwrap()).unwrap();
    let verdict = truth.judge(&folder).unwrap();
    let others = truth.judge_others(&folder).unwrap();
    println!("{:?}\n{others:?}", verdict.offset_start);
    let [other] = others.as_slice() else {
        panic!("{others:?}");
    };
    for offset in [verdict.offset_start, other.offset_start, other.offset_end] {
        assert!(offset.error_us.abs() < 5.0 * offset.sigma_us, "{offset:?}");
        assert!(offset.sigma_us < 30.0, "{offset:?}");
    }
    // Where its frames were said to lie, and how they move, within what was said.
    assert!(
        other.placement.error_us.abs() < 5.0 * other.placement.sigma_us.hypot(1.5),
        "{other:?}"
    );
    assert!(
        other.drift_error_us_per_min.abs() < 5.0 * other.drift_sigma_us_per_min,
        "{other:?}"
    );
}
