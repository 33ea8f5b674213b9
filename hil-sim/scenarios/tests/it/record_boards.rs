//! A session with an IMU that takes no clock from the board, judged by the truth. The others
//! are in the sessions of the whole chain.

use crate::turn;
use crate::whole_rig::{SPEED, Session, WholeRig};
use protocol::{ImuClock, ImuModel};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::imu::SensorModel;
use scenarios::demo::judge::Truth;

#[test]
fn a_session_is_aligned_with_an_imu_on_its_own_clock() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with(34, SPEED, |config, _| {
        *config = config.clone().with_imu(SensorModel::Mpu9250);
    });
    let mut command = rig.record_with("session", &rig.full_rate_profile(), &["--duration", "5s"]);
    let said = Session::start(&mut command).ends_with(0);
    println!("{said}");
    let folder = rig.recording("session");
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Good));
    assert_eq!(session.counts.lost(), 0);
    let setup = session.imu.unwrap().setup;
    assert_eq!(setup.sensor.model, ImuModel::Mpu9250);
    assert_eq!(setup.status.clock, ImuClock::Internal);

    let truth = rig.rig.stop().unwrap();
    let verdict = Truth::of(truth).unwrap().judge(&folder).unwrap();
    let start = verdict.offset_start;
    println!("{start:?}, {:?}", verdict.phase);
    assert!(start.error_us.abs() < 5.0 * start.sigma_us, "{start:?}");
    assert!(start.sigma_us < 30.0, "{start:?}");
}
