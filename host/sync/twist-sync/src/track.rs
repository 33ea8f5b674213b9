//! A gyroscope's recording, in memory ([`GyroTrack`]) or streamed ([`GyroStream`]).

use crate::signal::interpolant::Vec3;

/// One sample of a gyroscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroSample {
    /// Time in nanoseconds of the device's clock.
    pub at: i64,
    /// Angular rate about x, y, z in rad/s.
    pub rate: Vec3,
}

/// A gyroscope's samples in order of time, read one by one; reading may fail with `E`.
pub type GyroStream<'a, E> = Box<dyn Iterator<Item = Result<GyroSample, E>> + 'a>;

/// Opens a gyroscope's recording at its beginning; opening may fail with `E`.
pub type GyroOpener<'a, E> = &'a dyn Fn() -> Result<GyroStream<'a, E>, E>;

/// Most samples of a recording that are read into one track: a stream with more of them within
/// some seconds is damaged.
pub(crate) const MOST_SAMPLES: usize = 200_000;

/// A gyroscope's recording in memory: angular rates over time.
///
/// Times are kept relative to `epoch_s`, so that a clock that reads 10⁶ s costs
/// no precision. They need not be equidistant or even sorted:
/// [`crate::estimate_offset`] finds and reports faults of timestamps.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GyroTrack {
    /// The clock's reading at relative time zero, in seconds.
    pub epoch_s: f64,
    /// Sample times relative to the epoch, in seconds.
    pub t: Vec<f64>,
    /// Angular rate about x, y, z in rad/s; as long as `t`.
    pub w: Vec<Vec3>,
}

/// Returns the first time within `near` of the median, so that one wild value at the
/// beginning does not cost the others their precision.
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
    /// Creates a track from times in seconds of the device's clock and as many rates in rad/s.
    #[must_use]
    pub fn from_seconds(times_s: &[f64], w: Vec<Vec3>) -> Self {
        let epoch_s = first_of_the_bulk(times_s, 86_400.0, |x, y| (x - y).abs());
        Self {
            epoch_s,
            t: times_s.iter().map(|t| t - epoch_s).collect(),
            w,
        }
    }

    /// Creates a track from times in nanoseconds of the device's clock and as many rates in
    /// rad/s. Differences of times are computed in integers.
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

    /// Returns the epoch in whole seconds, rounded down.
    pub(crate) fn whole_epoch_s(&self) -> f64 {
        self.epoch_s.floor()
    }

    /// Streams the samples with times in nanoseconds since [`Self::whole_epoch_s`]. Samples whose
    /// time is no later than that of an earlier one are left out.
    pub(crate) fn stream<'a, E: 'a>(&'a self) -> GyroStream<'a, E> {
        let mut last = i64::MIN;
        let samples = self.t.iter().zip(&self.w).filter(|(t, _)| t.is_finite());
        let since_s = self.epoch_s - self.whole_epoch_s();
        let samples = samples.map(move |(t, &rate)| GyroSample {
            at: ((t + since_s) * 1e9).round() as i64,
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

    /// Appends the samples of a later track that lie after the end of this one.
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

    /// Number of times without a rate, or of rates without a time.
    pub(crate) fn unequal(&self) -> usize {
        self.t.len().abs_diff(self.w.len())
    }

    /// Returns the number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// Returns true if there are no samples.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Returns the samples with `from_s <= time < to_s`, in seconds of the device's clock, with
    /// the same epoch.
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
