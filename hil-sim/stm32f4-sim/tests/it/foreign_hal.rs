//! A program on stm32f4xx-hal with a crystal of 25 MHz: 168 MHz, and a USB serial port
//! by usb-device and synopsys-usb-otg.

use stm32f4_sim::clock::Rate;
use stm32f4_sim::pin::{Drive, Pin};
use stm32f4_sim::sim::{FailureKind, Sim, SimBuilder, SimError};
use stm32f4_sim::time::SimDuration;
use stm32f4_sim::usb::UsbState;

use crate::foreign_elf;

/// As much as the program's serial port holds.
const CHUNK: usize = 128;

fn board() -> SimBuilder {
    Sim::builder(foreign_elf("foreign-hal")).crystal(Rate::hz(25_000_000))
}

/// Booted, with its port open.
fn boot() -> Sim {
    let mut sim = board().build().unwrap();
    let ready = sim.run_until_usb_ready(SimDuration::from_secs(3)).unwrap();
    assert!(ready, "no USB: {:?}", sim.usb_log());
    sim.usb_open(true);
    sim
}

/// Sends bytes and returns what comes back.
fn echo(sim: &mut Sim, bytes: &[u8]) -> Vec<u8> {
    let mut back = Vec::new();
    for chunk in bytes.chunks(CHUNK) {
        let wanted = back.len() + chunk.len();
        sim.usb_write(chunk);
        sim.run_until(SimDuration::from_millis(100), |sim| {
            back.extend(sim.usb_read());
            back.len() >= wanted
        })
        .unwrap();
    }
    back
}

#[test]
fn its_clock_tree_is_what_it_programmed() {
    let sim = boot();
    assert_eq!(sim.core_rate(), Rate::hz(168_000_000));
    let device = sim.usb_device();
    assert_eq!((device.vendor, device.product), (0x1209, 0x0001));
}

#[test]
fn without_its_crystal_it_waits_for_ever() {
    let elf = foreign_elf("foreign-hal");
    let mut sim = Sim::builder(elf).build().unwrap();
    let ready = sim.run_until_usb_ready(SimDuration::from_millis(500));
    assert!(!ready.unwrap());
    assert_eq!(sim.core_rate(), Rate::hz(16_000_000));
}

#[test]
fn the_serial_port_answers_and_does_after_the_cable_was_pulled() {
    let mut sim = boot();
    assert_eq!(echo(&mut sim, b"Hello, World 1"), b"hELLO, wORLD 1");
    let long: Vec<u8> = (0..20_000u32).map(|n| b'a' + (n * n % 26) as u8).collect();
    assert!(echo(&mut sim, &long) == long.to_ascii_uppercase());

    sim.usb_unplug();
    sim.run_for(SimDuration::from_millis(50)).unwrap();
    assert_ne!(sim.usb_state(), UsbState::Ready);
    sim.usb_plug();
    let ready = sim.run_until_usb_ready(SimDuration::from_secs(3));
    assert!(ready.unwrap(), "no USB: {:?}", sim.usb_log());
    sim.usb_open(true);
    assert_eq!(echo(&mut sim, b"two"), b"TWO");
}

#[test]
fn the_timer_blinks_every_20_ms() {
    let mut sim = board().build().unwrap();
    sim.log_pin(Pin::PD13);
    sim.run_for(SimDuration::from_millis(510)).unwrap();
    let blinks: Vec<_> = sim.take_edges().iter().map(|edge| edge.2).collect();
    assert!((24..=25).contains(&blinks.len()), "{blinks:?}");
    // The handler may wait for the other one.
    for pair in blinks.windows(2) {
        let apart = (pair[1] - pair[0]).as_nanos();
        assert!(apart.abs_diff(20_000_000) < 50_000, "{apart} ns");
    }
}

#[test]
fn a_register_that_is_not_modelled_ends_the_run() {
    let mut sim = board().tolerate_failures().build().unwrap();
    sim.drive(Pin::PA0, Drive::High);
    let error = sim.run_for(SimDuration::from_millis(50)).unwrap_err();
    let SimError::Failed(failure) = &error else {
        panic!("{error}");
    };
    assert_eq!(failure.kind, FailureKind::Unmodelled);
    let text = error.to_string();
    let register = "it reads CRC_DR at 0x40023000, which is not modelled";
    assert!(text.contains(register), "{text}");
    assert!(text.contains("read_checksum"), "{text}");
}

#[test]
fn an_i2c_bus_is_wired_to_its_pins_or_not_at_all() {
    let wired = |scl, sda| board().i2c_bus(scl, sda).build();
    assert!(wired(Pin::PB8, Pin::PB7).is_ok());
    let error = wired(Pin::PB7, Pin::PB6).unwrap_err().to_string();
    assert!(error.contains("those of I2C1 are [PB6, PB8]"), "{error}");
}
