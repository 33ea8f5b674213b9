//! The real firmware on the simulated board: boot, time, link, failures.

use crate::board_host::{Board, UNITS_PER_TICK, pulses_of, train};
use crate::imu_bench::ImuBench;
use crate::trigger::check_train;

use protocol::usb::{PRODUCT_ID, VENDOR_ID, serial_number};
use protocol::*;
use rig::imu::SensorModel;
use rig::motion::Motion;
use rig::random::{Seed, Stream};
use rig::wiring::jumpers::Jumpers;
use rig::wiring::{self, BoardKind};
use stm32f4_sim::firmware::Firmware;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::sim::{Die, FailureKind, ResetCause as BoardReset, Revision, SimError};
use stm32f4_sim::time::{SimDuration, SimTime};
use stm32f4_sim::usb::{UsbCut, UsbState};

/// 30 a second.
const PERIOD: Period = Period::from_ticks(TICK_HZ / 30);

/// Transactions of an enumeration: two or three for each of the 11 requests until the port is open.
const TRANSACTIONS: usize = 34;

/// Ticks in a virtual second, as the board counts them.
const SECOND: u64 = TICK_HZ as u64;

#[test]
fn it_boots_to_hello() {
    let board = Board::boot(wiring::board());
    let hello = &board.hellos[0];
    assert_eq!(hello.protocol_version, PROTOCOL_VERSION);
    assert_eq!(hello.tick_hz, TICK_HZ);
    assert_eq!(hello.reset_cause, ResetCause::PowerOn);
    assert_eq!(hello.last_panic, None);
    // Reset, debounce, two port resets, enumeration: what an operating system takes.
    assert!(
        board.rig.now() < SimTime::from_nanos(400_000_000),
        "{}",
        board.rig.now()
    );
    let device = board.rig.usb_device();
    assert_eq!((device.vendor, device.product), (VENDOR_ID, PRODUCT_ID));
    assert_eq!(device.serial, serial_number(&hello.board_id).as_str());
    // It has power of its own.
    assert_eq!(device.attributes, 0xc0);
    assert_eq!(
        board.rig.core_rate(),
        stm32f4_sim::clock::Rate::hz(96_000_000)
    );
}

/// The clock on PA8 is for the sensors that take it, with no steeper edges than it needs.
#[test]
fn an_imu_gets_the_clock_that_it_takes() {
    const GPIOA_OSPEEDR: u32 = 0x4002_0008;
    for (model, clock) in [
        (SensorModel::Mpu9150, Some(19_200_000)),
        (SensorModel::Icm42688P, None),
    ] {
        let bench = ImuBench::on(wiring::board(), model, Motion::rest(), &[]);
        let rig = &bench.board.rig;
        let clock = clock.map(stm32f4_sim::clock::Rate::hz);
        assert_eq!(rig.clock_output(), clock, "{model:?}");
        if clock.is_some() {
            let speeds = rig.stored_register(GPIOA_OSPEEDR).unwrap();
            assert_eq!(speeds >> 16 & 3, 1, "25 MHz");
        }
    }
}

/// A crystal that stops ends the run, and the next one says so.
#[test]
fn a_crystal_that_stops_is_reported() {
    let mut board = Board::boot(wiring::board().tolerate_failures());
    board.rig.set_crystal(false);
    board.run(2_000);
    assert!(board.rig.level(Pin::PD14).is_high(), "the LED of faults");
    board.run(10_000);
    board.rig.set_crystal(true);
    let hello = next_run(&mut board);
    let message = hello.kept_panic.expect("the message of the panic");
    assert!(message.contains("the crystal has stopped"), "{message}");
}

/// A board whose supply is too low for the flash's width keeps nothing and says so.
#[test]
fn the_flash_is_not_written_with_a_low_supply() {
    let mut board = Board::boot(wiring::board().tolerate_failures());
    let settings = board.ask(QueryBoard).unwrap();
    let changed = BoardSettings {
        crystal_ppb: Some(1),
        ..settings
    };
    board.rig.set_supply(2.65);
    assert_eq!(board.ask(SetBoard(changed)), Err(Refusal::NotKept));
    self_test(&mut board, Failure::Panic);
    let hello = next_run(&mut board);
    assert!(hello.last_panic.is_some());
    assert_eq!((hello.panics, hello.kept_panic), (0, None));
    board.rig.set_supply(2.8);
    assert_eq!(board.ask(SetBoard(changed)), Ok(changed));
}

