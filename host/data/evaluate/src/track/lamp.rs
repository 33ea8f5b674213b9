//! Description of bands that repeat at a frequency of their own, like those of a lamp.

use nalgebra::{Complex, DVector};

use crate::Settings;
use crate::footage::Footage;
use crate::stats::median;
use crate::train::linear::Basis;

/// Frames that are examined.
const FRAMES: usize = 48;
/// Periods in a frame that are tried, and the step.
const PERIODS: [f64; 3] = [2.0, 60.0, 0.25];
/// Share of a frame's structure that the bands must be.
const SHARE: f64 = 0.25;
/// Least coherence of their motion from frame to frame, of 1.
const COHERENT: f64 = 0.8;
/// Least motion of a lamp's bands from frame to frame, as a part of a period; slower bands may
/// be anything.
const MOVES: f64 = 0.01;

/// Bands that repeat over the rows.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bands {
    /// Distance, in rows.
    rows: f64,
    /// Motion from one frame to the next, as a part of a period from -0.5 to 0.5.
    ahead: f64,
    /// Time from frame to frame, seconds.
    frame_s: f64,
}

/// Describes the frequency at which the bands of a recording repeat, if they do.
pub(crate) fn note(footage: &Footage, settings: &Settings) -> Option<String> {
    let bands = bands(footage)?;
    let rate = 1.0 / bands.frame_s;
    let known = settings.row_time_us.or(settings.row_time_hint_us);
    let frequency = match known {
        Some(row_time_us) => {
            let about = 1e6 / (bands.rows * row_time_us);
            let whole = (about * bands.frame_s - bands.ahead).round();
            format!("{:.1} Hz", (whole + bands.ahead) * rate)
        }
        None => format!(
            "a whole multiple of {rate:.2} Hz {} {:.1} Hz",
            if bands.ahead < 0.0 { "less" } else { "and" },
            (bands.ahead * rate).abs()
        ),
    };
    Some(format!(
        "its bands, {:.0} rows apart, move as those of a light would that flickers at {frequency}",
        bands.rows
    ))
}

fn bands(footage: &Footage) -> Option<Bands> {
    let frames = footage.frames.get(..footage.frames.len().min(FRAMES))?;
    let rows = footage.rows.len as f64;
    let smooth = Basis::polynomials(footage.rows.len, 3);
    let profiles: Vec<DVector<f64>> = frames.iter().map(|f| smooth.outside(&f.rows)).collect();
    let total: f64 = profiles.iter().map(DVector::norm_squared).sum();
    let at = |periods: f64| -> Vec<Complex<f64>> {
        let turn = -std::f64::consts::TAU * periods / rows;
        let wave = |(i, v): (usize, &f64)| Complex::from_polar(*v, turn * i as f64);
        let sum = |y: &DVector<f64>| y.iter().enumerate().map(wave).sum();
        profiles.iter().map(sum).collect()
    };
    let power = |waves: &[Complex<f64>]| waves.iter().map(Complex::norm_sqr).sum::<f64>();
    let [from, to, step] = PERIODS;
    let steps = ((to.min(rows / 8.0) - from) / step).max(0.0) as usize;
    let (periods, power) = (0..=steps)
        .map(|i| from + step * i as f64)
        .map(|periods| (periods, power(&at(periods))))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    if 2.0 * power < SHARE * rows * total {
        return None;
    }
    let waves = at(periods);
    let gaps: Vec<f64> = frames
        .windows(2)
        .filter_map(|w| Some(w.get(1)?.time_s - w.first()?.time_s))
        .collect();
    let frame_s = median(&gaps);
    let (mut sum, mut size) = (Complex::new(0.0, 0.0), 0.0);
    for (pair, gap) in waves.windows(2).zip(&gaps) {
        if let [a, b] = pair
            && (gap / frame_s - 1.0).abs() < 0.1
        {
            sum += b * a.conj();
            size += b.norm() * a.norm();
        }
    }
    let ahead = sum.arg() / std::f64::consts::TAU;
    let moves = ahead.abs() > MOVES && sum.norm() > COHERENT * size && frame_s > 0.0;
    moves.then(|| Bands {
        rows: rows / periods,
        ahead,
        frame_s,
    })
}
