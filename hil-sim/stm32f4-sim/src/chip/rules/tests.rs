//! Each rule, kept and broken, by the registers that a firmware would write.

use super::*;
use crate::chip::part::Part;
use crate::chip::{ChipConfig, I2cWires};
use crate::clock::Rate;
use crate::random::Seed;
use crate::time::SimDuration;

const RCC_AHB1ENR: u32 = 0x4002_3830;
const RCC_APB1ENR: u32 = 0x4002_3840;
const GPIOB_MODER: u32 = 0x4002_0400;
const GPIOB_AFRL: u32 = 0x4002_0420;
const I2C1_CR1: u32 = 0x4000_5400;
const I2C1_CR2: u32 = 0x4000_5404;
const I2C1_DR: u32 = 0x4000_5410;
const I2C1_CCR: u32 = 0x4000_541c;
const DMA1_LIFCR: u32 = 0x4002_6008;
/// Stream 0 of DMA1.
const S0CR: u32 = 0x4002_6010;
const S0NDTR: u32 = 0x4002_6014;
const S0M0AR: u32 = 0x4002_601c;
/// Channel 2, words, to the peripheral, enabled.
const S0_ENABLED: u32 = (2 << 25) | (2 << 13) | (2 << 11) | (1 << 6) | 1;
const TIM4_DIER: u32 = 0x4000_080c;
const TIM4_EGR: u32 = 0x4000_0814;
const PE: u32 = 1;
const START: u32 = 1 << 8;
const STOP: u32 = 1 << 9;
const SWRST: u32 = 1 << 15;

pub(in crate::chip) fn chip() -> Soc {
    chip_of(Revision::Y)
}

fn chip_of(revision: Revision) -> Soc {
    chip_like(Part::Stm32f407vg, revision)
}

fn chip_like(part: Part, revision: Revision) -> Soc {
    Soc::new(
        Seed(1),
        &ChipConfig {
            part,
            crystal: Some(Rate::hz(8_000_000)),
            i2c: Some(I2cWires {
                scl: Pin::PB6,
                sda: Pin::PB7,
            }),
            bus_errors: 0.0,
            synchroniser: 2,
            revision,
            broken_rng: false,
            die: Default::default(),
            shortest_detach: crate::time::SimDuration::ZERO,
        },
    )
}

/// An STM32F411 has no random number generator: a touch ends the run and says so.
#[test]
fn a_peripheral_that_the_chip_does_not_have_ends_the_run() {
    const RNG_CR: u32 = 0x5006_0800;
    let mut small = chip_like(Part::Stm32f411ce, Revision::Y);
    write(&mut small, &[(0x4002_3834, 1 << 6)]);
    assert_eq!(small.end.take(), None);
    small.read_register(RNG_CR);
    let end = small.end.take().unwrap();
    assert_eq!(end, End::Absent { address: RNG_CR });
    let text = end.to_string();
    assert!(
        text.contains("RNG_CR") && text.contains("does not have"),
        "{text}"
    );
    small.write_register(RNG_CR, 0);
    assert_eq!(small.end.take(), Some(End::Absent { address: RNG_CR }));
    assert_eq!(small.read_register(0xe004_2000), Some(0x1000_6431));

    let mut large = chip();
    write(&mut large, &[(0x4002_3834, 1 << 6)]);
    large.read_register(RNG_CR);
    assert_eq!(large.end.take(), None);
}

/// Writes registers one after the other, far enough apart for any clock to come up.
pub(in crate::chip) fn write(soc: &mut Soc, writes: &[(u32, u32)]) {
    for &(address, value) in writes {
        soc.write_register(address, value);
        pass(soc, 1);
    }
}

fn pass(soc: &mut Soc, micros: u64) {
    let until = soc.now() + SimDuration::from_micros(micros);
    let cycle = soc.cycle_at(until);
    soc.at_cycle(cycle);
}

fn broken(soc: &mut Soc) -> Option<Rule> {
    match soc.end.take() {
        Some(End::Forbidden(rule)) => Some(rule),
        None => None,
        other => panic!("{other:?}"),
    }
}

