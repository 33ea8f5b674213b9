//! Cross-correlation over all lags by FFT.

use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::sync::Arc;

/// Plans for signals of one length.
pub(crate) struct Correlator {
    size: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
}

impl Correlator {
    /// For two signals that have `length` values together, so that no lag wraps.
    pub(crate) fn new(length: usize) -> Self {
        let size = length.next_power_of_two();
        let mut planner = RealFftPlanner::new();
        Self {
            size,
            forward: planner.plan_fft_forward(size),
            inverse: planner.plan_fft_inverse(size),
        }
    }

    pub(crate) fn spectrum(&self, values: impl Iterator<Item = f64>) -> Vec<Complex<f64>> {
        let mut input = self.forward.make_input_vec();
        for (slot, value) in input.iter_mut().zip(values) {
            *slot = value;
        }
        let mut output = self.forward.make_output_vec();
        // The lengths are the plan's own, so that it cannot fail.
        let _ = self.forward.process(&mut input, &mut output);
        output
    }

    /// `Σ first[i] · second[i + lag]` of two spectra; negative lags at the end.
    pub(crate) fn correlation(&self, first: &[Complex<f64>], second: &[Complex<f64>]) -> Vec<f64> {
        let mut product: Vec<Complex<f64>> = second
            .iter()
            .zip(first)
            .map(|(later, earlier)| later * earlier.conj())
            .collect();
        // The ends of a real signal's spectrum are real; rounding must not leave
        // an imaginary part there, which the inverse refuses.
        for end in [0, product.len() - 1] {
            product[end].im = 0.0;
        }
        let mut output = self.inverse.make_output_vec();
        let _ = self.inverse.process(&mut product, &mut output);
        for value in &mut output {
            *value /= self.size as f64;
        }
        output
    }

    /// Where a lag stands in what [`Self::correlation`] gives.
    pub(crate) fn place(&self, lag: i64) -> usize {
        lag.rem_euclid(self.size as i64) as usize
    }
}
