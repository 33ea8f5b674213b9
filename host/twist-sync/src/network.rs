//! Several devices: one consistent solution from the relations of their pairs.
//!
//! Of `n` devices there are up to `n·(n−1)/2` relations, and any three of them form a loop:
//! from the first to the second, on to the third and back one must arrive where one
//! started. By how much one does not is the loop's *closure error*. It needs no truth.
//!
//! At an instant `t` of the first device the offsets `x_i` (clock of device i minus clock
//! of the first) are the least squares of `o_ij − (x_j − x_i)` over all pairs, each weighted
//! by its variance. What is stated as variance of `x_i` is that of the best *chain* of
//! pairs from the first device, not that of the least squares: the pairs share recordings,
//! so their errors are not independent, and a device's own error (its noise, its faulty
//! stamps) does not become smaller by going another way round.
//!
//! For the same reason loops close better than the sum of their variances says, and what
//! belongs to one device (the delay of its low-pass filter) cancels in every loop: a loop
//! that closes shows that its lags and stretches are right, not that the delays are.

use nalgebra::{DMatrix, DVector};

use crate::clock::WithSigma;
use crate::course::ClockCourse;

/// The relation of two of the devices, with the first as clock a.
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// Number of the device with clock a, from 0.
    pub a: usize,
    /// Number of the device with clock b, larger than `a`.
    pub b: usize,
    /// The relation of the clocks.
    pub course: ClockCourse,
}

/// The clocks of several devices against that of the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    devices: usize,
    pairs: Vec<Pair>,
}

/// A loop of three devices at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closure {
    /// The devices, in rising order.
    pub devices: [usize; 3],
    /// By how much the loop does not close, with the sum of its pairs' variances.
    pub error: WithSigma,
}

/// Devices that no chain of relations joins to the first.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no chain of relations leads from the first device to number {}", numbers(.0))]
pub struct Unjoined(pub Vec<usize>);

/// Counted from one, as people do.
fn numbers(devices: &[usize]) -> String {
    let numbers: Vec<String> = devices.iter().map(|k| (k + 1).to_string()).collect();
    numbers.join(", ")
}

impl Network {
    /// Of so many devices; pairs of others are ignored.
    ///
    /// # Errors
    ///
    /// Devices that are not joined to the first.
    pub fn new(devices: usize, pairs: Vec<Pair>) -> Result<Self, Unjoined> {
        let known = |pair: &Pair| pair.a < pair.b && pair.b < devices;
        let pairs: Vec<Pair> = pairs.into_iter().filter(known).collect();
        let mut joined = vec![false; devices];
        joined.iter_mut().take(1).for_each(|first| *first = true);
        for _ in 0..devices {
            for pair in &pairs {
                let either = joined[pair.a] || joined[pair.b];
                (joined[pair.a], joined[pair.b]) = (either, either);
            }
        }
        let apart: Vec<usize> = (0..devices).filter(|&k| !joined[k]).collect();
        if apart.is_empty() {
            Ok(Self { devices, pairs })
        } else {
            Err(Unjoined(apart))
        }
    }

    /// The offset of each device's clock against the first one's (its own: zero) at a time
    /// of the first device, seconds.
    #[must_use]
    pub fn at(&self, first_s: f64) -> Vec<WithSigma> {
        let chains = self.chains(first_s);
        let unknown = self.devices.saturating_sub(1);
        let mut normal = DMatrix::<f64>::zeros(unknown, unknown);
        let mut right = DVector::<f64>::zeros(unknown);
        for pair in &self.pairs {
            let there = pair.course.at(first_s + chains[pair.a].value);
            let weight = 1.0 / there.covariance[0][0].max(f64::MIN_POSITIVE);
            // What the pair says beyond the chains, so that no digits are lost.
            let more = there.offset - (chains[pair.b].value - chains[pair.a].value);
            for (device, sign) in [(pair.a, -1.0), (pair.b, 1.0)] {
                let Some(row) = device.checked_sub(1) else {
                    continue;
                };
                normal[(row, row)] += weight;
                right[row] += sign * weight * more;
                if let Some(other) = (pair.a + pair.b - device).checked_sub(1) {
                    normal[(row, other)] -= weight;
                }
            }
        }
        let moved = normal.cholesky().map(|found| found.solve(&right));
        let mut out = chains;
        for (offset, by) in out
            .iter_mut()
            .skip(1)
            .zip(moved.iter().flat_map(|m| m.iter()))
        {
            offset.value += by;
        }
        out
    }