/// More than six wraps of the 32-bit counter, and a status every second.
#[test]
fn ten_minutes_of_status_in_one_continuous_time() {
    let mut board = Board::boot(wiring::board());
    board.run(600_000);
    assert!(board.rig.failures().is_empty());
    assert!(
        board.statuses.len() >= 600,
        "{} status messages",
        board.statuses.len()
    );
    let first = board.statuses[0].clone();
    for (n, pair) in board.statuses.windows(2).enumerate() {
        let (a, b) = (&pair[0], &pair[1]);
        assert_eq!(b.seq, a.seq + 1, "status {n}");
        assert_eq!(b.epoch, a.epoch);
        // A second each, to a millisecond: sent by a task, not by a timer's edge.
        let step = (b.at - a.at).unsigned_abs();
        assert!(
            step.abs_diff(SECOND) < SECOND / 1000,
            "status {n}: {step} ticks"
        );
        assert_eq!(b.dropped, Dropped::default());
        assert_eq!(b.link.lost_frames, 0);
    }
    let last = board.statuses.last().unwrap().clone();
    let wraps = (last.at.0 >> 32) - (first.at.0 >> 32);
    assert!(wraps >= 5, "{wraps} wraps");

    // The board's ticks are those of the crystal: exact to the reading.
    let before = board.rig.now();
    let now = board.now();
    let after = board.rig.now();
    let zero = first.at.0;
    let ticks = |t: SimTime| t.as_nanos() as u128 * u128::from(SECOND) / 1_000_000_000;
    let offset = |t: SimTime| ticks(t) as i128 - i128::from(now.0);
    // Tick 0 lies between power-on and the first status.
    assert!(offset(after) >= 0, "board time runs ahead of the crystal");
    assert!(
        offset(before) <= i128::from(SECOND),
        "first status at {zero}"
    );
    // The same offset at the end as at the start: the counter's extension has
    // neither lost nor won a wrap (a wrap is 89 s; 600 messages a second apart,
    // each to a millisecond).
    let span = last.at.0 - zero;
    assert!(
        span.abs_diff(599 * SECOND) < 3 * SECOND,
        "{span} ticks between the first status and the last"
    );
}

/// Bus resets, suspends and pulled cables at any moment of a stream of full packets: the board
/// comes back each time, and nothing is lost that is not counted.
#[test]
fn the_link_comes_back_after_any_interruption_in_a_packet() {
    let mut board = Board::boot(wiring::board());
    let mut random = Seed(7).stream(Stream::Test);
    for n in 0..30_u64 {
        assert_eq!(board.ask(SendFiller(true)), Ok(()));
        let connects = board.next_status().connects;
        // A full packet takes 52 µs.
        board
            .rig
            .run_for(SimDuration::from_micros(random.below(2_000) as u64))
            .unwrap();
        match n % 3 {
            0 => board.rig.usb_reset_bus(),
            1 => board
                .rig
                .usb_suspend(SimDuration::from_millis(4 + random.below(30) as u64)),
            _ => {
                board.rig.usb_unplug();
                board
                    .rig
                    .run_for(SimDuration::from_micros(random.below(9_000) as u64))
                    .unwrap();
                board.rig.usb_plug();
            }
        }
        board.break_link();
        board.wait(3_000, |b| {
            b.statuses.last().is_some_and(|s| s.connects > connects)
        });
    }
    let statuses = &board.statuses;
    let gaps: u32 = statuses
        .windows(2)
        .map(|pair| pair[1].seq - pair[0].seq - 1)
        .sum();
    assert_eq!(gaps, statuses.last().unwrap().dropped.status);
    assert!(board.rig.failures().is_empty());
}

