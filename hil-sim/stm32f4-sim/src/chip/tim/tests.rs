mod against_rsemu;

use super::*;

const TICK_NS_48: u64 = 1_386_000; // units of one 48 MHz period

fn at(tick: u64) -> SimTime {
    SimTime::from_units(tick * TICK_NS_48)
}

/// Clocks of the synchroniser in these tests.
const SYNC: u64 = 2;

fn running() -> Tim {
    running_with(SYNC)
}

fn running_with(synchroniser: u64) -> Tim {
    let mut t = Tim::new(true, false, synchroniser);
    t.set_clock(Rate::hz(48_000_000), SimTime::ZERO);
    t.write(0x14, 1, at(0));
    t.write(0x10, 0, at(0));
    t.write(0x00, 1, at(0));
    t
}

/// The synchroniser's clocks and the filter's samples, whenever within its clock the
/// edge comes.
#[test]
fn an_edge_is_captured_after_synchroniser_and_filter() {
    for synchroniser in [0, 2, 3] {
        for (icf, samples) in [(0, 0), (1, 2), (2, 4), (3, 8)] {
            for fraction in [0, 1, TICK_NS_48 / 2, TICK_NS_48 - 1] {
                let mut t = running_with(synchroniser);
                t.write(0x18, (1 << 8) | (icf << 12), at(0)); // CC2S = TI2, IC2F
                t.write(0x20, 1 << 4, at(0));
                let edge = SimTime::from_units(at(777).units() + fraction);
                t.input_edge(1, true, edge);
                let latched = 777 + synchroniser + samples;
                if latched > 777 {
                    t.sync(SimTime::from_units(at(latched).units() - 1));
                    assert_eq!(t.sr & 4, 0, "not yet");
                }
                t.sync(at(latched).max(edge));
                assert_eq!(t.sr & 4, 4);
                assert_eq!(u64::from(t.read(0x38, at(900)).unwrap()), latched);
            }
        }
    }
}

#[test]
fn the_filter_takes_no_excursion_that_is_too_short() {
    let mut t = running();
    t.write(0x1c, 1 | (3 << 4), at(0)); // CC3S = TI3, IC3F = 3
    t.write(0x20, 0xb << 8, at(0)); // both edges
    // Seven samples high, then a rise that stays, with seven low in it.
    for (rising, tick) in [
        (true, 100),
        (false, 107),
        (true, 200),
        (false, 300),
        (true, 307),
    ] {
        t.input_edge(2, rising, at(tick));
    }
    assert_eq!(t.next_event(), SimTime::NEVER);
    assert_eq!(t.read(0x3c, at(400)).unwrap(), 210);
    assert_eq!(
        t.read(0x10, at(400)).unwrap() & 0x808,
        0,
        "nothing else came"
    );
    // Eight are enough.
    t.input_edge(2, false, at(500));
    t.input_edge(2, true, at(508));
    assert_eq!(t.read(0x3c, at(511)).unwrap(), 510);
    assert_eq!(t.read(0x3c, at(600)).unwrap(), 518);
}

#[test]
fn a_filter_that_divides_the_clock_is_not_modelled() {
    let mut t = running();
    assert!(!t.write(0x18, 1 | (4 << 4), at(0)));
    // As an output the same bits are its mode.
    assert!(t.write(0x18, 6 << 4, at(0)));
}

#[test]
fn a_match_asks_for_a_transfer_until_it_is_served() {
    let mut t = running();
    t.write(0x34, 1000, at(0));
    t.sync(at(1001));
    assert_eq!(t.requests(), 0, "not enabled");
    t.write(0x0c, 0x200, at(1001)); // CC1DE
    t.write(0x34, 2000, at(1001));
    assert_eq!(t.next_event(), at(2000));
    t.sync(at(2000));
    t.write(0x10, 0, at(2000));
    assert_eq!(t.requests(), 1, "the flag has no part in it");
    t.acknowledge(0);
    assert_eq!(t.requests(), 0);
}

/// RM0090 18.4.6, CC1G: the counter is captured, and CC1OF tells that a flag stood.
#[test]
fn software_captures_too_and_flags_a_lost_one() {
    let mut t = running();
    t.write(0x18, 1, at(0)); // CC1S = TI1
    t.write(0x14, 2, at(300));
    assert_eq!(t.read(0x10, at(300)).unwrap() & 0x202, 0x002);
    t.write(0x14, 2, at(450));
    assert_eq!(t.read(0x10, at(450)).unwrap() & 0x202, 0x202);
    assert_eq!(t.read(0x34, at(460)).unwrap(), 450);
}

#[test]
fn a_slave_starts_with_its_master() {
    let mut slave = Tim::new(false, true, SYNC);
    slave.set_clock(Rate::hz(96_000_000), SimTime::ZERO);
    assert_eq!(slave.awaits(), None);
    slave.write(0x08, 0x16, at(5)); // TS = ITR1, SMS = trigger mode
    assert_eq!(slave.awaits(), Some(1));
    assert_eq!(slave.read(0x24, at(900)).unwrap(), 0);
    slave.trigger(at(1_000));
    assert_eq!(slave.awaits(), None);
    // Two clocks of 96 MHz are one of 48.
    assert_eq!(slave.read(0x24, at(1_001)).unwrap(), 0);
    assert_eq!(slave.read(0x24, at(1_002)).unwrap(), 2);
    let wrap = 65_536 / 2;
    assert_eq!(slave.read(0x24, at(1_001 + wrap - 1)).unwrap(), 65_534);
    assert_eq!(slave.read(0x24, at(1_001 + wrap)).unwrap(), 0);
}
