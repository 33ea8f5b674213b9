//! The low-pass filter of the other gyroscope.
//!
//! A low-pass of second order, `1 / (1 + D·s + γ·D²·s²)` with the delay `D`, is nearly a delay for
//! slow motion only. If it is long, each stream passes through the filter of the other, so that
//! both have been through the same.

use crate::signal::interpolant::Vec3;

/// Delay above which a filter is more than its delay and dispersion, seconds: the next term of
/// Butterworth's phase, `0.05·D⁵·ω⁴`, is 0.2 µs at 5 Hz, a tenth of what a twist resolves.
pub(crate) const LONG_S: f64 = 5e-3;
/// `γ` of two equal poles, of Butterworth's filter, and between them.
pub(crate) const SHAPES: [f64; 3] = [0.25, 0.375, 0.5];

/// Largest shape: poles with a damping ratio of 0.63.
const MOST: f64 = 0.63;

/// Returns the shape of least residual, as the parabola through those of three shapes has it, each
/// with its squared residual, in order; `None` if no filter of two poles has it.
pub(crate) fn likeliest([low, middle, high]: [(f64, f64); 3]) -> Option<f64> {
    let slope = |x: (f64, f64), y: (f64, f64)| (y.1 - x.1) / (y.0 - x.0);
    let (first, second) = (slope(low, middle), slope(middle, high));
    let bent = (second - first) / (high.0 - low.0);
    let vertex = 0.5 * (low.0 + middle.0 - first / bent);
    (bent > 0.0 && (SHAPES[0]..=MOST).contains(&vertex)).then_some(vertex)
}

/// Filters rates at increasing times, exactly if they change linearly from one to the next: what
/// differs from the answer to a ramp decays.
pub(crate) fn filtered(t: &[f64], w: &[Vec3], delay_s: f64, shape: f64) -> Vec<Vec3> {
    let square = shape * delay_s * delay_s;
    let decay = 0.5 * delay_s / square;
    let turn = (1.0 / square - decay * decay).max(0.0).sqrt();
    // Rate and its derivative, which begin at rest.
    let mut state = w.first().map_or([[0.0; 2]; 3], |w| w.map(|x| [x, 0.0]));
    let mut before = 0;
    let step = |k: usize| {
        let dt = t[k] - t[before];
        let (sin, cos) = (turn * dt).sin_cos();
        let sin = if turn > 0.0 { sin / turn } else { dt };
        let left = (-decay * dt).exp();
        for axis in 0..3 {
            let (from, to) = (w[before][axis], w[k][axis]);
            let slope = if dt > 0.0 { (to - from) / dt } else { 0.0 };
            let [value, rate] = &mut state[axis];
            let (own, turned) = (*value - (from - slope * delay_s), *rate - slope);
            *value = to - slope * delay_s + left * (own * (cos + decay * sin) + turned * sin);
            *rate = slope + left * (turned * (cos - decay * sin) - own * sin / square);
        }
        before = k;
        state.map(|axis| axis[0])
    };
    (0..t.len()).map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slow wave keeps to the filter's transfer function.
    #[test]
    fn a_wave_is_delayed_and_damped_as_the_transfer_function_says() {
        let (delay_s, omega) = (0.02_f64, 25.0_f64);
        let t: Vec<f64> = (0..4000)
            .map(|k| 1e-3 * f64::from(k) + 1e-4 * f64::from(k % 3))
            .collect();
        let w: Vec<Vec3> = t.iter().map(|t| [(omega * t).sin(); 3]).collect();
        for shape in SHAPES {
            let out = filtered(&t, &w, delay_s, shape);
            let real = 1.0 - shape * (delay_s * omega).powi(2);
            let imaginary = delay_s * omega;
            let (gain, phase) = (real.hypot(imaginary).recip(), -imaginary.atan2(real));
            for (t, out) in t.iter().zip(&out).skip(1000) {
                let expected = gain * (omega * t + phase).sin();
                assert!((out[1] - expected).abs() < 2e-4, "{shape} {t}");
            }
        }
    }
}