/// Cuts control transfers short at drawn instants of an enumeration, or of the requests that open
/// the port later: after the SETUP, within the data, before the status. The host must always get
/// to the serial port in the end, without the help of the board's watch.
fn cut_control_transfers(kind: BoardKind, times: u32, seed: u64) {
    let mut board = Board::boot(wiring::board_of(kind, None));
    let mut random = Seed(seed).stream(Stream::Test);
    for n in 0..times {
        let what = [UsbCut::Unplug, UsbCut::Reset, UsbCut::Retry][n as usize % 3];
        let is_enumerated = random.below(5) > 0;
        let transactions = if is_enumerated {
            board.rig.usb_reset_bus();
            1 + random.below(TRANSACTIONS) as u32
        } else {
            board.rig.usb_open(false);
            board.run(5);
            board.rig.usb_open(true);
            1 + random.below(2) as u32
        };
        let delay = SimDuration::from_micros(random.below(60) as u64);
        board.rig.usb_cut(what, transactions, delay);
        board.run(500);
        if board.rig.usb_state() == UsbState::Unplugged {
            board.run(random.below(20) as u64);
            board.rig.usb_plug();
        }
        let ready = board
            .rig
            .run_until_usb_ready(SimDuration::from_millis(1_500));
        let case = (n, what, transactions, delay);
        assert!(ready.unwrap(), "{case:?}: {:?}", board.rig.usb_log().last());
        board.break_link();
        assert!(board.ask(Ping { host_time: 1 }).is_ok(), "{case:?}");
    }
    assert_eq!(board.next_status().usb.stuck, 0);
    assert!(board.rig.failures().is_empty());
}

#[test]
fn a_control_transfer_may_end_anywhere() {
    cut_control_transfers(BoardKind::Discovery, 1_000, 1);
    cut_control_transfers(BoardKind::BlackPill, 100, 2);
}

/// A host that clears the halts of endpoints starts again at DATA0 (USB 2.0 9.4.5), and one that
/// sets the configuration (9.1.1.5).
#[test]
fn no_packet_is_lost_by_its_data_toggle() {
    let mut board = Board::boot(wiring::board());
    board.rig.usb_clear_halts_on_open();
    for n in 0..20 {
        // An odd number of packets, or an even one.
        board.run(7 * n);
        if n % 2 == 0 {
            board.rig.usb_open(false);
            board.run(10);
            board.rig.usb_open(true);
        } else {
            board.rig.usb_configure_again();
        }
        board.run(10);
        board.break_link();
        assert!(board.ask(Ping { host_time: n }).is_ok(), "{n}");
    }
    let log = board.rig.usb_log();
    assert!(
        log.iter().all(|(_, note)| !note.contains("toggle")),
        "{log:?}"
    );
}

/// Runs trigger and IMU, and a number of times, some seconds apart, pulls the cable for a while,
/// lets the computer sleep, or resets the bus. Every other time the enumeration that follows is cut
/// short at a drawn instant, by the cable or by a reset. Every edge and sample is compared.
fn run_interrupted(times: u32, seconds: u64) {
    let mut bench = ImuBench::at_rest();
    let period = Period::from_picos(33_330_652_540).unwrap();
    bench.board.stop();
    bench.board.run(100);
    bench.board.rig.take_edges();
    bench.board.pulses.clear();
    let first = bench.board.start(train(period, 576)).next_edge;
    let begun = bench.board.rig.now();
    let mut random = Seed(11).stream(Stream::Test);
    let (mut samples, mut last_sample, mut cuts) = (0, 0, 0);
    for n in 0..times {
        let connects = bench.board.next_status().connects;
        bench.board.run(seconds * 1_000);
        match n % 3 {
            0 => {
                bench.board.rig.usb_unplug();
                bench.board.run(3_000);
                bench.board.rig.usb_plug();
            }
            1 => bench.board.rig.usb_suspend(SimDuration::from_secs(5)),
            _ => bench.board.rig.usb_reset_bus(),
        }
        if n % 2 == 1 {
            let what = [UsbCut::Unplug, UsbCut::Reset][random.below(2)];
            let transactions = 1 + random.below(TRANSACTIONS) as u32;
            let delay = SimDuration::from_micros(random.below(60) as u64);
            bench.board.rig.usb_cut(what, transactions, delay);
        }
        bench.board.break_link();
        for _ in 0..20 {
            bench.board.run(500);
            if bench.board.rig.usb_state() == UsbState::Unplugged {
                cuts += 1;
                bench.board.rig.usb_plug();
                bench.board.break_link();
            }
            let status = bench.board.statuses.last();
            if status.is_some_and(|status| status.connects > connects) {
                break;
            }
        }
        assert!(bench.board.next_status().connects > connects, "{n}");
        bench.board.run(1_000);
        let checked = bench.check_samples();
        samples += checked.len() as u32;
        last_sample = checked.last().unwrap().seq;
    }
    let status = bench.board.next_status();
    let length = (bench.board.rig.now() - begun).as_secs_f64();
    let pulses = check_train(&mut bench.board, first, period, 576) as u32;
    let missing = [
        (
            pulses - bench.board.pulses.len() as u32,
            status.dropped.pulses,
        ),
        (last_sample + 1 - samples, status.dropped.imu),
    ];
    println!(
        "{length:.0} s, {times} interruptions, {cuts} more by the cable within the enumeration after \
         one: {pulses} pulses and {samples} samples compared, each 0 \
         ticks off; missing at the host, and of them counted by the board: {missing:?}"
    );
    for (missing, dropped) in missing {
        assert!(dropped > 0);
        assert_eq!(missing, dropped);
    }
    assert!(bench.board.rig.failures().is_empty());
}

