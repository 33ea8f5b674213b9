//! Faults, done to the rig at their virtual times.

use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::{Arc, Mutex};

use protocol::{
    Failure as SelfTestFailure, HostToDevice, MAX_FRAME, SELF_TEST_KEY, SelfTest, encode,
};
use rig::imu::Fault as ImuFault;
use rig::whole_rig::virtual_rig::VirtualRig;
use rig::wiring;
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Pin};
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::time::{SimDuration, SimTime};

use super::plan::{Event, Fault, Plan};
use crate::virtual_session::Hands;

/// Half a period of 100 kHz.
const FLOOD: SimDuration = SimDuration::from_micros(5);

/// Drives the strobe input at 100 kHz for a while.
#[derive(Debug, Default)]
pub(super) struct Flood {
    next: Option<SimTime>,
    until: SimTime,
    high: bool,
}

impl Flood {
    pub(super) fn shared() -> Shared<Self> {
        Arc::new(Mutex::new(Self::default()))
    }
}

impl PinModel for Flood {
    fn name(&self) -> String {
        "flood".to_owned()
    }
    fn watched_pins(&self) -> Vec<Pin> {
        Vec::new()
    }
    fn next_event(&self) -> Option<SimTime> {
        self.next
    }
    fn advance(&mut self, io: &mut PinIo<'_>) {
        self.high = !self.high && io.now() < self.until;
        io.drive(
            wiring::STROBE,
            if self.high { Drive::High } else { Drive::Low },
        );
        self.next = (self.high || io.now() < self.until).then(|| io.now() + FLOOD);
    }
}

/// Record of what happened, for the judge.
#[derive(Debug, Default)]
pub(super) struct Happened {
    /// When the recording began.
    pub(super) began: SimTime,
    /// When the transfer of a sample may have been hit.
    pub(super) disturbed: Vec<SimTime>,
    /// When the board was reset from outside.
    pub(super) reset: Option<SimTime>,
    /// When the host was killed, and a copy of its files made.
    pub(super) killed: Option<SimTime>,
    /// The last time at which the phone was away; never of one that did not come back.
    pub(super) phone_away: Option<SimTime>,
}

/// The parts of the rig that faults act on.
#[derive(Clone)]
pub(super) struct Stage {
    pub(super) happened: Rc<RefCell<Happened>>,
    pub(super) flood: Shared<Flood>,
    pub(super) hands: Rc<Hands>,
    /// The recording, and where its copy goes.
    pub(super) files: [PathBuf; 2],
    pub(super) plan: Plan,
}

impl Stage {
    /// The recording begins: faults count from here.
    pub(super) fn begin(self, rig: &mut VirtualRig) {
        let zero = rig.now();
        self.happened.borrow_mut().began = zero;
        for event in self.plan.events.clone() {
            let stage = self.clone();
            rig.at(event.begins(zero), move |rig| {
                stage.turn(rig, &event, true, event.ends(zero));
            });
            if event.for_us > 0 {
                let stage = self.clone();
                rig.at(event.ends(zero), move |rig| {
                    stage.turn(rig, &event, false, event.ends(zero));
                });
            }
        }
    }

    /// A fault begins or ends.
    fn turn(&self, rig: &mut VirtualRig, event: &Event, begins: bool, ends: SimTime) {
        let now = rig.now();
        let mut happened = self.happened.borrow_mut();
        let fault = event.fault;
        if fault.hits_imu() || fault.is_reset() {
            happened.disturbed.push(now);
        }
        if matches!(fault, Fault::ResetPressed | Fault::SupplyReset) {
            happened.reset = Some(now);
        }
        if fault.is_of_phone() {
            happened.phone_away = Some(if begins { SimTime::NEVER } else { now });
        }
        match fault {
            Fault::UsbUnplugged if begins => rig.sim.usb_unplug(),
            Fault::UsbUnplugged => rig.sim.usb_plug(),
            Fault::HostStalled => rig.sim.usb_set_reading(!begins),
            Fault::CorruptedFromBoard | Fault::CorruptedToBoard => {
                let on = |way| {
                    let is_on = if fault == way {
                        begins
                    } else {
                        self.plan.is_active(way, happened.began, now)
                    };
                    u32::from(is_on) * self.plan.corruption_ppm
                };
                let (from, to) = (on(Fault::CorruptedFromBoard), on(Fault::CorruptedToBoard));
                rig.sim.usb_corrupt(from, to);
            }
            Fault::I2cHeld => rig.sim.hold_sda(begins),
            Fault::ImuPowerCut if begins => imu(rig, now, ImuFault::PowerOff),
            Fault::ImuPowerCut => imu(rig, now, ImuFault::PowerOn),
            Fault::ImuClockCut => imu(rig, now, ImuFault::ClockCut(begins)),
            Fault::StrobeFlooded if begins => {
                let mut flood = lock(&self.flood);
                flood.next = Some(now + FLOOD);
                flood.until = ends;
                drop(flood);
                rig.sim.models_changed();
            }
            Fault::StrobeFlooded => {}
            Fault::HostKilled => {
                happened.killed = Some(now);
                self.copy_files();
            }
            Fault::HostClockStepped => self.hands.set_clock_by(self.plan.clock_step_s),
            Fault::PhoneGone | Fault::WifiStalled => {
                for phone in &mut rig.phones {
                    match (fault, begins) {
                        (Fault::WifiStalled, _) => phone.set_silent(begins),
                        (_, true) => phone.leave_network(),
                        (_, false) => phone.join_network(),
                    }
                }
            }
            Fault::DepthCameraStopped => {
                if let Some(camera) = &rig.parts().depth_camera {
                    if begins {
                        lock(camera).stop()
                    } else {
                        lock(camera).wait_for_pulses()
                    }
                }
                rig.sim.models_changed();
            }
            Fault::ResetPressed => rig.press_reset(),
            Fault::WatchdogReset => hang(rig),
            Fault::SupplyReset => {
                imu(rig, now, ImuFault::PowerOff);
                imu(rig, now + SimDuration::from_micros(500), ImuFault::PowerOn);
                rig.power_cycle();
            }
        }
    }

    /// Copies what a kill would leave: the files as the system has them.
    fn copy_files(&self) {
        let [from, to] = &self.files;
        let Ok(files) = std::fs::read_dir(from) else {
            return;
        };
        for file in files.flatten() {
            // A file that is missing in the copy is found when it is judged.
            let _ = std::fs::copy(file.path(), to.join(file.file_name()));
        }
    }
}

fn imu(rig: &mut VirtualRig, at: SimTime, fault: ImuFault) {
    if let Some(imu) = &rig.parts().imu {
        lock(imu).schedule(at, fault);
    }
    rig.sim.models_changed();
}

/// Lets a task of the board hang.
fn hang(rig: &mut VirtualRig) {
    let command = HostToDevice {
        id: u32::MAX,
        command: SelfTest {
            key: SELF_TEST_KEY,
            failure: SelfTestFailure::Stall,
        }
        .into(),
    };
    let mut buffer = [0; MAX_FRAME];
    if let Ok(frame) = encode(&command, &mut buffer) {
        rig.sim.usb_write(&[0]);
        rig.sim.usb_write(frame);
    }
}
