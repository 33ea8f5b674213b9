use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use twist_sync::ClockCourse;

use super::*;

/// Model of the clocks, the links and their delays, independent of the filter's.
struct World {
    random: Pcg64,
    /// Least time there and back to either clock, s.
    least: [[f64; 2]; 2],
    tracker: Tracker,
    exchanges: Vec<(Asked, Exchange)>,
    at: f64,
    /// The computer's clock: its rate minus one since a time, that time, and its gain until then.
    computer: (f64, f64, f64),
}

/// Clock b minus clock a: 20 ppm, and 2 ppm more of warming within about 200 s.
fn offset(at: f64) -> f64 {
    let tau = 200.0;
    36_000.0 + 20e-6 * at + 2e-6 * (at - tau * (1.0 - (-at / tau).exp()))
}

fn twist(at: f64, error: f64) -> ClockRelation {
    ClockRelation {
        reference: at,
        offset: offset(at) + error,
        skew: 21e-6,
        covariance: [[9e-12, 0.0], [0.0, 1e-12]],
        wander: Wander::default(),
    }
}

impl World {
    fn new() -> Self {
        Self {
            random: Pcg64::seed_from_u64(7),
            least: [[2e-4, 3e-4], [3e-4, 5e-4]],
            tracker: Tracker::default(),
            exchanges: Vec::new(),
            at: 0.0,
            computer: (30e-6, 0.0, 0.0),
        }
    }

    /// Draws a value from 0 to 1, uniformly.
    fn draw(&mut self) -> f64 {
        self.random.random()
    }

    fn host(&self, at: f64) -> f64 {
        let (rate, since, gained) = self.computer;
        500.0 + at + gained + rate * (at - since)
    }

    fn way(&mut self, clock: usize, way: usize) -> f64 {
        let (scatter, waits) = (self.draw(), self.draw());
        let waiting = if waits < 0.6 { 1e-3 * waits } else { 0.0 };
        let tail = if self.draw() < 0.01 { 0.02 } else { 0.0 };
        self.least[clock][way] + 20e-6 * scatter + waiting + tail
    }

    /// Asks both clocks for their time until a true time.
    fn run(&mut self, until: f64) {
        while self.at < until {
            self.at += 0.02 * (0.5 + self.draw());
            for (place, asked) in [Asked::A, Asked::B].into_iter().enumerate() {
                let (there, back) = (self.way(place, 0), self.way(place, 1));
                let read = self.at + there;
                let stamp = if place == 0 {
                    read
                } else {
                    read + offset(read)
                };
                let exchange = Exchange {
                    sent: self.host(self.at),
                    received: self.host(read + back),
                    stamp,
                };
                self.tracker.add(asked, exchange);
                self.exchanges.push((asked, exchange));
            }
        }
    }

    fn twist(&mut self, at: f64) {
        assert!(self.tracker.add_relation(&twist(at, 3e-6)));
    }

    /// Returns the current error and its 1-sigma, µs.
    fn error_us(&self) -> (f64, f64) {
        let found = self.tracker.offset_at(self.host(self.at)).unwrap();
        ((found.value - offset(self.at)) * 1e6, found.sigma * 1e6)
    }
}

#[test]
fn a_warming_clock_is_followed() {
    let mut world = World::new();
    world.run(40.0);
    world.twist(35.0);
    let mut squares = 0.0;
    let looks = 50;
    for look in 1..=looks {
        world.run(40.0 + 10.0 * f64::from(look));
        let (error, sigma) = world.error_us();
        squares += (error / sigma).powi(2) / f64::from(looks);
        assert!(error.abs() < 10.0 && sigma < 10.0, "{error} ± {sigma}");
    }
    // The twist's own error, one sigma, is in all of them.
    assert!((0.3..1.5).contains(&squares.sqrt()), "{squares}");
    let relation = world.tracker.relation_at(world.host(world.at)).unwrap();
    assert!((relation.skew - 21.87e-6).abs() < 0.15e-6, "{relation:?}");
}