#[test]
fn sleep_and_replug_lose_nothing_that_is_not_counted() {
    run_interrupted(3, 4);
}

/// `cargo xtask test -p smartdepthsync-rig --test it an_hour_with -- --ignored --nocapture`.
#[test]
#[ignore = "an hour of virtual time takes minutes"]
fn an_hour_with_sleep_and_replug_every_minute() {
    run_interrupted(60, 50);
}

/// `cargo xtask test -p smartdepthsync-rig --test it load_of_both -- --ignored --nocapture`.
#[test]
#[ignore = "prints figures"]
fn the_load_of_both_boards() {
    for kind in [BoardKind::Discovery, BoardKind::BlackPill] {
        let builder = wiring::board_of(kind, None);
        let mut bench = ImuBench::on(builder, SensorModel::Mpu9150, Motion::rest(), &[]);
        bench.board.run(2_000);
        let before = bench.board.rig.cpu_stats();
        bench.board.run(5_000);
        let after = bench.board.rig.cpu_stats();
        let (awake, asleep) = (after.awake - before.awake, after.asleep - before.asleep);
        let load = awake as f64 / (awake + asleep) as f64;
        println!(
            "{kind:?}, IMU at 500 Hz and trigger at 30 fps: {:.2} % of the core",
            load * 100.0
        );
        assert!(load < 0.2, "{load}");
    }
}

/// The board leaves the bus and comes back when the core's transmitter stops for any reason.
#[test]
fn a_transmitter_that_stops_is_started_again() {
    let mut board = Board::boot(wiring::board());
    let connects = board.next_status().connects;
    board.rig.usb_wedge_transmit();
    for id in 0..12 {
        let mut frame = [0; MAX_FRAME];
        let ping = HostToDevice {
            id,
            command: Ping { host_time: 0 }.into(),
        };
        board.rig.usb_write(encode(&ping, &mut frame).unwrap());
        board.run(1_000);
    }
    let status = board.next_status();
    assert_eq!((status.connects, status.usb.stuck), (connects + 1, 1));
}

/// A host resets the bus of a board that cannot sense VBUS, and is gone before it configures it.
#[test]
fn a_core_without_a_configuration_is_restarted_once() {
    let mut board = Board::boot(wiring::board_of(BoardKind::BlackPill, None));
    board.rig.usb_reset_bus();
    // After the reset of 50 ms, and before the 10 ms are over that the board may rest.
    board.run(55);
    board.rig.usb_unplug();
    board.run(70_000);
    board.rig.usb_plug();
    let ready = (board.rig).run_until_usb_ready(SimDuration::from_millis(1_500));
    assert!(ready.unwrap(), "{:?}", board.rig.usb_log().last());
    board.break_link();
    let usb = board.next_status().usb;
    assert_eq!((usb.stuck, usb.unconfigured), (0, 1));
}

/// A megabyte of anything: no panic, no reset, and every command is
/// answered afterwards.
#[test]
fn a_megabyte_of_random_bytes_changes_nothing() {
    let mut board = Board::boot(wiring::board());
    let epoch = board.hellos[0].epoch;
    let mut random = Seed(99).stream(Stream::Test);
    let mut chunk = vec![0; 64 * 1024];
    let mut sent = 0usize;
    while sent < 1_000_000 {
        if board.rig.usb_unsent() < chunk.len() {
            random.fill(&mut chunk);
            board.rig.usb_write(&chunk);
            sent += chunk.len();
        }
        board.run(10);
    }
    while board.rig.usb_unsent() > 0 {
        board.run(10);
    }
    // A delimiter ends what is left of the noise.
    board.rig.usb_write(&[0]);
    for n in 0..20 {
        match board.ask(Ping { host_time: n }) {
            Ok(pong) => assert_eq!(pong.host_time, n),
            other => panic!("{other:?}"),
        }
    }
    let status = board.next_status();
    assert_eq!(status.epoch, epoch, "the board was reset");
    assert_eq!(status.dropped.answers, 0);
    let link = status.link;
    assert!(link.lost_frames > 1_000, "{link:?}");
    assert!(link.lost_bytes as usize > 900_000, "{link:?}");
    assert!(board.rig.failures().is_empty());
}

