//! Sessions with a board or a phone that lies, a few of them. `cargo xtask hil-sim lies` runs more.

use std::process::Command;

use crate::record_faults::{all_is_stopped, problems, readable};
use crate::support;
use crate::turn;
use crate::whole_rig::{OVERSHOOT_S, SPEED, Session, WholeRig};
use protocol::{DeviceToHost, ImuSample, TICK_HZ, TickDelta};
use recording::session_file::SessionOutcome;
use scenarios::lies::board::{Change, Liar};
use scenarios::lies::campaign;
use scenarios::programs::Programs;

// Exit codes, as docs/exit-codes.md has them.
const REFUSED: i32 = 3;
const LOSS: i32 = 4;

#[test]
fn whatever_board_and_phone_say_the_session_ends_well() {
    let _turn = turn::beside_others();
    let programs = Programs {
        smartdepthsync: support::smartdepthsync().to_owned(),
        elf: None,
        speed: 8.0,
    };
    let folder = support::folder_in_memory();
    let results = campaign(&[1, 2, 3, 4, 5, 6, 7, 8], &programs, folder.path(), &|_| {});
    let passed: Vec<_> = results
        .into_iter()
        .map(|result| result.unwrap_or_else(|finding| panic!("{finding}")))
        .collect();
    assert!(passed.iter().map(|verdict| verdict.told).sum::<u64>() > 100);
    assert!(passed.iter().any(|verdict| verdict.frames > 1_000));
}

/// Through somebody who changes what the board says.
#[test]
fn a_board_whose_numbers_do_not_follow_is_told_and_not_called_without_loss() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(18, SPEED);
    let changes: [(&str, u64, Change); 2] = [
        ("twice", 20, |message| vec![message.clone(); 50]),
        ("jump", u64::MAX, |message| match message {
            DeviceToHost::Imu(sample) => {
                let seq = sample.seq.wrapping_add(1 << 31);
                vec![DeviceToHost::Imu(ImuSample { seq, ..*sample })]
            }
            other => vec![other.clone()],
        }),
    ];
    for (name, count, change) in changes {
        let liar = Liar::honest(rig.rig.port()).unwrap();
        let mut session = Session::start(&mut behind(&rig, &liar, name));
        session.wait_for("recording for");
        // What it counts from is true.
        rig.wait_ms(500);
        liar.tell("Imu", count, change);
        let said = session.ends_with(LOSS);
        assert!(said.contains("IMU samples came twice"), "{said}");
        let file = readable(&rig, name, SessionOutcome::Loss);
        assert!(problems(&file).contains(&"numbers_disordered"), "{name}");
        assert!(file.counts.imu.disordered > 0, "{name}");
        drop(liar);
        all_is_stopped(&rig, name);
    }
}

#[test]
fn one_sample_an_hour_ahead_ends_nothing() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(19, SPEED);
    let liar = Liar::honest(rig.rig.port()).unwrap();
    let mut session = Session::start(&mut behind(&rig, &liar, "ahead"));
    session.wait_for("recording for");
    liar.tell("Imu", 1, |message| match message {
        DeviceToHost::Imu(sample) => {
            let at = sample.at + TickDelta(3_600 * i64::from(TICK_HZ));
            vec![DeviceToHost::Imu(ImuSample { at, ..*sample })]
        }
        other => vec![other.clone()],
    });
    let said = session.ends_with(LOSS);
    assert!(said.contains("far from all others"), "{said}");
    let file = readable(&rig, "ahead", SessionOutcome::Loss);
    let span = file.recorded.unwrap();
    let seconds = (span.to - span.from).as_secs_f64();
    assert!((24.0..24.0 + OVERSHOOT_S).contains(&seconds), "{seconds}");
    drop(liar);
    all_is_stopped(&rig, "ahead");
}

/// A recording on another port, long enough for a lie on a busy machine: 2.4 s of real time.
fn behind(rig: &WholeRig, liar: &Liar, name: &str) -> Command {
    let honest = rig.record_with(name, &rig.full_rate_profile(), &["--duration", "24s"]);
    let mut command = Command::new(honest.get_program());
    command.args(honest.get_args().map(|argument| {
        if argument == rig.rig.port() {
            liar.port().as_os_str()
        } else {
            argument
        }
    }));
    command
}

/// The board could do 40 fps; the depth camera's mode has 30.
#[test]
fn a_phone_with_frames_at_another_rate_does_not_drive_the_depth_camera() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with(20, SPEED, |_, phone| phone.camera.frame_period_ns = 25e6);
    let said = Session::start(&mut rig.record("rate", &["--duration", "2s"])).ends_with(REFUSED);
    assert!(said.contains("within 10 %"), "{said}");
    readable(&rig, "rate", SessionOutcome::Failed);
    all_is_stopped(&rig, "another rate");
}
