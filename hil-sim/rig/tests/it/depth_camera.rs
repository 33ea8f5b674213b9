//! The depth camera on the trigger of the real firmware, on the simulated board:
//! what the board reports against the camera's truth.

use std::io::Write;
use std::sync::{Arc, Mutex};

use crate::board_host::{Board, UNITS_PER_TICK, camera_align};
use protocol::*;
use rig::depth_camera::{DepthCamera, DepthCameraConfig, FrameRecord, Source};
use rig::lidar::{Lidar, LidarConfig};
use rig::oscillator::{BoardTime, OscillatorConfig};
use rig::random::{Seed, Stream};
use rig::wiring;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::sim::INPUT_SYNCHRONISER;
use stm32f4_sim::sim::SimBuilder;
use stm32f4_sim::time::{SimTime, UNITS_PER_NANO};
use stm32f4_sim::vcd_trace::VcdTrace;

/// Rate error of the board's crystal and of the camera's clock, in ppm.
const BOARD_PPM: f64 = 20.0;
const CAMERA_PPM: f64 = 300.0;

/// 9 flashes, of two edges each.
const EDGES: usize = 18;

fn camera(first_frame: u32) -> Shared<DepthCamera> {
    let clock = |rate_ppm| OscillatorConfig {
        offset_ns: 2_500_000_000,
        rate_ppm,
        wander: 0.0,
        ..OscillatorConfig::default()
    };
    let seed = Seed(3);
    let board = BoardTime::new(clock(BOARD_PPM), seed.stream(Stream::BoardClock));
    let config = DepthCameraConfig {
        first_frame,
        clock: clock(CAMERA_PPM),
        ..DepthCameraConfig::default()
    };
    Arc::new(Mutex::new(DepthCamera::new(config, board, seed).unwrap()))
}

/// The board's outputs reach 2.5 V at a supply of 2.9 V: no camera without the gate, not even
/// at 3.3 V.
#[test]
fn a_camera_without_a_gate_is_refused() {
    let wired = |input_high, supply| {
        let config = DepthCameraConfig {
            input_high,
            ..DepthCameraConfig::default()
        };
        let seed = Seed(3);
        let board = BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
        let camera = DepthCamera::new(config, board, seed).unwrap();
        let built = wiring::board().die(25.0, supply).model(camera).build();
        built.map(drop).map_err(|error| error.to_string())
    };
    assert_eq!(wired(wiring::GATE_HIGH, 2.9), Ok(()));
    for supply in [2.9, 3.3] {
        let refused = wired(3.5, supply).unwrap_err();
        assert!(refused.contains("depth camera takes 3.50 V"), "{refused}");
    }
    let lidar = Lidar::new(LidarConfig {
        input_high: 3.0,
        ..LidarConfig::default()
    });
    // One that is shared is asked too.
    let refused = wiring::board()
        .model(Arc::new(Mutex::new(lidar)))
        .build()
        .unwrap_err()
        .to_string();
    assert!(refused.contains("reach 2.50 V"), "{refused}");
}

/// A train and the time of tick 0 at the pin.
struct Bench {
    board: Board,
    camera: Shared<DepthCamera>,
    zero: u64,
}

impl Bench {
    fn new(first_frame: u32, width: u32, builder: SimBuilder) -> Self {
        let camera = camera(first_frame);
        let mut board = Board::boot_with_train(builder.model(camera.clone()), width);
        board.wait(100, |board| !board.pulses.is_empty());
        let zero = board.zero();
        Self {
            board,
            camera,
            zero,
        }
    }

    /// The tick in which something at the pin happened.
    fn tick_of(&self, at: SimTime) -> Ticks {
        Ticks((at.units() - self.zero) / UNITS_PER_TICK)
    }

    /// Runs to the end of a frame's flashes and takes the frames so far.
    fn run(&mut self, ms: u64) -> Vec<FrameRecord> {
        self.board.run(ms);
        let pulses = self.board.pulses.len();
        self.board
            .wait(100, |board| board.pulses.len() > pulses || ms == 0);
        self.board.run(20);
        lock(&self.camera).take_frames()
    }
}

/// Seconds of the camera's clock in so many of the board's.
fn own(board_seconds: f64) -> f64 {
    board_seconds * (1.0 + CAMERA_PPM * 1e-6) / (1.0 + BOARD_PPM * 1e-6)
}

