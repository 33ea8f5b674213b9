//! A program on embassy-stm32, clocked by the internal oscillator: 84 MHz without a
//! crystal.

use stm32f4_sim::clock::Rate;
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::sim::{FailureKind, Sim, SimError};
use stm32f4_sim::time::SimDuration;

use crate::foreign_elf;
use crate::signals::{bytes, times};

fn boot() -> Sim {
    let mut sim = Sim::builder(foreign_elf("foreign-embassy"))
        .build()
        .unwrap();
    for pin in [Pin::PC13, Pin::PB4, Pin::PA2] {
        sim.log_pin(pin);
    }
    sim.run_for(SimDuration::from_millis(10)).unwrap();
    sim
}

#[test]
fn its_clock_tree_is_what_it_programmed() {
    assert_eq!(boot().core_rate(), Rate::hz(84_000_000));
}

#[test]
fn a_task_blinks_by_the_time_driver() {
    let mut sim = boot();
    sim.run_for(SimDuration::from_millis(1_000)).unwrap();
    let blinks = times(&sim.take_edges(), Pin::PC13);
    assert!((19..=20).contains(&blinks.len()), "{blinks:?}");
    // 50 ms are 1,639 of the driver's ticks, each 2,563 periods of 84 MHz.
    let period = 1_639.0 * 2_563.0 / 84e6;
    let late = |k: usize| (blinks[k] - blinks[0]).as_secs_f64() - k as f64 * period;
    // Whoever writes to the UART lets the others wait for nine bytes.
    let bytes = 9.0 * 10.0 / 57_600.0;
    let late: Vec<f64> = (0..blinks.len()).map(late).collect();
    let allowed = late.iter().all(|s| (-10e-6..bytes + 50e-6).contains(s));
    let on_time = late.iter().filter(|s| s.abs() < 10e-6).count();
    assert!(allowed && on_time >= 15, "{late:?}");
}

#[test]
fn the_pwm_is_exact() {
    let mut sim = boot();
    sim.take_edges();
    sim.run_for(SimDuration::from_millis(20)).unwrap();
    let edges = sim.take_edges();
    let pwm: Vec<_> = edges.iter().filter(|edge| edge.0 == Pin::PB4).collect();
    assert!(pwm.len() >= 39, "{pwm:?}");
    let of = |level| pwm.iter().filter(move |edge| edge.1 == level);
    for (one, next) in of(Level::High).zip(of(Level::High).skip(1)) {
        assert_eq!((next.2 - one.2).as_nanos(), 1_000_000);
    }
    let rise = of(Level::High).next().unwrap().2;
    let fall = of(Level::Low).find(|edge| edge.2 > rise).unwrap().2;
    assert_eq!((fall - rise).as_nanos(), 250_000);
}

#[test]
fn the_uart_counts_aloud() {
    let mut sim = boot();
    sim.run_for(SimDuration::from_millis(450)).unwrap();
    let text = bytes(&sim.take_edges(), Pin::PA2, 57_600);
    let text = String::from_utf8(text).unwrap();
    assert_eq!(text, "count 0\r\ncount 1\r\ncount 2\r\ncount 3\r\n");
}

#[test]
fn a_button_wakes_a_task() {
    let mut sim = boot();
    for level in [Level::High, Level::Low, Level::High] {
        let drive = if level.is_high() {
            Drive::High
        } else {
            Drive::Low
        };
        sim.drive(Pin::PA0, drive);
        sim.run_for(SimDuration::from_millis(1)).unwrap();
        assert_eq!(sim.level(Pin::PC14), level);
    }
}

#[test]
fn a_register_that_is_not_modelled_ends_the_run() {
    let elf = foreign_elf("foreign-embassy");
    let mut sim = Sim::builder(elf).tolerate_failures().build().unwrap();
    sim.drive(Pin::PB1, Drive::High);
    let error = sim.run_for(SimDuration::from_millis(10)).unwrap_err();
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
    let elf = foreign_elf("foreign-embassy");
    let wired = |scl, sda| Sim::builder(elf.clone()).i2c_bus(scl, sda).build();
    assert!(wired(Pin::PB8, Pin::PB7).is_ok());
    let error = wired(Pin::PB7, Pin::PB6).unwrap_err().to_string();
    assert!(error.contains("those of I2C1 are [PB6, PB8]"), "{error}");
}
