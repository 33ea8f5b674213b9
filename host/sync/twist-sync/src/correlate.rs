//! Cross-correlation over all lags by FFT.

use rustfft::algorithm::Radix4;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftDirection, Length};

pub(crate) type Spectrum = Vec<Complex<f64>>;

/// Plans for signals of one length.
pub(crate) struct Correlator {
    forward: Radix4<f64>,
    inverse: Radix4<f64>,
}

impl Correlator {
    /// Plans for two signals that have `length` values together, so that no lag wraps.
    pub(crate) fn new(length: usize) -> Self {
        let plan = |direction| Radix4::new(length.next_power_of_two(), direction);
        Self {
            forward: plan(FftDirection::Forward),
            inverse: plan(FftDirection::Inverse),
        }
    }

    pub(crate) fn spectrum(&self, values: impl Iterator<Item = f64>) -> Spectrum {
        let mut signal = Vec::with_capacity(self.forward.len());
        signal.extend(values.map(Complex::from));
        signal.resize(self.forward.len(), Complex::ZERO);
        self.forward.process(&mut signal);
        signal
    }

    /// Computes `Σ first[i] · second[i + lag]` from two spectra; negative lags are at the end.
    pub(crate) fn correlation(&self, first: &Spectrum, second: &Spectrum) -> Vec<f64> {
        let both = second.iter().zip(first);
        let mut product: Spectrum = both
            .map(|(later, earlier)| later * earlier.conj())
            .collect();
        self.inverse.process(&mut product);
        let scale = 1.0 / product.len() as f64;
        product.iter().map(|value| value.re * scale).collect()
    }

    /// Index of a lag in the result of [`Self::correlation`].
    pub(crate) fn place(&self, lag: i64) -> usize {
        lag.rem_euclid(self.forward.len() as i64) as usize
    }
}