fn self_test(board: &mut Board, failure: Failure) {
    let answer = board.ask(SelfTest {
        key: SELF_TEST_KEY,
        failure,
    });
    assert_eq!(answer, Ok(()));
}

/// Waits for the `Hello` of the next run.
fn next_run(board: &mut Board) -> Hello {
    let seen = board.hellos.len();
    let epoch = board.hellos[seen - 1].epoch;
    board.rig.usb_open(true);
    board.wait(6_000, |b| {
        b.hellos.iter().skip(seen).any(|h| h.epoch != epoch)
    });
    board.hellos.last().unwrap().clone()
}

#[test]
fn a_panic_is_reported_in_the_next_hello() {
    let mut board = Board::boot(wiring::board().tolerate_failures());
    self_test(&mut board, Failure::Panic);
    let hello = next_run(&mut board);
    assert_eq!(hello.reset_cause, ResetCause::Software);
    let message = hello.last_panic.expect("the message of the panic");
    assert!(message.contains("self test: panic on request"), "{message}");
    let failure = &board.rig.failures()[0];
    assert_eq!(failure.kind, FailureKind::Panic);
    assert!(
        failure.log.iter().any(|l| l.contains("panic on request")),
        "{failure}"
    );
    // Reported once: after another reset it is gone.
    board.rig.press_reset();
    let hello = next_run(&mut board);
    assert_eq!(hello.reset_cause, ResetCause::Pin);
    assert_eq!(hello.last_panic, None);
    board.rig.brown_out();
    let hello = next_run(&mut board);
    assert_eq!(hello.reset_cause, ResetCause::BrownOut);
    // Power, brown-out, pin, software.
    assert_eq!(board.next_status().resets, [1, 1, 1, 1, 0, 0]);
    // After power went, the record in RAM is not mistaken for noise, and the flash has it still.
    board.rig.power_cycle();
    let hello = next_run(&mut board);
    assert_eq!(hello.reset_cause, ResetCause::PowerOn);
    assert_eq!(hello.last_panic, None);
    assert_eq!((hello.panics, hello.kept_panic), (1, Some(message)));
    assert_eq!(board.next_status().resets, [1, 0, 0, 0, 0, 0]);
    self_test(&mut board, Failure::HardFault);
    next_run(&mut board);
    board.rig.power_cycle();
    let hello = next_run(&mut board);
    let fault = hello.kept_panic.expect("the newest");
    assert_eq!(hello.panics, 2);
    for part in ["HardFault at pc 0x08", "lr 0x", "cfsr 0x00010000"] {
        assert!(fault.contains(part), "{fault}");
    }
}

/// Either stack that overflows faults at once, and the next run names it.
#[test]
fn a_stack_that_overflows_is_named() {
    for kind in [BoardKind::Discovery, BoardKind::BlackPill] {
        let mut board = Board::boot(wiring::board_of(kind, None).tolerate_failures());
        for (failure, expected) in [
            (Failure::StackOverflow, "the tasks' stack ended"),
            (Failure::HandlerOverflow, "the handlers' stack ended"),
        ] {
            self_test(&mut board, failure);
            let hello = next_run(&mut board);
            assert_eq!(hello.reset_cause, ResetCause::Software, "{kind:?}");
            let message = hello.last_panic.expect("the overflow");
            assert!(message.contains(expected), "{kind:?}: {message}");
        }
    }
}

