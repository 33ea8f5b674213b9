//! The depth camera on the trigger of the real firmware, on the simulated board:
//! what the board reports against the camera's ground truth.

use std::sync::{Arc, Mutex};

use crate::board_host::{Board, UNITS_PER_TICK, train};
use protocol::*;
use rig::clocks::oscillator::{BoardTime, OscillatorConfig};
use rig::depth_camera::{DepthCamera, DepthCameraConfig, FrameRecord, Source};
use rig::lidar::{Lidar, LidarConfig};
use rig::random::{Seed, Stream};
use rig::wiring;
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::sim::INPUT_SYNCHRONISER;
use stm32f4_sim::sim::SimBuilder;
use stm32f4_sim::time::SimTime;

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
    Arc::new(Mutex::new(DepthCamera::new(config, board, seed)))
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
        let camera = DepthCamera::new(config, board, seed);
        let board = wiring::board().chip(|chip| chip.die.supply = supply);
        let built = board.model(camera).build();
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
struct CameraBench {
    board: Board,
    camera: Shared<DepthCamera>,
    zero: u64,
}

impl CameraBench {
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

/// Returns the seconds of the camera's clock in a time of the board's.
fn own(board_seconds: f64) -> f64 {
    board_seconds * (1.0 + CAMERA_PPM * 1e-6) / (1.0 + BOARD_PPM * 1e-6)
}

/// The first frame comes on the pulse that was set; each frame belongs to the
/// pulse that the board reported, and all of its flashes are captured, each edge
/// in its tick, by either of the manual's figures for the input's synchroniser.
#[test]
fn frames_and_flashes_are_those_of_the_reported_pulses() {
    for (first_frame, synchroniser) in [(2, INPUT_SYNCHRONISER), (3, 2)] {
        let builder = wiring::board().chip(|chip| chip.synchroniser = synchroniser);
        let mut bench = CameraBench::new(first_frame, 576, builder);
        let frames = bench.run(3_000);
        let pulses = &bench.board.pulses;
        assert_eq!(frames.len(), pulses.len() - (first_frame as usize - 1));
        assert_eq!(bench.board.strobe.len(), EDGES * frames.len());
        for (index, capture) in bench.board.strobe.iter().enumerate() {
            assert_eq!(capture.seq as usize, index);
            assert!(!capture.after_loss);
        }
        let flashes = bench.board.strobe.chunks(EDGES);
        for ((frame, pulse), edges) in frames
            .iter()
            .zip(&pulses[first_frame as usize - 1..])
            .zip(flashes)
        {
            let Source::Pulse { number, edge } = frame.source else {
                panic!("{frame:?}");
            };
            assert_eq!((number, bench.tick_of(edge)), (pulse.number + 1, pulse.at));
            let delay = TickDelta(synchroniser as i64);
            assert_eq!(edges[0].at - bench.tick_of(frame.first_flash), delay);
            // The middle of the fifth flash is the centre of exposure.
            let middle = (edges[8].at.0 + edges[9].at.0) / 2 - synchroniser;
            let center = bench.tick_of(frame.center).0;
            assert!(middle.abs_diff(center) <= 1, "{middle} {center}");
            for (k, capture) in edges.iter().enumerate() {
                let up = k % 2 == 0;
                assert_eq!(capture.edge == Edge::Rising, up);
                let us = 500.0 + (k / 2) as f64 * 1_575.0 + if up { 0.0 } else { 125.0 };
                let expected = us * 1e-6 / own(1.0) * f64::from(TICK_HZ);
                let measured = (capture.at - pulse.at - delay).0 as f64;
                assert!(
                    (measured - expected).abs() <= 1.0,
                    "edge {k}: {measured} {expected}"
                );
            }
        }
        assert!(frames.iter().all(|frame| !frame.bad && frame.delivered));
        let status = bench.board.next_status();
        assert_eq!((status.strobe_overcaptures, status.strobe_floods), (0, 0));
        assert_eq!(status.dropped.captures, 0);
    }
}

/// The shortest pulse that the board makes is enough for the camera; what would
/// not be is refused.
#[test]
fn the_boards_shortest_pulse_is_long_enough() {
    let mut bench = CameraBench::new(2, MIN_PULSE_WIDTH, wiring::board());
    bench.run(1_000);
    assert_eq!(lock(&bench.camera).short_pulses, 0);
    assert_eq!(lock(&bench.camera).pulses, bench.board.pulses.len() as u64);
    bench.board.stop();
    let eight_us = train(Period::from_ticks(1_600_000), 8 * 48);
    let refused = bench.board.try_start(eight_us);
    assert!(matches!(refused, Err(Refusal::WidthOutOfRange { .. })));
}
