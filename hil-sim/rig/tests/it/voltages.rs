//! Voltages at the board's pins and at a camera's input: what the pages draw, at the worst corners.

use crate::board_host::Board;
use protocol::pins::PINS;
use rig::wiring::{self, BoardKind};
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Pin};
use stm32f4_sim::sim::SimError;
use stm32f4_sim::time::SimDuration;

const WIRING: &str = include_str!("../../../../docs/wiring.md");
const PARTS: &str = include_str!("../../../../docs/parts.md");

/// Supplies of the boards: behind the diode of an STM32F4DISCOVERY, and of a Black Pill.
const DISCOVERY: [f64; 2] = [2.85, 3.05];
const BLACK_PILL: [f64; 2] = [3.2, 3.4];

/// Part of a resistor by which it may be off.
const TOLERANCE: f64 = 0.05;
/// The chip's own pull-down, at its strongest (DS8626 table 47).
const PULL_DOWN: f64 = 30_000.0;
/// Voltage by which a loaded output may be below the supply (DS8626 table 48).
const OUTPUT_DROP: f64 = 0.4;

/// Rows of the table that begins with this, each as its cells.
fn rows<'a>(page: &'a str, head: &str) -> Vec<Vec<&'a str>> {
    let lines = page.lines().skip_while(|line| !line.starts_with(head));
    let rows = lines.skip(2).take_while(|line| line.starts_with('|'));
    rows.map(|row| row.split('|').map(str::trim).skip(1).collect())
        .collect()
}

fn numbers<const N: usize>(text: &str) -> [f64; N] {
    let found: Vec<f64> = (text.split(' '))
        .filter_map(|word| word.parse().ok())
        .collect();
    found.try_into().unwrap_or_else(|_| panic!("{text}"))
}

/// Lowest and highest level behind a divider. The chip may pull it down as well.
fn levels(supply: [f64; 2], [series, ground]: [f64; 2], is_pulled: bool) -> [f64; 2] {
    let (less, more) = (1.0 - TOLERANCE, 1.0 + TOLERANCE);
    let lowest = if is_pulled {
        1.0 / (1.0 / (ground * less) + 1.0 / PULL_DOWN)
    } else {
        ground * less
    };
    [
        supply[0] * lowest / (lowest + series * more),
        supply[1] * ground * more / (ground * more + series * less),
    ]
}

/// Each divider gives what the page says, and that is a level which its input may have, on each
/// board that it is for.
#[test]
fn dividers_give_levels_that_their_inputs_may_have() {
    let dividers = rows(WIRING, "| from | supply, V |");
    assert_eq!(dividers.len(), 4);
    for row in &dividers {
        let supply = numbers(row[1]);
        let ohms = [row[2], row[3]].map(|cell| numbers::<1>(cell)[0] * 1e3);
        let (is_output, is_input) = (row[0].starts_with("PA5"), row[4].starts_with("PA"));
        let drop = if is_output { OUTPUT_DROP } else { 0.0 };
        let found = levels([supply[0] - drop, supply[1]], ohms, is_input);
        let stated: [f64; 2] = numbers(row[5]);
        for (found, stated) in found.iter().zip(stated) {
            assert!((found - stated).abs() < 0.0051, "{row:?}: {found}");
        }
        let most = if is_input {
            // Of the board with the lowest supply; and high for that with the highest.
            [0.7 * BLACK_PILL[1], DISCOVERY[0] + 0.3]
        } else {
            [0.65 * 1.8, 1.05 * 1.8]
        };
        assert!(
            found[0] >= most[0] && found[1] <= most[1],
            "{row:?}: {most:?}"
        );
        if is_output {
            let is_discovery = row[0].ends_with("STM32F4DISCOVERY");
            assert_eq!(supply, if is_discovery { DISCOVERY } else { BLACK_PILL });
        }
        // What the table of the pins says of its input is this divider.
        for pin in row[4].split(", ").filter(|_| is_input) {
            let wired = rows(PINS, "| pin |").into_iter().find(|it| it[0] == pin);
            let said = format!("{} and {}", row[2], row[3]);
            assert!(wired.unwrap()[5].contains(&said), "{pin}: {said}");
        }
    }
}

/// Each board that can be bought has a way to each camera's level, and none of them is a divider
/// of another board.
#[test]
fn every_board_reaches_every_camera() {
    let cameras = rows(PARTS, "| camera (`setup --camera`)");
    let boards = PARTS
        .lines()
        .find(|line| line.contains("| STM32F4DISCOVERY |"));
    assert!(boards.unwrap().contains("WeAct Black Pill"));
    assert_eq!(cameras.len(), 5);
    for camera in cameras {
        let level = camera[2];
        for (volts, gate) in [("5 V", "74AHCT125"), ("1.8 V", "[divider](#dividers)")] {
            if level.contains(volts) {
                let ways = rows(WIRING, "| input | between");
                let way = ways.iter().find(|way| way[0].starts_with(volts)).unwrap();
                assert!(way[1].contains(gate), "{camera:?}");
            }
        }
        if level.contains("1.8 V") {
            for board in ["STM32F4DISCOVERY", "Black Pill"] {
                let dividers = rows(WIRING, "| from | supply, V |");
                assert!(
                    dividers.iter().any(|row| row[0].ends_with(board)),
                    "{board}"
                );
            }
        }
        // Its input takes a board's high level straight.
        if level.contains("3.3 V") {
            for [lowest, highest] in [DISCOVERY, BLACK_PILL] {
                assert!(lowest - OUTPUT_DROP >= 0.7 * 3.3 && highest <= 3.6);
            }
        }
    }
}

/// The pins that the table limits are those that the firmware has pulled in the chip.
#[test]
fn pins_that_are_pulled_are_limited_in_the_table() {
    for kind in [BoardKind::Discovery, BoardKind::BlackPill] {
        let board = Board::boot(wiring::board_of(kind, None));
        for row in rows(PINS, "| pin |") {
            let pin: Pin = row[0].parse().unwrap();
            let is_limited = row[6] == "VDD + 0.3 V";
            assert_eq!(board.rig.is_pulled(pin), is_limited, "{pin} of {kind:?}");
        }
    }
}

/// Something at the strobe input, of this voltage.
struct Event(f64);

impl PinModel for Event {
    fn name(&self) -> String {
        "an event".into()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        Vec::new()
    }

    fn outputs(&self) -> Vec<(Pin, f64)> {
        vec![(wiring::STROBE, self.0)]
    }

    fn power_on(&mut self, io: &mut PinIo<'_>) {
        io.drive(wiring::STROBE, Drive::High);
    }
}

#[test]
fn a_pulled_pin_above_its_supply_ends_the_run() {
    let run = |volts| {
        let mut rig = wiring::board().model(Event(volts)).build().unwrap();
        rig.run_for(SimDuration::from_millis(200))
    };
    run(3.1).unwrap();
    // 5 V through 1.8 kΩ and 3.3 kΩ, as this page had it, and 5 V itself.
    for volts in [3.235, 5.0] {
        let Err(SimError::Failed(failure)) = run(volts) else {
            panic!("{volts} V were taken");
        };
        let text = failure.to_string();
        assert!(text.contains("PA2 is driven to"), "{text}");
    }
}
