//! Sessions on each board with other IMUs than the published one, judged by the truth.

use crate::turn;
use crate::whole_rig::{Session, WholeRig};
use protocol::{BoardModel, ImuClock, ImuModel};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::imu::SensorModel;
use rig::wiring::BoardKind;
use trials::demo::judge::Truth;

#[test]
fn a_session_is_aligned_on_each_board_with_each_imu_and_says_which_they_are() {
    let _turn = turn::alone();
    for (seed, board, model, imu, found) in [
        (
            31,
            BoardKind::BlackPill,
            BoardModel::BlackPill,
            SensorModel::Icm42688P,
            ImuModel::Icm42688P,
        ),
        (
            32,
            BoardKind::BlackPill,
            BoardModel::BlackPill,
            SensorModel::Mpu6050,
            ImuModel::Mpu6050,
        ),
        (
            33,
            BoardKind::Discovery,
            BoardModel::Discovery,
            SensorModel::Icm42688P,
            ImuModel::Icm42688P,
        ),
        (
            34,
            BoardKind::Discovery,
            BoardModel::Discovery,
            SensorModel::Mpu9250,
            ImuModel::Mpu9250,
        ),
    ] {
        let rig = WholeRig::with(seed, 20.0, |config, _| {
            config.board = board;
            *config = config.clone().with_imu(imu);
        });
        let arguments = ["--duration", "5s"];
        let said = Session::start(&mut rig.record("session", &arguments)).ends_with(0);
        println!("{said}");
        let folder = rig.recording("session");
        let session = SessionFile::load(&folder).unwrap();
        assert_eq!(session.outcome, Some(SessionOutcome::Good));
        assert_eq!(session.counts.lost(), 0);
        assert_eq!(session.board.unwrap().model, model);
        let setup = session.imu.unwrap().setup;
        assert_eq!(setup.sensor.model, found);
        let clock = match found.clock_input() {
            Some(_) => ImuClock::External,
            None => ImuClock::Internal,
        };
        assert_eq!(setup.status.clock, clock);

        let truth = rig.rig.stop().unwrap();
        let verdict = Truth::of(truth).unwrap().judge(&folder).unwrap();
        let start = verdict.offset_start;
        println!("{board:?}, {imu:?}: {start:?}, {:?}", verdict.phase);
        assert!(start.error_us.abs() < 5.0 * start.sigma_us, "{start:?}");
        assert!(start.sigma_us < 30.0, "{start:?}");
    }
}