/// I2C1 on PB6 and PB7, enabled, at 16 MHz / (2 · 80) = 100 kHz.
fn with_i2c() -> Soc {
    let mut soc = chip();
    write(
        &mut soc,
        &[
            (RCC_AHB1ENR, 1 << 1),
            (RCC_APB1ENR, 1 << 21),
            (GPIOB_AFRL, 0x4400_0000),
            (GPIOB_MODER, 0x0000_a280),
            (I2C1_CR2, 16),
            (I2C1_CCR, 80),
            (I2C1_CR1, PE),
        ],
    );
    assert_eq!(broken(&mut soc), None);
    soc
}

#[test]
fn cr1_of_the_i2c_is_left_alone_while_a_stop_is_pending() {
    // Nobody answers at address 0x20: a stop is due.
    let addressed = || {
        let mut soc = with_i2c();
        write(&mut soc, &[(I2C1_CR1, PE | START)]);
        pass(&mut soc, 20);
        soc.write_register(I2C1_DR, 0x40);
        pass(&mut soc, 200);
        soc.write_register(I2C1_CR1, PE | STOP);
        assert_eq!(broken(&mut soc), None);
        soc
    };
    let mut soc = addressed();
    soc.write_register(I2C1_CR1, PE | START);
    assert_eq!(broken(&mut soc), Some(Rule::I2cPending));

    // With patience, or by the reset of a bus that hangs.
    let mut soc = addressed();
    pass(&mut soc, 100);
    soc.write_register(I2C1_CR1, PE | START);
    assert_eq!(broken(&mut soc), None);
    // Now the start is pending.
    soc.write_register(I2C1_CR1, PE | START);
    assert_eq!(broken(&mut soc), Some(Rule::I2cPending));
    soc.write_register(I2C1_CR1, SWRST);
    assert_eq!(broken(&mut soc), None);
}

#[test]
fn the_i2c_needs_its_pins() {
    for (register, value, pin) in [
        (GPIOB_AFRL, 0x4500_0000, Pin::PB6),
        (GPIOB_MODER, 0x0000_2280, Pin::PB7),
    ] {
        let mut soc = with_i2c();
        write(&mut soc, &[(register, value), (I2C1_CR1, PE | START)]);
        let rule = Rule::Pin {
            pin,
            function: 4,
            peripheral: "I2C1",
        };
        assert_eq!(broken(&mut soc), Some(rule));
    }
}

/// DMA1's stream 0 serves TIM4's channel 1, once.
fn with_dma(memory: u32) -> Soc {
    let mut soc = chip();
    write(
        &mut soc,
        &[
            (RCC_AHB1ENR, 1 << 21),
            (RCC_APB1ENR, 1 << 2),
            (S0CR + 8, TIM4_EGR + 0x20),
            (S0M0AR, memory),
            (S0NDTR, 1),
            (S0CR, S0_ENABLED & !1),
            (S0CR, S0_ENABLED),
        ],
    );
    soc
}

#[test]
fn a_stream_is_enabled_with_its_flags_cleared() {
    for cleared in [true, false] {
        let mut soc = with_dma(0x2000_0000);
        assert_eq!(broken(&mut soc), None);
        write(&mut soc, &[(TIM4_DIER, 0x200), (TIM4_EGR, 2)]);
        pass(&mut soc, 5);
        // The one item is done and the stream off.
        assert_eq!(soc.read_register(S0CR).unwrap() & 1, 0);
        if cleared {
            write(&mut soc, &[(DMA1_LIFCR, 0x3d)]);
        }
        write(&mut soc, &[(S0NDTR, 1), (S0CR, S0_ENABLED)]);
        let rule = Rule::DmaEnabled {
            controller: 1,
            stream: 0,
            wrong: EnabledWrongly::WithFlags,
        };
        assert_eq!(broken(&mut soc), (!cleared).then_some(rule));
    }
}

#[test]
fn a_stream_is_set_up_before_it_is_enabled() {
    let mut soc = with_dma(0x2000_0000);
    write(
        &mut soc,
        &[
            (S0CR, 0),
            (DMA1_LIFCR, 0x3d),
            (S0NDTR, 1),
            (S0CR, S0_ENABLED),
        ],
    );
    let rule = Rule::DmaEnabled {
        controller: 1,
        stream: 0,
        wrong: EnabledWrongly::WhileSetUp,
    };
    assert_eq!(broken(&mut soc), Some(rule));
}

