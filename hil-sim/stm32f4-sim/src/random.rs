//! All randomness of a run, from one seed.
//!
//! The generator is ChaCha with 8 rounds (`rand_chacha::ChaCha8Rng`, a portable
//! algorithm with published reference vectors). Every part draws from a numbered
//! stream of its own, so that a change in one model, or a model left out, does
//! not change what the others see. The chip's own streams are 19, 20, 28 and 29. Normal
//! deviates are made by the ziggurat of `rand_distr`.
//!
//! The same seed gives the same numbers on every machine up to the last bit of
//! `exp` and `ln` in the ziggurat's rare outer strips.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};
use serde::{Deserialize, Serialize};

/// The stream of the noise in the RAM at power-on.
pub(crate) const RAM_STREAM: u64 = 19;
/// The stream of the damage to bytes on the USB link.
pub(crate) const USB_STREAM: u64 = 20;
/// The stream of the chip's random number generator.
pub(crate) const RNG_STREAM: u64 = 28;
/// The stream of the bus errors that the I2C peripheral reports without there being one.
pub(crate) const BUS_ERROR_STREAM: u64 = 29;

/// The seed of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Seed(pub u64);

impl Seed {
    /// The stream of random numbers for one use.
    #[must_use]
    pub fn stream(self, number: impl Into<u64>) -> Random {
        let mut rng = ChaCha8Rng::seed_from_u64(self.0);
        rng.set_stream(number.into());
        Random(rng)
    }
}

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random(ChaCha8Rng);

impl Random {
    /// The next 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A whole number below `end`; 0 if that is 0.
    pub fn below(&mut self, end: usize) -> usize {
        (self.bits() % (end as u64).max(1)) as usize
    }

    /// One of these, of which there must be one at least.
    pub fn one_of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Fills a slice with random bytes.
    pub fn fill(&mut self, bytes: &mut [u8]) {
        self.0.fill_bytes(bytes);
    }

    /// Uniform in `low..high`, with 53 random bits.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64);
        low + (high - low) * unit
    }

    /// Normal with mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Three independent [`Random::normal`].
    pub fn normal3(&mut self) -> [f64; 3] {
        [self.normal(), self.normal(), self.normal()]
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform(0.0, 1.0) < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_and_uniform_have_their_moments() {
        let mut r = Seed(3).stream(15u64);
        let n = 100_000;
        let (mut s, mut s2, mut u) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = r.normal();
            s += x;
            s2 += x * x;
            u += r.uniform(2.0, 4.0);
        }
        let n = f64::from(n);
        assert!((s / n).abs() < 0.02);
        assert!((s2 / n - 1.0).abs() < 0.02);
        assert!((u / n - 3.0).abs() < 0.01);
    }
}