/// The first frame comes on the pulse that was set; each frame belongs to the
/// pulse that the board reported, and all of its flashes are captured, each edge
/// in its tick.
#[test]
fn frames_and_flashes_are_those_of_the_reported_pulses() {
    for first_frame in [2, 3] {
        let mut bench = Bench::new(first_frame, 576, wiring::board());
        let frames = bench.run(3_000);
        let pulses = &bench.board.pulses;
        assert_eq!(frames.len(), pulses.len() - (first_frame as usize - 1));
        assert_eq!(bench.board.captures.len(), EDGES * frames.len());
        let flashes = bench.board.captures.chunks(EDGES);
        for ((frame, pulse), edges) in frames
            .iter()
            .zip(&pulses[first_frame as usize - 1..])
            .zip(flashes)
        {
            let Source::Pulse { number, edge } = frame.source else {
                panic!("{frame:?}");
            };
            assert_eq!((number, bench.tick_of(edge)), (pulse.number + 1, pulse.at));
            let synchroniser = TickDelta(INPUT_SYNCHRONISER as i64);
            assert_eq!(edges[0].at - bench.tick_of(frame.first_flash), synchroniser);
            // The middle of the fifth flash is the centre of exposure.
            let middle = (edges[8].at.0 + edges[9].at.0) / 2 - INPUT_SYNCHRONISER;
            let center = bench.tick_of(frame.center).0;
            assert!(middle.abs_diff(center) <= 1, "{middle} {center}");
            for (k, capture) in edges.iter().enumerate() {
                let up = k % 2 == 0;
                assert_eq!(capture.edge == Edge::Rising, up);
                let us = 500.0 + (k / 2) as f64 * 1_575.0 + if up { 0.0 } else { 125.0 };
                let expected = us * 1e-6 / own(1.0) * f64::from(TICK_HZ);
                let measured = (capture.at - pulse.at - synchroniser).0 as f64;
                assert!(
                    (measured - expected).abs() <= 1.0,
                    "edge {k}: {measured} {expected}"
                );
            }
        }
        assert!(frames.iter().all(|frame| !frame.bad && frame.delivered));
        let status = bench.board.next_status();
        assert_eq!((status.strobe_overcaptures, status.strobe_floods), (0, 0));
    }
}

/// The shortest pulse that the board makes is enough for the camera; what would
/// not be is refused.
#[test]
fn the_boards_shortest_pulse_is_long_enough() {
    let mut bench = Bench::new(2, MIN_PULSE_WIDTH, wiring::board());
    bench.run(1_000);
    assert_eq!(lock(&bench.camera).short_pulses(), 0);
    assert_eq!(
        lock(&bench.camera).pulses(),
        bench.board.pulses.len() as u64
    );
    bench.board.stop();
    let eight_us = TriggerStart {
        period: Period::from_ticks(1_600_000),
        width: 8 * 48,
        first_edge: None,
        first_fraction: 0,
    };
    let refused = bench.board.try_start(eight_us);
    assert!(matches!(refused, Err(Refusal::WidthOutOfRange { .. })));
}

/// Device timestamps count 90 kHz of the camera's own clock.
#[test]
fn device_timestamps_are_of_the_cameras_own_clock() {
    let mut bench = Bench::new(2, 576, wiring::board());
    let frames = bench.run(10_000);
    let first = frames.first().unwrap();
    let last = frames.last().unwrap();
    let board = (last.center - first.center).as_secs_f64();
    let ticks = (last.device_ticks - first.device_ticks) as f64;
    let expected = own(board) * 90_000.0;
    assert!((ticks - expected).abs() <= 1.0, "{ticks} {expected}");
    // It is not the board's clock that is counted.
    assert!((ticks - board * 90_000.0).abs() > 200.0);
}

/// When the train stops the camera goes on by itself, and its flashes are still
/// captured; when a train starts again it follows that.
#[test]
fn it_runs_freely_when_the_pulses_stop_and_follows_them_again() {
    let mut bench = Bench::new(2, 576, wiring::board());
    bench.run(1_000);
    bench.board.stop();
    bench.board.run(200);
    lock(&bench.camera).take_frames();
    bench.board.captures.clear();
    bench.board.run(3_000);
    let frames = lock(&bench.camera).take_frames();
    assert!((89..=91).contains(&frames.len()), "{}", frames.len());
    assert!(frames.iter().all(|frame| frame.source == Source::FreeRun));
    for pair in frames.windows(2) {
        let period = own((pair[1].center - pair[0].center).as_secs_f64());
        assert!((period - 1.0 / 30.0).abs() < 1e-9, "{period}");
    }
    let captures = bench.board.captures.len();
    assert!(captures.abs_diff(EDGES * frames.len()) <= EDGES);

    let start = TriggerStart {
        period: Period::from_picos(33_330_652_540).unwrap(),
        width: 576,
        first_edge: None,
        first_fraction: 0,
    };
    bench.board.start(start);
    bench.board.run(1_000);
    let frames = lock(&bench.camera).take_frames();
    let followed = |frame: &FrameRecord| matches!(frame.source, Source::Pulse { .. });
    assert!(frames[frames.len() - 20..].iter().all(followed));
}

