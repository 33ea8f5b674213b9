//! Cross-correlation over all lags by FFT.

use rustfft::algorithm::Radix4;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftDirection, Length};

/// Plans for signals of one length.
pub(crate) struct Correlator {
    forward: Radix4<f64>,
    inverse: Radix4<f64>,
}

impl Correlator {
    /// For two signals that have `length` values together, so that no lag wraps.
    pub(crate) fn new(length: usize) -> Self {
        let plan = |direction| Radix4::new(length.next_power_of_two(), direction);
        Self {
            forward: plan(FftDirection::Forward),
            inverse: plan(FftDirection::Inverse),
        }
    }

    pub(crate) fn spectrum(&self, values: impl Iterator<Item = f64>) -> Vec<Complex<f64>> {
        let mut signal: Vec<_> = values.map(Complex::from).collect();
        signal.resize(self.forward.len(), Complex::ZERO);
        self.forward.process(&mut signal);
        signal
    }

    /// `Σ first[i] · second[i + lag]` of two spectra; negative lags at the end.
    pub(crate) fn correlation(&self, first: &[Complex<f64>], second: &[Complex<f64>]) -> Vec<f64> {
        let mut product: Vec<Complex<f64>> = second
            .iter()
            .zip(first)
            .map(|(later, earlier)| later * earlier.conj())
            .collect();
        self.inverse.process(&mut product);
        let size = product.len() as f64;
        product.iter().map(|value| value.re / size).collect()
    }

    /// Index of a lag in the result of [`Self::correlation`].
    pub(crate) fn place(&self, lag: i64) -> usize {
        lag.rem_euclid(self.forward.len() as i64) as usize
    }
}