#[test]
fn a_step_of_the_asymmetry_is_no_step_of_the_clocks() {
    for (there, back) in [(4e-4, 0.0), (0.0, 3e-4), (-1e-4, -3e-4)] {
        let mut world = World::new();
        world.run(60.0);
        world.twist(35.0);
        let (before, _) = world.error_us();
        world.least[1][0] += there;
        world.least[1][1] += back;
        world.run(180.0);
        let (error, sigma) = world.error_us();
        // Half of the step is 150 µs and more.
        assert!((error - before).abs() < 40.0, "{before} {error} ± {sigma}");
        assert!(error.abs() < 3.5 * sigma, "{error} ± {sigma}");
    }
}

#[test]
fn a_time_server_may_steer_the_computers_clock() {
    let mut world = World::new();
    world.run(60.0);
    world.twist(35.0);
    world.computer = (40e-6, world.at, world.host(world.at) - 500.0 - world.at);
    for until in [62.0, 66.0, 90.0] {
        world.run(until);
        let (error, sigma) = world.error_us();
        assert!(
            error.abs() < 3.0 * sigma && error.abs() < 10.0,
            "{error} ± {sigma}"
        );
    }
}

#[test]
fn in_a_gap_it_becomes_less_certain_and_finds_back() {
    let mut world = World::new();
    world.run(60.0);
    world.twist(35.0);
    let (_, before) = world.error_us();
    world.at += 120.0;
    let (error, sigma) = world.error_us();
    assert!(
        sigma > 1.5 * before && error.abs() < 3.0 * sigma,
        "{error} ± {sigma}"
    );
    let last = world.tracker.last_window(Asked::B).unwrap();
    assert!(world.host(world.at) - last > 119.0);
    world.run(260.0);
    let (error, sigma) = world.error_us();
    assert!(
        error.abs() < 3.0 * sigma && sigma < 15.0,
        "{error} ± {sigma}"
    );
}

/// Two twists ten minutes apart; a step of the asymmetry between them, and another twist
/// that contradicts.
#[test]
fn exchanges_join_the_twists_afterwards_and_a_wrong_twist_is_ignored() {
    let mut world = World::new();
    world.run(300.0);
    world.least[1][0] += 4e-4;
    world.run(640.0);
    let known = [twist(35.0, 3e-6), twist(400.0, 5e-4), twist(620.0, -3e-6)];
    let knots = followed(&world.exchanges, &known);
    assert_eq!(knots.len(), 65);
    let mut squares = 0.0;
    for knot in &knots {
        let error = (knot.offset - offset(knot.reference)) * 1e6;
        let sigma = knot.covariance[0][0].sqrt() * 1e6;
        assert!(error.abs() < 12.0 && sigma < 20.0, "{error} ± {sigma}");
        squares += (error / sigma).powi(2) / knots.len() as f64;
    }
    assert!(squares < 2.0, "{squares}");
    // Alone, the two twists are off by the warming between them.
    let alone = ClockCourse::from_estimates(&[known[0], known[2]], Wander::default()).unwrap();
    assert!((alone.at(200.0).offset - offset(200.0)).abs() > 30e-6);
    let joined = alone.with_followed(&knots);
    assert!((joined.at(205.0).offset - offset(205.0)).abs() < 12e-6);
    assert_eq!(followed(&[], &known), []);
}

#[test]
fn invalid_exchanges_are_ignored() {
    let mut tracker = Tracker::default();
    let nothing = format!("{tracker:?}");
    let good = Exchange {
        sent: 1.0,
        received: 1.001,
        stamp: 5.0,
    };
    for bad in [
        Exchange {
            sent: f64::NAN,
            ..good
        },
        Exchange {
            received: 0.9,
            ..good
        },
        Exchange {
            stamp: f64::INFINITY,
            ..good
        },
    ] {
        assert!(!tracker.add(Asked::B, bad));
        assert_eq!(format!("{tracker:?}"), nothing);
    }
    assert!(!tracker.add(Asked::B, good));
    assert_ne!(format!("{tracker:?}"), nothing);
    assert_eq!(tracker.offset_at(1.0), None);
}