#[test]
fn a_stream_reaches_no_core_coupled_memory() {
    let mut soc = with_dma(0x1000_0000);
    let rule = Rule::DmaMemory {
        address: 0x1000_0000,
    };
    assert_eq!(broken(&mut soc), Some(rule));
}

/// The item is read when the stream is enabled, not when it is asked for, and it reaches
/// the register that the stream was given.
#[test]
fn a_timer_has_its_register_written() {
    let mut soc = with_dma(0x2000_0000);
    soc.mem.write32(0x2000_0000, 77);
    write(
        &mut soc,
        &[
            (S0CR, S0_ENABLED & !1),
            (DMA1_LIFCR, 0x3d),
            (S0NDTR, 1),
            (S0CR, S0_ENABLED),
        ],
    );
    soc.mem.write32(0x2000_0000, 99);
    write(&mut soc, &[(TIM4_DIER, 0x200), (TIM4_EGR, 2)]);
    pass(&mut soc, 5);
    assert_eq!(soc.read_register(TIM4_EGR + 0x20), Some(77), "TIM4_CCR1");
    // This request is served only once the stream is enabled again.
    write(&mut soc, &[(TIM4_EGR, 2), (DMA1_LIFCR, 0x3d)]);
    pass(&mut soc, 5);
    assert_eq!(soc.read_register(TIM4_EGR + 0x20), Some(77));
    write(&mut soc, &[(S0NDTR, 1), (S0CR, S0_ENABLED)]);
    pass(&mut soc, 5);
    assert_eq!(soc.read_register(TIM4_EGR + 0x20), Some(99));
    assert_eq!(broken(&mut soc), None);
}

#[test]
fn a_peripheral_needs_its_clock_and_the_clock_its_time() {
    let mut soc = chip();
    soc.read_register(TIM4_DIER);
    let unclocked = Rule::Unclocked { address: TIM4_DIER };
    assert_eq!(broken(&mut soc), Some(unclocked));

    soc.write_register(RCC_APB1ENR, 1 << 2);
    soc.write_register(TIM4_DIER, 1);
    let early = Rule::ClockOnItsWay { address: TIM4_DIER };
    assert_eq!(broken(&mut soc), Some(early));
    // Read back, or some cycles later.
    soc.read_register(RCC_APB1ENR);
    soc.write_register(TIM4_DIER, 1);
    soc.write_register(RCC_AHB1ENR, 1 << 21);
    pass(&mut soc, 1);
    soc.read_register(S0CR);
    assert_eq!(broken(&mut soc), None);
}

const RCC_CR: u32 = 0x4002_3800;
const RCC_PLLCFGR: u32 = 0x4002_3804;
const RCC_CFGR: u32 = 0x4002_3808;
const FLASH_ACR: u32 = 0x4002_3c00;
const PLLON: u32 = 1 << 24;

/// The PLL from the internal 16 MHz: M, N, P as its register has it, Q = 4.
fn pll(soc: &mut Soc, m: u32, n: u32, p: u32) {
    let config = m | (n << 6) | (p << 16) | (4 << 24);
    write(soc, &[(RCC_PLLCFGR, config), (RCC_CR, 0x81 | PLLON)]);
    pass(soc, 200);
}

#[test]
fn the_pll_stays_within_its_range() {
    for (m, n, what) in [
        (8, 96, None),
        (16, 100, None),
        (16, 99, Some("the PLL's oscillator")),
        (8, 217, Some("the PLL's oscillator")),
        (7, 96, Some("the PLL's input")),
        (17, 192, Some("the PLL's input")),
    ] {
        let mut soc = chip();
        pll(&mut soc, m, n, 0);
        let broken = broken(&mut soc).map(|rule| match rule {
            Rule::Clock { what, .. } => what,
            other => panic!("{other:?}"),
        });
        assert_eq!(broken, what, "M {m}, N {n}");
    }
}