/// The delays hold from the next edge on and are there after power-off; what is out of range, or
/// comes while an output runs, changes nothing.
#[test]
fn settings_of_the_board_hold_and_outlive_power_off() {
    let width = MIN_PULSE_WIDTH;
    let mut board = Board::boot_with_train(
        wiring::board()
            .model(Jumpers::default())
            .tolerate_failures(),
        width,
    );
    board.wait(1_000, |board| board.pulses.len() > 4);
    let before = board.ask(QueryBoard).unwrap();
    let settings = BoardSettings {
        output_start_delay: before.output_start_delay + 4,
        input_delay: before.input_delay + 3,
        crystal_ppb: Some(-12_345),
    };
    let refused = board.ask(SetBoard(settings));
    assert_eq!(refused, Err(Refusal::OutputRunning));
    let read_back = board.pulses.last().unwrap().readback.unwrap();
    board.stop();
    board.run(100);
    for wrong in [
        BoardSettings {
            input_delay: MAX_INPUT_DELAY + 1,
            ..settings
        },
        BoardSettings {
            crystal_ppb: Some(MAX_CRYSTAL_PPB as i32 + 1),
            ..settings
        },
    ] {
        let refused = board.ask(SetBoard(wrong));
        assert_eq!(refused, Err(Refusal::BoardSettingOutOfRange));
    }
    assert_eq!(board.ask(QueryBoard), Ok(before));
    assert_eq!(board.ask(SetBoard(settings)), Ok(settings));

    board.rig.power_cycle();
    next_run(&mut board);
    assert_eq!(board.ask(QueryBoard), Ok(settings));
    board.rig.log_pin(Pin::PE11);
    board.rig.take_edges();
    board.pulses.clear();
    let train = train(PERIOD, MIN_OUTPUT_WIDTH);
    board.start(train);
    board.wait(1_000, |board| board.pulses.len() > 4);
    let zero = board.zero();
    let delay = board.pulses.last().unwrap().readback.unwrap();
    assert_eq!(delay, read_back - 3);
    let output = Output::Two;
    let started = board.ask(StartTrigger {
        output,
        start: train,
    });
    board.rig.take_edges();
    board.wait(1_000, |board| !board.outputs.is_empty());
    let (rise, _) = pulses_of(&board.rig.take_edges(), Pin::PE11)[0];
    let tick = (rise.units() - zero) / UNITS_PER_TICK;
    // Four clocks of TIM1 are two ticks.
    assert_eq!(tick + 2, board.outputs[0].at.0, "{started:?}");
    assert!(board.rig.failures().is_empty());
}

/// By the command, and back as after a download. The ROM's own program is not modelled.
#[test]
fn it_restarts_into_the_rom_and_comes_back() {
    for builder in [
        wiring::board(),
        wiring::board_of(BoardKind::BlackPill, None),
    ] {
        let mut board = Board::boot(builder.tolerate_failures());
        board.start(train(PERIOD, MIN_PULSE_WIDTH));
        let refused = board.ask(RestartIntoRom);
        assert_eq!(refused, Err(Refusal::OutputRunning));
        board.stop();
        board.run(100);
        assert!(!board.rig.is_in_rom());
        assert_eq!(board.ask(RestartIntoRom), Ok(()));
        board.run(1_000);
        assert!(board.rig.is_in_rom());
        assert_ne!(board.rig.usb_state(), UsbState::Ready);
        // No watchdog, and nothing else, ends it.
        board.run(20_000);
        assert!(board.rig.is_in_rom());
        board.break_link();
        board.rig.leave_rom();
        let hello = next_run(&mut board);
        assert_eq!(hello.last_panic, None);
        assert_eq!(
            board.rig.failures().len(),
            1,
            "the reset that was asked for"
        );
        board.run(3_000);
    }
}

#[test]
fn masked_interrupts_are_metered() {
    let mut board = Board::boot_with_train(wiring::board(), MIN_PULSE_WIDTH);
    board.run(3_000);
    let masked = board.next_status().masked;
    // Within the margin that is kept free before an edge, 15 µs; and a tenth of the millisecond
    // in which the queues to the hand-over do not fill.
    let most = |micros: u32| micros * (CORE_HZ / 1_000_000);
    assert!((1..=most(15)).contains(&masked.all), "{masked:?}");
    assert!(
        (1..=most(100)).contains(&masked.below_trigger),
        "{masked:?}"
    );
}

/// The catch would halt the core at the fault, until the watchdog's reset.
#[test]
fn a_fault_is_reported_where_a_tool_left_its_catch_on() {
    let mut board = Board::boot(wiring::board().tolerate_failures());
    board.rig.leave_fault_catch();
    board.rig.press_reset();
    next_run(&mut board);
    self_test(&mut board, Failure::HardFault);
    let hello = next_run(&mut board);
    assert_eq!(hello.reset_cause, ResetCause::Software);
    assert!(hello.last_panic.unwrap().contains("HardFault"));
    let failure = board.rig.failures().last().unwrap();
    assert_eq!(failure.kind, FailureKind::HardFault);
}

