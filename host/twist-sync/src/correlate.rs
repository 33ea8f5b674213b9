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
    /// For two signals that have `length` values together, so that no lag wraps.
    pub(crate) fn new(length: usize) -> Self {
        let plan = |direction| Radix4::new(length.next_power_of_two(), direction);
        Self {
            forward: plan(FftDirection::Forward),
            inverse: plan(FftDirection::Inverse),
        }
    }

    pub(crate) fn spectrum(&self, values: impl Iterator<Item = f64>) -> Spectrum {
        self.transformed(values.map(Complex::from))
    }

    /// Spectra of two signals, which the real and the imaginary parts are, by one transform.
    pub(crate) fn spectra(&self, both: impl Iterator<Item = Complex<f64>>) -> [Spectrum; 2] {
        let mixed = self.transformed(both);
        let size = mixed.len();
        // The spectrum of a real signal is its own mirror image, conjugated.
        let mirrored = |k: usize| mixed[(size - k) % size].conj();
        let half = |z: Complex<f64>| Complex::new(0.5 * z.re, 0.5 * z.im);
        let real = (0..size).map(|k| half(mixed[k] + mirrored(k))).collect();
        let turned = |z: Complex<f64>| Complex::new(z.im, -z.re);
        let imaginary = (0..size).map(|k| turned(half(mixed[k] - mirrored(k))));
        [real, imaginary.collect()]
    }

    fn transformed(&self, values: impl Iterator<Item = Complex<f64>>) -> Spectrum {
        let mut signal = Vec::with_capacity(self.forward.len());
        signal.extend(values);
        signal.resize(self.forward.len(), Complex::ZERO);
        self.forward.process(&mut signal);
        signal
    }

    /// `Σ first[i] · second[i + lag]` of two pairs of spectra, as the real and the imaginary
    /// parts; negative lags at the end.
    pub(crate) fn correlations(&self, pairs: [(&Spectrum, &Spectrum); 2]) -> Spectrum {
        let [one, other] = pairs.map(|(first, second)| {
            let both = second.iter().zip(first);
            both.map(|(later, earlier)| later * earlier.conj())
        });
        let mut sum: Spectrum = one
            .zip(other)
            .map(|(x, y): (Complex<f64>, Complex<f64>)| Complex::new(x.re - y.im, x.im + y.re))
            .collect();
        self.inverse.process(&mut sum);
        let scale = 1.0 / sum.len() as f64;
        sum.iter_mut().for_each(|value| *value *= scale);
        sum
    }

    /// Index of a lag in the result of [`Self::correlations`].
    pub(crate) fn place(&self, lag: i64) -> usize {
        lag.rem_euclid(self.forward.len() as i64) as usize
    }
}