#[test]
fn the_flash_and_the_buses_keep_up_with_the_core() {
    // 96 MHz: three wait states.
    for (states, enough) in [(2, false), (3, true)] {
        let mut soc = chip();
        pll(&mut soc, 8, 96, 0);
        write(
            &mut soc,
            &[(FLASH_ACR, states), (RCC_CFGR, 2 | (5 << 10) | (4 << 13))],
        );
        let rule = Rule::FlashLatency {
            hz: 96_000_000,
            states,
        };
        assert_eq!(broken(&mut soc), (!enough).then_some(rule));
    }
    // Taken away later.
    let mut soc = chip();
    pll(&mut soc, 8, 96, 0);
    write(
        &mut soc,
        &[(FLASH_ACR, 3), (RCC_CFGR, 2 | (5 << 10)), (FLASH_ACR, 1)],
    );
    assert!(matches!(
        broken(&mut soc),
        Some(Rule::Clock {
            what: "PCLK2",
            hz: 96_000_000,
            ..
        })
    ));
    write(&mut soc, &[(RCC_CFGR, 2 | (5 << 10) | (4 << 13))]);
    assert!(matches!(
        broken(&mut soc),
        Some(Rule::FlashLatency { states: 1, .. })
    ));
}

#[test]
fn revision_a_does_not_prefetch() {
    for (revision, breaks) in [(Revision::A, true), (Revision::Y, false)] {
        let mut soc = chip_of(revision);
        write(&mut soc, &[(FLASH_ACR, 0x700)]);
        assert_eq!(broken(&mut soc), breaks.then_some(Rule::Prefetch));
    }
}

#[test]
fn a_sleep_is_safe_at_some_addresses_or_without_debug_or_prefetch() {
    for (debug, acr, address, breaks) in [
        (7, 0x700, 0x0800_1234, true),
        (7, 0x700, 0x0800_123e, true),
        (7, 0x700, 0x0800_1230, false),
        (7, 0x700, 0x0800_123a, false),
        (6, 0x700, 0x0800_1234, false),
        (7, 0x600, 0x0800_1234, false),
    ] {
        let mut soc = chip();
        write(&mut soc, &[(FLASH_ACR, acr), (DBGMCU_CR, debug)]);
        soc.require_safe_sleep(address);
        assert_eq!(broken(&mut soc), breaks.then_some(Rule::Wfi { address }));
    }
}

#[test]
fn usb_needs_its_pins_and_keeps_to_its_fifos() {
    const RCC_AHB2ENR: u32 = 0x4002_3834;
    const OTG_FS: u32 = 0x5000_0000;
    let powered = |function: u32| {
        let mut soc = chip();
        write(
            &mut soc,
            &[
                (RCC_AHB1ENR, 1),
                (RCC_AHB2ENR, 1 << 7),
                (0x4002_0024, function << 12 | function << 16),
                (0x4002_0000, 0xa800_0000 | 2 << 22 | 2 << 24),
                // No VBUS sensing; the transceiver's power.
                (OTG_FS + 0x38, 1 << 21 | 1 << 16),
            ],
        );
        soc
    };
    assert_eq!(broken(&mut powered(10)), None);
    let rule = Rule::Pin {
        pin: Pin::PA11,
        function: 10,
        peripheral: "OTG_FS",
    };
    assert_eq!(broken(&mut powered(1)), Some(rule));

    // A transmit FIFO of 16 words.
    let mut soc = powered(10);
    write(&mut soc, &[(OTG_FS + 0x28, 16 << 16 | 128)]);
    for _ in 0..16 {
        soc.write_register(OTG_FS + 0x1000, 0);
    }
    assert_eq!(broken(&mut soc), None);
    soc.write_register(OTG_FS + 0x1000, 0);
    assert_eq!(broken(&mut soc), Some(Rule::Fifo { endpoint: 0 }));
    // One that is not there.
    let mut soc = powered(10);
    write(&mut soc, &[(OTG_FS + 0x28, 16 << 16 | 310)]);
    soc.write_register(OTG_FS + 0x1000, 0);
    assert_eq!(broken(&mut soc), Some(Rule::Fifo { endpoint: 0 }));
}