/// The IMU's task does not switch it off.
#[test]
fn the_red_light_stays_on_after_a_panic() {
    let builder = wiring::board().tolerate_failures();
    let mut bench = ImuBench::on(builder, SensorModel::Mpu9150, Motion::rest(), &[]);
    bench.board.run(1_000);
    let is_red = |bench: &ImuBench| bench.board.rig.level(Pin::PD14).is_high();
    assert!(!is_red(&bench));
    self_test(&mut bench.board, Failure::Panic);
    next_run(&mut bench.board);
    bench.board.run(2_000);
    assert_eq!(bench.status().state, ImuState::Running);
    assert!(is_red(&bench));
    bench.board.rig.press_reset();
    next_run(&mut bench.board);
    bench.board.run(2_000);
    assert!(!is_red(&bench));
}

#[test]
fn a_hang_and_a_dead_task_end_in_a_watchdog_reset() {
    for failure in [Failure::Hang, Failure::Stall] {
        let mut board = Board::boot(wiring::board().tolerate_failures());
        self_test(&mut board, failure);
        let begun = board.rig.now();
        let hello = next_run(&mut board);
        assert_eq!(hello.reset_cause, ResetCause::Watchdog, "{failure:?}");
        assert_eq!(hello.last_panic, None);
        let reset = &board.rig.failures()[0];
        assert_eq!(
            reset.kind,
            FailureKind::Reset(BoardReset::IndependentWatchdog)
        );
        // 4 s after the last time it was fed, which may be a second later.
        let after = reset.at - begun;
        assert!(after > SimDuration::from_secs(3), "{reset}");
        assert!(after < SimDuration::from_millis(5_200), "{reset}");
    }
}

/// Without tolerance, a failure ends the run and says where it was.
#[test]
fn a_failure_ends_the_run_with_its_message_and_stack() {
    let mut board = Board::boot(wiring::board());
    self_test(&mut board, Failure::Panic);
    let error = board.rig.run_for(SimDuration::from_secs(2)).unwrap_err();
    let SimError::Failed(failure) = &error else {
        panic!("{error}");
    };
    assert_eq!(failure.kind, FailureKind::Panic);
    let text = error.to_string();
    assert!(text.contains("the firmware panicked at"), "{text}");
    assert!(text.contains("self test: panic on request"), "{text}");
    assert!(
        text.contains("self_test.rs"),
        "the stack has source lines: {text}"
    );
}

/// A crystal that never starts: the watchdog runs already, the red LED says it, and the
/// board goes on trying.
#[test]
fn without_its_crystal_the_board_says_so_and_tries_again() {
    let builder = wiring::board()
        .chip(|chip| chip.crystal = None)
        .tolerate_failures();
    let mut rig = builder.build().unwrap();
    rig.run_for(SimDuration::from_secs(1)).unwrap();
    assert!(rig.level(Pin::PD14).is_high(), "the red LED");
    rig.run_for(SimDuration::from_secs(9)).unwrap();
    let watchdog = FailureKind::Reset(BoardReset::IndependentWatchdog);
    let resets: Vec<_> = rig.failures().iter().map(|failure| failure.kind).collect();
    assert_eq!(resets, [watchdog; 2]);
}

/// The number of a run is the random number generator's after power-on and one more
/// after each reset; without the generator the board starts all the same.
#[test]
fn the_number_of_a_run_is_random_at_power_on() {
    let mut board = Board::boot(wiring::board());
    let first = board.hellos[0].epoch;
    assert_eq!(board.rig.random_number(), Some(first));
    board.rig.press_reset();
    assert_eq!(next_run(&mut board).epoch, first.wrapping_add(1));
    board.rig.power_cycle();
    let again = next_run(&mut board).epoch;
    assert_eq!(board.rig.random_number(), Some(again));

    let board = Board::boot(wiring::board().chip(|chip| chip.broken_rng = true));
    assert_eq!(board.rig.random_number(), None);
    assert_eq!(board.hellos.len(), 1);
}

/// It keeps the flash's prefetch off there: the simulator ends the run otherwise.
#[test]
fn it_runs_on_the_first_revision_of_the_chip() {
    let mut board = Board::boot(wiring::board().chip(|chip| chip.revision = Revision::A));
    board.run(100);
    // PRFTEN of FLASH_ACR.
    let prefetch = |board: &Board| board.rig.stored_register(0x4002_3c00).unwrap() & (1 << 8) != 0;
    assert!(!prefetch(&board));
    assert!(prefetch(&Board::boot(wiring::board())));
}

