use super::*;
use crate::i2c::I2cTarget;
use crate::random::Seed;
use crate::shared::Shared;
use std::sync::{Arc, Mutex};

#[derive(Default)]
struct Registers {
    pointer: Option<u8>,
    log: Vec<String>,
}

impl I2cTarget for Registers {
    fn start(&mut self, address: u8, direction: Direction, _: SimTime) -> Ack {
        self.log.push(format!("start {address:02x} {direction:?}"));
        if direction == Direction::Write {
            self.pointer = None;
        }
        if address == 0x68 { Ack::Ack } else { Ack::Nack }
    }
    fn write(&mut self, byte: u8, _: SimTime) -> Ack {
        self.log.push(format!("write {byte:02x}"));
        self.pointer = Some(byte);
        Ack::Ack
    }
    fn read(&mut self, _: SimTime) -> u8 {
        let p = self.pointer.unwrap_or(0);
        self.pointer = Some(p.wrapping_add(1));
        p
    }
    fn read_acknowledged(&mut self, ack: Ack, _: SimTime) {
        self.log.push(format!("{ack:?}"));
    }
    fn stop(&mut self, _: SimTime) {
        self.log.push("stop".into());
    }
}

struct BusBench {
    i2c: I2c,
    bus: I2cBus,
    now: SimTime,
    target: Shared<Registers>,
}

impl BusBench {
    fn new() -> Self {
        let target = Arc::new(Mutex::new(Registers::default()));
        let mut bus = I2cBus::default();
        bus.add(Box::new(target.clone()));
        let mut i2c = I2c::new(BusErrors {
            random: Seed(1).stream(15u64),
            probability: 0.0,
        });
        i2c.set_clock(Rate::hz(24_000_000));
        i2c.write(0x1c, (1 << 15) | 20, SimTime::ZERO);
        i2c.write(0x00, CR1_PE, SimTime::ZERO);
        Self {
            i2c,
            bus,
            now: SimTime::ZERO,
            target,
        }
    }
    /// Lets the wires do their next thing.
    fn go(&mut self) {
        assert_ne!(
            self.i2c.next_event(),
            SimTime::NEVER,
            "{:?}",
            self.i2c.phase
        );
        self.now = self.i2c.next_event();
        self.i2c.advance(self.now, &mut self.bus, 0);
    }
    fn sr1(&mut self) -> u32 {
        self.i2c.read(0x14, self.now, &mut self.bus).unwrap()
    }
    fn sr2(&mut self) -> u32 {
        self.i2c.read(0x18, self.now, &mut self.bus).unwrap()
    }
}

#[test]
fn reads_a_register_by_polling() {
    let mut b = BusBench::new();
    b.i2c.write(0x00, CR1_PE | CR1_START, b.now);
    b.go();
    assert_eq!(b.sr1(), SR1_SB);
    b.i2c.write(0x10, 0xd0, b.now);
    let begun = b.now;
    b.go();
    // Nine bits at 400 kHz: 22.5 us.
    assert_eq!((b.now - begun).as_nanos(), 22_500);
    assert_eq!(b.sr1() & SR1_ADDR, SR1_ADDR);
    assert_eq!(b.sr2(), SR2_MSL | SR2_BUSY | SR2_TRA);
    assert_eq!(b.sr1(), SR1_TXE);
    b.i2c.write(0x10, 0x3b, b.now);
    b.go();
    assert_eq!(b.sr1() & SR1_BTF, SR1_BTF);
    b.i2c.write(0x00, CR1_PE | CR1_START | CR1_ACK, b.now);
    b.go();
    assert_eq!(b.sr1(), SR1_SB);
    b.i2c.write(0x10, 0xd1, b.now);
    b.go();
    b.sr1();
    b.sr2();
    b.go();
    assert_eq!(b.sr1() & SR1_RXNE, SR1_RXNE);
    // One byte is in the shift register already: the last one is not acknowledged.
    b.i2c.write(0x00, CR1_PE, b.now);
    assert_eq!(b.i2c.read(0x10, b.now, &mut b.bus), Some(0x3b));
    b.go();
    b.i2c.write(0x00, CR1_PE | CR1_STOP, b.now);
    assert_eq!(b.i2c.read(0x10, b.now, &mut b.bus), Some(0x3c));
    b.go();
    assert_eq!(b.sr2(), 0);
    assert_eq!(
        crate::shared::lock(&b.target).log,
        [
            "start 68 Write",
            "write 3b",
            "start 68 Read",
            "Ack",
            "Nack",
            "stop"
        ]
    );
}

#[test]
fn an_absent_target_is_an_acknowledge_failure() {
    let mut b = BusBench::new();
    b.i2c.write(0x00, CR1_PE | CR1_START, b.now);
    b.go();
    b.i2c.write(0x10, 0x20, b.now);
    b.go();
    assert_eq!(b.sr1(), SR1_AF);
    b.i2c.write(0x14, !SR1_AF & 0xffff, b.now);
    assert_eq!(b.sr1(), 0);
    b.i2c.write(0x00, CR1_PE | CR1_STOP, b.now);
    b.go();
    assert_eq!(b.sr2(), 0);
}

/// An error is reported, and the transfer goes on.
#[test]
fn a_spurious_bus_error_is_a_flag_and_an_interrupt() {
    let mut b = BusBench::new();
    b.i2c.bus_errors.probability = 1.0;
    b.i2c.write(0x04, CR2_ITERREN, b.now);
    b.i2c.write(0x00, CR1_PE | CR1_START, b.now);
    b.go();
    assert_eq!((b.sr1(), b.i2c.irq().1), (SR1_SB, false), "no byte yet");
    b.i2c.write(0x10, 0xd0, b.now);
    b.go();
    assert_eq!(b.sr1(), SR1_ADDR | SR1_BERR);
    assert!(b.i2c.irq().1);
    b.i2c.write(0x14, !SR1_BERR & 0xffff, b.now);
    assert_eq!(b.sr2(), SR2_MSL | SR2_BUSY | SR2_TRA);
    assert_eq!((b.sr1(), b.i2c.irq().1), (SR1_TXE, false));
    assert_eq!(b.i2c.reported, 1);
}

#[test]
fn a_stuck_bus_gives_no_start_until_it_is_free() {
    let mut b = BusBench::new();
    b.bus.hold_sda(true);
    b.i2c.write(0x00, CR1_PE | CR1_START, b.now);
    b.go();
    assert_eq!(b.i2c.next_event(), SimTime::NEVER);
    assert_eq!(b.sr1(), 0);
    assert_eq!(b.sr2(), SR2_BUSY);
    b.bus.hold_sda(false);
    b.i2c.bus_released(b.now);
    b.go();
    assert_eq!(b.sr1(), SR1_SB);
}
