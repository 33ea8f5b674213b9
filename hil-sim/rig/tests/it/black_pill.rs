//! The firmware of the WeAct Black Pill on a simulated STM32F411CE: what the tests of the
//! STM32F4DISCOVERY hold in length, in short.

use crate::board_host::{Board, GNSS, train};
use crate::trigger::check_train;
use protocol::*;
use rig::wiring::{self, BoardKind};
use stm32f4_sim::pin::Pin;
use stm32f4_sim::sim::{Part, SimBuilder, SimError};
use stm32f4_sim::time::SimDuration;

fn black_pill() -> SimBuilder {
    wiring::board_of(BoardKind::BlackPill, None)
}

#[test]
fn it_boots_keeps_time_and_reports_its_model() {
    let mut board = Board::boot(black_pill());
    assert_eq!(board.hellos[0].board, BoardModel::BlackPill);
    // It takes its power from the bus.
    assert_eq!(board.rig.usb_device().attributes, 0x80);
    assert!(!BoardModel::BlackPill.has_outputs());
    // 25 MHz through the PLL are the same ticks as 8 MHz are.
    let (sim_before, before) = (board.rig.now(), board.now());
    board.run(3_000);
    let (sim_after, after) = (board.rig.now(), board.now());
    let counted = (after - before).as_secs_f64();
    let elapsed = (sim_after - sim_before).as_secs_f64();
    assert!((counted - elapsed).abs() < 1e-3, "{counted} of {elapsed}");
    let status = board.next_status();
    assert_eq!(status.dropped, Dropped::default());
    // Its temperature sensor is on another channel.
    let warm = f64::from(status.die_decidegrees.unwrap()) / 10.0;
    assert!((warm - 36.0).abs() < 0.8, "{warm}");

    board.check_stacks([0x2000_0000, 0x2000_5000, 0x2000_8000]);

    board.unplug_and_plug(1_000);
    assert!(board.ask(Ping { host_time: 1 }).is_ok());
}

#[test]
fn its_trigger_is_exact_and_its_light_is_a_fault() {
    let mut board = Board::boot(black_pill());
    board.rig.log_pin(Pin::PA5);
    let period = Period::from_picos(33_330_652_540).unwrap();
    let first = board.start(train(period, 576)).next_edge;
    board.run(5_000);
    let pulses = check_train(&mut board, first, period, 576);
    assert!(pulses > 148, "{pulses}");
    assert_eq!(board.pulses.len(), pulses);
    // There is no IMU, so the LED on the board, which is lit by a low pin, is on.
    assert!(!board.rig.level(Pin::PC13).is_high());
    assert_eq!(board.next_status().imu.state, ImuState::Failed);
}

#[test]
fn commands_for_what_it_lacks_are_refused() {
    let mut board = Board::boot(black_pill());
    let refused = Refusal::NotOnThisBoard;
    for output in Output::AUXILIARY {
        assert_eq!(board.ask(QueryTrigger(output)), Err(refused));
        assert_eq!(board.ask(StopTrigger(output)), Err(refused));
        let start = train(Period::from_ticks(TICK_HZ / 30), MIN_OUTPUT_WIDTH);
        assert_eq!(board.ask(StartTrigger { output, start }), Err(refused));
    }
    assert_eq!(board.ask(StartGnss(GNSS)), Err(refused));
    assert!(board.ask(QueryTrigger(Output::Camera)).is_ok());
}

/// The chip's model tells the two apart: the firmware of the other board has its stack where
/// an STM32F411 has no memory.
#[test]
fn the_firmware_of_the_discovery_ends_on_this_chip() {
    let mut rig = wiring::board()
        .chip(|chip| chip.part = Part::Stm32f411ce)
        .build()
        .unwrap();
    let error = rig.run_for(SimDuration::from_secs(1)).unwrap_err();
    let SimError::Failed(_) = &error else {
        panic!("{error}");
    };
}
