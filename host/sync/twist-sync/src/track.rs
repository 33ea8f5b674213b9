//! A gyroscope's recording as the sync math takes it.

use crate::signal::interpolant::Vec3;

/// One sample of a gyroscope in its own clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroSample {
    /// Nanoseconds.
    pub at: i64,
    /// Angular rate about x, y, z in rad/s.
    pub rate: Vec3,
}

/// Samples in order of time.
pub type GyroStream<'a, E> = Box<dyn Iterator<Item = Result<GyroSample, E>> + 'a>;

/// Angular rates over time.
///
/// Times are kept relative to `epoch_s`, so that a clock that reads 10⁶ s costs
/// no precision. They need not be equidistant or even sorted: what is wrong
/// with them is found and named by [`crate::estimate_offset`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GyroTrack {
    /// The clock's reading at relative time zero, in seconds.
    pub epoch_s: f64,
    /// Sample times relative to the epoch, in seconds.
    pub t: Vec<f64>,
    /// Angular rate about x, y, z in rad/s; as long as `t`.
    pub w: Vec<Vec3>,
}

/// The first time that is no more than `near` from the median: one wild value at the
/// beginning must not cost the others their digits.
fn first_of_the_bulk<T: Copy + PartialOrd + Default, D: PartialOrd>(
    times: &[T],
    near: D,
    distance: impl Fn(T, T) -> D,
) -> T {
    let mut sorted = times.to_vec();
    sorted.retain(|time| time.partial_cmp(time).is_some());
    let middle = sorted.len() / 2;
    let order = |x: &T, y: &T| x.partial_cmp(y).unwrap_or(std::cmp::Ordering::Equal);
    if sorted.is_empty() {
        return T::default();
    }
    let (_, &mut median, _) = sorted.select_nth_unstable_by(middle, order);
    let mut times = times.iter().copied();
    times
        .find(|&time| distance(time, median) <= near)
        .unwrap_or(median)
}

impl GyroTrack {
    /// From times in seconds of the device's clock.
    #[must_use]
    pub fn from_seconds(times_s: &[f64], w: Vec<Vec3>) -> Self {
        let epoch_s = first_of_the_bulk(times_s, 86_400.0, |x, y| (x - y).abs());
        Self {
            epoch_s,
            t: times_s.iter().map(|t| t - epoch_s).collect(),
            w,
        }
    }

    /// From times in nanoseconds of the device's clock and as many rates; their
    /// differences are taken in integers.
    #[must_use]
    pub fn from_nanos(times: &[i64], w: Vec<Vec3>) -> Self {
        let day = 86_400_000_000_000;
        let epoch = first_of_the_bulk(times, day, |x, y| x.abs_diff(y));
        let since = |&time: &i64| (i128::from(time) - i128::from(epoch)) as f64 * 1e-9;
        // Whole seconds and the rest apart, so that it is rounded once.
        let (whole, rest) = (
            epoch.div_euclid(1_000_000_000),
            epoch.rem_euclid(1_000_000_000),
        );
        Self {
            epoch_s: whole as f64 + rest as f64 * 1e-9,
            t: times.iter().map(since).collect(),
            w,
        }
    }

    pub(crate) fn from_samples(samples: &[GyroSample]) -> Self {
        let times: Vec<i64> = samples.iter().map(|sample| sample.at).collect();
        Self::from_nanos(&times, samples.iter().map(|sample| sample.rate).collect())
    }

    /// The samples in order of time, in nanoseconds from the epoch.
    pub(crate) fn stream<'a, E: 'a>(&'a self) -> GyroStream<'a, E> {
        let mut last = i64::MIN;
        let samples = self.t.iter().zip(&self.w).filter(|(t, _)| t.is_finite());
        let samples = samples.map(|(t, &rate)| GyroSample {
            at: (t * 1e9).round() as i64,
            rate,
        });
        Box::new(
            samples
                .filter(move |sample| {
                    let follows = sample.at > last;
                    last = last.max(sample.at);
                    follows
                })
                .map(Ok),
        )
    }

    /// This track and what a later one has after its end.
    pub(crate) fn followed_by(&self, later: &Self) -> Self {
        let mut out = self.clone();
        let between_s = later.epoch_s - self.epoch_s;
        let last = self.t.last().copied().unwrap_or(f64::NEG_INFINITY);
        for (t, w) in later.t.iter().zip(&later.w) {
            if t + between_s > last {
                out.t.push(t + between_s);
                out.w.push(*w);
            }
        }
        out
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// True without any sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// The samples with `from_s <= time < to_s` (clock readings in seconds);
    /// the epoch stays.
    #[must_use]
    pub fn between(&self, from_s: f64, to_s: f64) -> Self {
        let (from, to) = (from_s - self.epoch_s, to_s - self.epoch_s);
        let mut out = Self {
            epoch_s: self.epoch_s,
            ..Self::default()
        };
        for (&t, &w) in self.t.iter().zip(&self.w) {
            if t >= from && t < to {
                out.t.push(t);
                out.w.push(w);
            }
        }
        out
    }
}
