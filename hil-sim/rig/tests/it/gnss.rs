//! The pulse per second and its sentences from the real firmware on the simulated
//! board, read by a lidar's inputs and by a parser that others wrote.

use std::sync::{Arc, Mutex};

use crate::board_host::{Board, GNSS, UNITS_PER_TICK};
use protocol::*;
use rig::lidar::{Lidar, LidarConfig, LidarFaults, LidarSecond};
use rig::wiring;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::time::{SimDuration, SimTime};

struct LidarBench {
    board: Board,
    lidar: Shared<Lidar>,
    /// Time of tick 0, from the camera's trigger: another timer's pin.
    zero: u64,
}

impl LidarBench {
    fn new(config: LidarConfig) -> Self {
        let lidar = Arc::new(Mutex::new(Lidar::new(config)));
        let mut board = Board::boot_with_train(wiring::board().model(lidar.clone()), 576);
        board.wait(100, |board| !board.pulses.is_empty());
        let zero = board.zero();
        Self { board, lidar, zero }
    }

    fn start(&mut self, settings: GnssSettings) -> GnssReport {
        match self.board.ask(StartGnss(settings)) {
            Ok(report) => report,
            other => panic!("{other:?}"),
        }
    }

    fn stop(&mut self) {
        self.board.ask(StopGnss).unwrap();
    }

    /// Ticks since tick 0, exactly.
    fn tick_of(&self, at: SimTime) -> u64 {
        let units = at.units() - self.zero;
        assert_eq!(units % UNITS_PER_TICK, 0, "between two ticks");
        units / UNITS_PER_TICK
    }

    /// Checks the seconds that are over: pulses at whole seconds to the tick, the
    /// right UTC in time, by a public parser too, and the board's reports.
    fn check(&mut self, settings: &GnssSettings) -> Vec<LidarSecond> {
        let seconds = lock(&self.lidar).take_seconds();
        for second in &seconds {
            let tick = self.tick_of(second.pulse);
            assert_eq!(
                tick % u64::from(TICK_HZ),
                0,
                "off by {}",
                tick % u64::from(TICK_HZ)
            );
            let utc = settings.utc_at_zero + (tick / u64::from(TICK_HZ)) as i64;
            assert_eq!(second.utc, Some(utc), "{second:?}");
            let width = u64::from(settings.pulse_width) * UNITS_PER_TICK;
            assert_eq!(second.width, Some(SimDuration::from_units(width)));
            let ended = second.ended.unwrap() - second.pulse;
            let promised = SimDuration::from_micros(settings.ends_us().into());
            assert!(ended <= promised, "{ended:?}");
            let begun = SimDuration::from_millis(settings.delay_ms.into());
            assert!(ended > begun);
            let reported = parsed(&second.text);
            let count = match settings.sentences {
                Sentences::Rmc => 1,
                Sentences::RmcZda => 2,
            };
            assert_eq!(reported, vec![utc; count]);
            let report = self.board.pps.iter().find(|pps| pps.at.0 == tick);
            let report = report.expect("the pulse is reported");
            assert_eq!(report.utc, utc);
        }
        seconds
    }
}

/// The times of the sentences by a public parser, as Unix time.
fn parsed(text: &str) -> Vec<i64> {
    let times = text
        .lines()
        .map(|line| match nmea::parse_str(line).unwrap() {
            nmea::ParseResult::RMC(rmc) => rmc.fix_date.unwrap().and_time(rmc.fix_time.unwrap()),
            nmea::ParseResult::ZDA(zda) => zda.utc_date_time().unwrap(),
            other => panic!("{other:?}"),
        });
    times.map(|time| time.and_utc().timestamp()).collect()
}

/// As a VLP-16 wants it, over a wrap of the 32-bit counter and the turn of a year.
#[test]
fn a_lidar_takes_its_time_from_the_board() {
    // 2026-12-31 23:59:40 at tick 0.
    let settings = GnssSettings {
        utc_at_zero: 1_798_761_580,
        ..GNSS
    };
    let mut bench = LidarBench::new(LidarConfig::default());
    let report = bench.start(settings);
    assert_eq!(report.settings, Some(settings));
    // The same again changes nothing.
    bench.start(settings);
    bench.board.run(100_500);
    let seconds = bench.check(&settings);
    assert!(seconds.len() >= 99, "{}", seconds.len());
    assert_eq!(lock(&bench.lidar).faults(), LidarFaults::default());
    for (number, pps) in bench.board.pps.iter().enumerate() {
        assert_eq!(pps.seq as usize, number);
    }
    let status = bench.board.next_status().gnss;
    assert_eq!((status.late, status.missed), (0, 0));
    assert!(status.sentences as usize >= seconds.len());
}

#[test]
fn every_rate_and_polarity_is_read() {
    for baud in Baud::ALL {
        for line_inverted in [false, true] {
            let mut bench = LidarBench::new(LidarConfig {
                baud: baud.hz(),
                idle_low: line_inverted,
                gate_inverts: line_inverted,
                rising: line_inverted,
                ..LidarConfig::default()
            });
            let settings = GnssSettings {
                baud,
                line_inverted,
                pulse_inverted: !line_inverted,
                sentences: Sentences::RmcZda,
                pulse_width: MIN_OUTPUT_WIDTH,
                ..GNSS
            };
            bench.start(settings);
            bench.board.run(1_000);
            // Switching the polarity on moves the pin once.
            lock(&bench.lidar).take_seconds();
            bench.board.run(4_000);
            assert!(bench.check(&settings).len() >= 3);
            let faults = lock(&bench.lidar).faults();
            assert_eq!(faults.framing + faults.checksum, 0, "{baud:?}: {faults:?}");
        }
    }
}

/// A stop finishes the pulse and the sentences under way; then other settings
/// are taken.
#[test]
fn a_stop_finishes_what_it_began() {
    let mut bench = LidarBench::new(LidarConfig::default());
    bench.start(GNSS);
    bench.board.run(2_000);
    let other = GnssSettings {
        utc_at_zero: GNSS.utc_at_zero + 1_000,
        ..GNSS
    };
    let refused = bench.board.ask(StartGnss(other));
    assert_eq!(refused, Err(Refusal::GnssRunning));
    // Within the pulse of the next second, and then within its sentence.
    for within_ms in [10, 80] {
        let pulses = bench.board.pps.len();
        bench.board.wait(1_100, |board| board.pps.len() > pulses);
        let last = bench.board.pps.last().unwrap().at.0;
        let next = SimTime::from_units(bench.zero + (last + u64::from(TICK_HZ)) * UNITS_PER_TICK);
        let stop_at = next + SimDuration::from_millis(within_ms);
        let ms = (stop_at - bench.board.rig.now()).as_nanos() / 1_000_000;
        bench.board.run(ms);
        bench.stop();
        let refused = bench.board.ask(StartGnss(GNSS));
        assert_eq!(refused, Err(Refusal::GnssStopping));
        bench.board.run(1_500);
        assert_eq!(lock(&bench.lidar).faults(), LidarFaults::default());
        let edges = bench.board.rig.edge_count(Pin::PE9);
        bench.board.run(2_000);
        assert_eq!(bench.board.rig.edge_count(Pin::PE9), edges);
        bench.check(&GNSS);
        bench.start(GNSS);
        bench.board.run(2_500);
    }
    bench.check(&GNSS);
}