/// Here the bus is wired to others of I2C1's pins than those that the firmware uses.
#[test]
fn an_access_that_the_manual_forbids_always_ends_the_run() {
    let builder = wiring::board().i2c_bus(Pin::PB8, Pin::PB9);
    let mut rig = builder.tolerate_failures().build().unwrap();
    let error = rig.run_for(SimDuration::from_secs(2)).unwrap_err();
    let SimError::Failed(failure) = &error else {
        panic!("{error}");
    };
    assert_eq!(failure.kind, FailureKind::Forbidden);
    let text = error.to_string();
    let rule = "I2C1 is used while PB8 is not in its alternate function 4";
    assert!(text.contains(rule), "{text}");
}

#[test]
fn the_stack_ends_where_memory_ends() {
    Board::boot(wiring::board()).check_stacks([0x1000_0000, 0x1000_d000, 0x1001_0000]);
}

/// The ROM's bootloader leaves its vectors, its stack, its clocks, the USB core and interrupts
/// that are enabled and pending: whatever of it, the program starts as after a reset.
#[test]
fn it_runs_when_the_rom_has_started_it() {
    for kind in [BoardKind::Discovery, BoardKind::BlackPill] {
        for seed in 0..10 {
            let builder = wiring::board_of(kind, None).seed(Seed(seed));
            let mut board = Board::boot(builder.started_by_rom());
            board.run(1_200);
            assert_eq!(board.hellos.len(), 1);
            let stacks = board.rig.firmware();
            let top = stacks.symbol("_stack_start").unwrap().address;
            let bottom = stacks.symbol("_task_stack_start").unwrap().address;
            let status = board.statuses.last().unwrap();
            assert!(status.stack_used < 6_144, "{status:?}");
            assert!(board.rig.handler_stack() > bottom && board.rig.handler_stack() <= top);
        }
    }
}

/// A probe that detaches stops the counter that the handlers are measured with.
#[test]
fn handlers_are_measured_after_a_probe_has_gone() {
    let mut board = Board::boot(wiring::board());
    board.run(1_500);
    board.rig.detach_probe();
    board.run(2_100);
    let usb = board.statuses.last().unwrap().handlers.usb;
    assert!(usb.calls > 0 && usb.mean() > 20, "{usb:?}");
}

#[test]
fn a_missing_or_foreign_elf_is_a_clear_error() {
    let missing = wiring::board().elf("/does/not/exist").build();
    let text = missing.unwrap_err().to_string();
    assert!(text.contains("cargo xtask build"), "{text}");
    // This test itself is an ELF, but not one for the board.
    let foreign = Firmware::load(&std::env::current_exe().unwrap(), "");
    let text = foreign.unwrap_err().to_string();
    assert!(text.contains("not a firmware of this board"), "{text}");
}

/// The time of each handler, and the chip's temperature at any supply.
#[test]
fn the_status_reports_handler_times_and_the_chip_s_temperature() {
    for (celsius, supply) in [(-12.0, 3.3), (41.5, 2.9), (84.0, 2.5)] {
        let mut board =
            Board::boot(wiring::board().chip(|chip| chip.die = Die { celsius, supply }));
        board.start(train(Period::from_ticks(TICK_HZ / 100), MIN_PULSE_WIDTH));
        board.run(3_100);
        let status = board.statuses.last().unwrap();
        let reported = f64::from(status.die_decidegrees.unwrap()) / 10.0;
        // A code is 0.3 °C; two of them and the rounding of the calibration.
        assert!((reported - celsius).abs() < 0.8, "{reported} for {celsius}");
        let volts = f64::from(status.supply_mv.unwrap()) / 1e3;
        assert!((volts - supply).abs() < 0.01, "{volts} for {supply}");

        let Handlers {
            trigger,
            outputs,
            handover,
            usb,
        } = status.handlers;
        // One call for the end of each pulse.
        assert!((99..=101).contains(&trigger.calls), "{trigger:?}");
        assert!(handover.calls >= 99 && usb.calls > 0);
        assert_eq!(outputs, HandlerTime::default());
        for handler in [trigger, handover, usb] {
            assert!(handler.mean() > 20 && handler.worst >= handler.mean());
            assert!(handler.worst < 20_000, "{handler:?}");
            assert!(handler.cycles < CORE_HZ / 50, "{handler:?}");
        }
    }
}