/// An align at once, by a quarter of a period, spoils frames; one in steps
/// within the camera's tolerance spoils none.
#[test]
fn a_jump_spoils_frames_and_small_steps_do_not() {
    for (slew, spoils) in [(0, true), (7_200, false)] {
        let mut bench = Bench::new(2, 576, wiring::board());
        bench.run(1_000);
        let period = Period::from_picos(33_330_652_540).unwrap();
        let status = bench.board.trigger();
        let to = TriggerAlign {
            anchor: Ticks(status.next_edge.0 + u64::from(period.ticks()) / 4),
            anchor_fraction: 0,
            period,
            slew,
        };
        bench.board.ask(camera_align(to)).unwrap();
        bench.board.wait(10_000, |board| !board.arrived.is_empty());
        let arrived = bench.board.arrived[0];
        let frames = bench.run(1_000);
        let bad: Vec<_> = frames.iter().filter(|frame| frame.bad).collect();
        let disturbances = lock(&bench.camera).disturbances();
        assert_eq!(disturbances > 0, spoils);
        assert_eq!(!bad.is_empty(), spoils, "{} bad", bad.len());
        for frame in bad {
            let from_jump = bench.tick_of(frame.center) - arrived.at;
            assert!(
                (-0.04..0.2).contains(&from_jump.as_secs_f64()),
                "{from_jump}"
            );
        }
        assert!(frames[frames.len() - 20..].iter().all(|frame| !frame.bad));
    }
}

/// What a trace writes into, shared with the test.
#[derive(Clone, Default)]
struct Buffer(Arc<Mutex<Vec<u8>>>);

impl Write for Buffer {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Trigger and strobe as a wave viewer gets them: the edges of the VCD file are
/// those of the pin log, to the picosecond.
#[test]
fn a_vcd_trace_shows_the_edges_of_the_pins() {
    let buffer = Buffer::default();
    let pins = [(Pin::PA5, "trigger"), (Pin::PA2, "strobe")];
    let trace = Arc::new(Mutex::new(VcdTrace::new(buffer.clone(), &pins).unwrap()));
    let camera = camera(2);
    let builder = wiring::board().model(camera).model(trace.clone());
    let mut board = Board::boot(builder);
    board.rig.log_pin(Pin::PA5);
    board.rig.log_pin(Pin::PA2);
    let start = TriggerStart {
        period: Period::from_ticks(1_600_000),
        width: 576,
        first_edge: None,
        first_fraction: 0,
    };
    board.start(start);
    board.run(1_000);
    let edges = board.rig.take_edges();
    lock(&trace).flush().unwrap();
    drop(board);

    let bytes = buffer.0.lock().unwrap().clone();
    let mut parser = vcd::Parser::new(bytes.as_slice());
    let header = parser.parse_header().unwrap();
    assert_eq!(header.timescale, Some((1, vcd::TimescaleUnit::PS)));
    let codes = pins.map(|(pin, name)| {
        let wire = format!("{name}_{pin}");
        header.find_var(&["board", wire.as_str()]).unwrap().code
    });
    let mut now = 0;
    let mut dumping = false;
    let mut seen = Vec::new();
    for command in parser {
        match command.unwrap() {
            vcd::Command::Timestamp(at) => now = at,
            vcd::Command::Begin(_) => dumping = true,
            vcd::Command::End(_) => dumping = false,
            vcd::Command::ChangeScalar(code, value) if !dumping => {
                let wire = codes.iter().position(|&of_pin| of_pin == code).unwrap();
                seen.push((pins[wire].0, value == vcd::Value::V1, now));
            }
            _ => {}
        }
    }
    let expected: Vec<_> = edges
        .iter()
        .map(|&(pin, level, at)| {
            let picos = u128::from(at.units()) * 1_000 / u128::from(UNITS_PER_NANO);
            (pin, level.is_high(), picos as u64)
        })
        .collect();
    assert!(expected.len() > 500, "{}", expected.len());
    // The pin log began after the boot, in which the trigger's pin was set up.
    let since = seen.len() - expected.len();
    assert_eq!(seen[since..], expected);
}
