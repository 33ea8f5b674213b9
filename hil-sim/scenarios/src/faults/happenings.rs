//! What goes wrong in a run, done to the rig at its virtual time.

use std::sync::atomic::Ordering;

use protocol::{
    Failure as SelfTestFailure, HostToDevice, MAX_FRAME, SELF_TEST_KEY, SelfTest, encode,
};

use super::plan::Fault;
use super::scene::Scene;
use rig::imu::Fault as ImuFault;
use rig::wiring;
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Pin};
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::{SimDuration, SimTime};

/// Half a period of 100 kHz.
const FLOOD: SimDuration = SimDuration::from_micros(5);

/// Drives the strobe input at 100 kHz for a while.
#[derive(Debug, Default)]
pub(super) struct Flood {
    next: Option<SimTime>,
    until: SimTime,
    high: bool,
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

/// A fault that begins or ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    pub at: SimTime,
    pub fault: Fault,
    pub begins: bool,
    pub ends: SimTime,
}

impl Scene {
    pub(super) fn turn(&mut self, turn: &Turn) {
        let now = self.rig.now();
        let begins = turn.begins;
        if turn.fault.hits_imu() || turn.fault.is_reset() {
            self.truth.disturbed(now);
        }
        match turn.fault {
            Fault::UsbUnplugged if begins => self.rig.usb_unplug(),
            Fault::UsbUnplugged => self.rig.usb_plug(),
            Fault::HostStalled => self.rig.usb_set_reading(!begins),
            Fault::CorruptedFromBoard | Fault::CorruptedToBoard => self.corrupt(turn),
            Fault::I2cHeld => self.rig.hold_sda(begins),
            Fault::ImuPowerCut if begins => self.imu(ImuFault::PowerOff),
            Fault::ImuPowerCut => self.imu(ImuFault::PowerOn),
            Fault::ImuClockCut => self.imu(ImuFault::ClockCut(begins)),
            Fault::StrobeFlooded if begins => {
                let mut flood = lock(&self.flood);
                flood.next = Some(now + FLOOD);
                flood.until = turn.ends;
                drop(flood);
                self.rig.models_changed();
            }
            Fault::StrobeFlooded => {}
            Fault::HostKilled => {
                self.report.killed = Some(now);
                (self.on_kill)();
            }
            Fault::HostClockStepped => {
                let step = self.plan.clock_step_s;
                self.clock_step.store(step, Ordering::Relaxed);
            }
            // These have runs of their own.
            Fault::PhoneGone | Fault::WifiStalled | Fault::DiskFull | Fault::ProcessKilled => {}
            Fault::DepthCameraStopped if begins => {
                lock(&self.camera).stop();
                self.rig.models_changed();
            }
            Fault::DepthCameraStopped => {
                lock(&self.camera).wait_for_pulses();
                self.rig.models_changed();
            }
            Fault::ResetPressed => {
                self.rig.press_reset();
                self.restart(now);
            }
            Fault::WatchdogReset => self.hang(),
            Fault::SupplyReset => {
                self.imu(ImuFault::PowerOff);
                let soon = now + SimDuration::from_micros(500);
                lock(&self.sensor).schedule(soon, ImuFault::PowerOn);
                self.rig.models_changed();
                self.rig.power_cycle();
                self.restart(now);
            }
        }
    }

    fn imu(&mut self, fault: ImuFault) {
        lock(&self.sensor).schedule(self.rig.now(), fault);
        self.rig.models_changed();
    }

    fn corrupt(&mut self, turn: &Turn) {
        let now = self.rig.now();
        let zero = self.report.began;
        let on = |fault: Fault| {
            let active = self
                .plan
                .events
                .iter()
                .any(|e| e.fault == fault && e.begins(zero) <= now && now < e.ends(zero));
            let active = if turn.fault == fault {
                turn.begins
            } else {
                active
            };
            if active { self.plan.corruption_ppm } else { 0 }
        };
        let (from, to) = (on(Fault::CorruptedFromBoard), on(Fault::CorruptedToBoard));
        self.rig.usb_corrupt(from, to);
    }

    /// Lets a task of the board hang.
    fn hang(&mut self) {
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
            self.rig.usb_write(&[0]);
            self.rig.usb_write(frame);
        }
        self.expect_watchdog = true;
    }
}