    /// Offsets along the chain of pairs with the least variance (Bellman and Ford).
    fn chains(&self, first_s: f64) -> Vec<WithSigma> {
        let far = WithSigma {
            value: 0.0,
            sigma: f64::INFINITY,
        };
        let mut out = vec![far; self.devices];
        out.iter_mut().take(1).for_each(|first| first.sigma = 0.0);
        for _ in 1..self.devices {
            for pair in &self.pairs {
                let (a, b) = (out[pair.a], out[pair.b]);
                if a.sigma.is_finite() {
                    let there = pair.course.at(first_s + a.value).offset_here();
                    let sigma = a.sigma.hypot(there.sigma);
                    if sigma < b.sigma {
                        let value = a.value + there.value;
                        out[pair.b] = WithSigma { value, sigma };
                    }
                }
                let b = out[pair.b];
                if b.sigma.is_finite() {
                    let of_b = first_s + b.value;
                    let there = pair.course.at(pair.course.b_to_a(of_b)).offset_here();
                    let sigma = b.sigma.hypot(there.sigma);
                    if sigma < out[pair.a].sigma {
                        let value = b.value - there.value;
                        out[pair.a] = WithSigma { value, sigma };
                    }
                }
            }
        }
        out
    }

    /// The loops of three devices whose pairs are all related, at a time of the first
    /// device, seconds.
    #[must_use]
    pub fn closures(&self, first_s: f64) -> Vec<Closure> {
        let offsets = self.at(first_s);
        let pair = |a: usize, b: usize| self.pairs.iter().find(|p| (p.a, p.b) == (a, b));
        let mut out = Vec::new();
        for a in 0..self.devices {
            for b in a + 1..self.devices {
                for c in b + 1..self.devices {
                    let (Some(ab), Some(bc), Some(ac)) = (pair(a, b), pair(b, c), pair(a, c))
                    else {
                        continue;
                    };
                    let at = |k: usize| first_s + offsets[k].value;
                    let [ab, bc, ac] = [(ab, a), (bc, b), (ac, a)].map(|(p, k)| p.course.at(at(k)));
                    let variance: f64 = [ab, bc, ac].iter().map(|r| r.covariance[0][0]).sum();
                    out.push(Closure {
                        devices: [a, b, c],
                        error: WithSigma {
                            value: ab.offset + bc.offset - ac.offset,
                            sigma: variance.max(0.0).sqrt(),
                        },
                    });
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::{ClockRelation, Wander};

    fn pair(a: usize, b: usize, offset: f64, sigma: f64) -> Pair {
        let relation = ClockRelation {
            reference: 100.0,
            offset,
            skew: 0.0,
            covariance: [[sigma * sigma, 0.0], [0.0, 0.0]],
            wander: Wander(0.0),
        };
        let course = ClockCourse::from_estimates(&[relation], Wander(0.0)).unwrap();
        Pair { a, b, course }
    }

    #[test]
    fn a_loop_that_does_not_close_is_shared_by_its_pairs() {
        let pairs = vec![
            pair(0, 1, 5.0, 1e-6),
            pair(1, 2, 2.0, 1e-6),
            pair(0, 2, 7.0 + 3e-6, 1e-6),
        ];
        let network = Network::new(3, pairs).unwrap();
        let found = network.at(100.0);
        assert_eq!(
            found[0],
            WithSigma {
                value: 0.0,
                sigma: 0.0
            }
        );
        assert!((found[1].value - (5.0 + 1e-6)).abs() < 1e-9, "{found:?}");
        assert!((found[2].value - (7.0 + 2e-6)).abs() < 1e-9, "{found:?}");
        // Two pairs more are no second opinion.
        assert!((found[2].sigma - 1e-6).abs() < 1e-12);
        let [closure] = network.closures(100.0)[..] else {
            panic!("one loop");
        };
        assert_eq!(closure.devices, [0, 1, 2]);
        assert!((closure.error.value + 3e-6).abs() < 1e-9);
        assert!((closure.error.sigma - 3.0_f64.sqrt() * 1e-6).abs() < 1e-12);
    }

    #[test]
    fn a_chain_leads_around_a_missing_pair_in_either_direction() {
        // 0 – 2 and 1 – 2: device 1 is reached through 2, against the pair's direction.
        let pairs = vec![pair(1, 2, 3.0, 4e-6), pair(0, 2, 10.0, 3e-6)];
        let network = Network::new(3, pairs.clone()).unwrap();
        let found = network.at(100.0);
        assert!((found[1].value - 7.0).abs() < 1e-9);
        assert!((found[1].sigma - 5e-6).abs() < 1e-12);
        assert!(network.closures(100.0).is_empty());
        let error = Network::new(4, pairs).unwrap_err();
        assert_eq!(error, Unjoined(vec![3]));
        assert!(error.to_string().ends_with("number 4"));
    }
}
