//! Statistics of a feature, as `meta/stats.json` has them.

use serde_json::{Value, json};

/// Of each channel of images, or of one number a row.
#[derive(Clone, Debug)]
pub(super) struct Stats {
    channels: Vec<Channel>,
    /// Rows.
    count: u64,
}

#[derive(Clone, Copy, Debug)]
struct Channel {
    least: f64,
    most: f64,
    values: u64,
    mean: f64,
    /// Sum of the squared distances from the mean.
    spread: f64,
}

impl Channel {
    const NONE: Self = Self {
        least: f64::INFINITY,
        most: f64::NEG_INFINITY,
        values: 0,
        mean: 0.0,
        spread: 0.0,
    };

    /// Of both.
    fn joined(self, other: Self) -> Self {
        if other.values == 0 {
            return self;
        }
        let values = self.values + other.values;
        let share = other.values as f64 / values as f64;
        let step = other.mean - self.mean;
        Self {
            least: self.least.min(other.least),
            most: self.most.max(other.most),
            values,
            mean: self.mean + step * share,
            spread: self.spread + other.spread + step * step * self.values as f64 * share,
        }
    }
}

impl Stats {
    /// Of nothing yet.
    pub(super) fn new(channels: usize) -> Self {
        Self {
            channels: vec![Channel::NONE; channels],
            count: 0,
        }
    }

    /// Of one number a row.
    pub(super) fn of_numbers(numbers: impl Iterator<Item = f64>) -> Self {
        let mut stats = Self::new(1);
        for number in numbers {
            stats.channels[0] = stats.channels[0].joined(Channel {
                least: number,
                most: number,
                values: 1,
                mean: number,
                spread: 0.0,
            });
            stats.count += 1;
        }
        stats
    }

    /// Of an image, pixel by pixel; `full` is 1.
    pub(super) fn of_image(channels: usize, full: f64, values: impl Iterator<Item = u16>) -> Self {
        let mut sums = vec![(u16::MAX, 0_u16, 0_u64, 0_u64, 0_u64); channels];
        for (value, place) in values.zip((0..channels).cycle()) {
            let (least, most, count, sum, squares) = &mut sums[place];
            *least = value.min(*least);
            *most = value.max(*most);
            *count += 1;
            *sum += u64::from(value);
            *squares += u64::from(value).pow(2);
        }
        let channel = |&(least, most, values, sum, squares): &(u16, u16, u64, u64, u64)| {
            if values == 0 {
                return Channel::NONE;
            }
            // Whole numbers: nothing is lost between large sums.
            let spread = u128::from(values) * u128::from(squares) - u128::from(sum).pow(2);
            Channel {
                least: f64::from(least) / full,
                most: f64::from(most) / full,
                values,
                mean: sum as f64 / values as f64 / full,
                spread: spread as f64 / values as f64 / full.powi(2),
            }
        };
        Self {
            channels: sums.iter().map(channel).collect(),
            count: 1,
        }
    }

    /// Of these rows too.
    pub(super) fn join(&mut self, other: &Self) {
        for (channel, other) in self.channels.iter_mut().zip(&other.channels) {
            *channel = channel.joined(*other);
        }
        self.count += other.count;
    }

    /// As the file has it; each channel of an image stands in lists of its own.
    pub(super) fn json(&self, is_image: bool) -> Value {
        let list = |of: fn(&Channel) -> f64| -> Value {
            let values = self.channels.iter().map(|channel| match is_image {
                true => json!([[of(channel)]]),
                false => json!(of(channel)),
            });
            values.collect()
        };
        json!({
            "min": list(|channel| channel.least),
            "max": list(|channel| channel.most),
            "mean": list(|channel| channel.mean),
            "std": list(|channel| (channel.spread / channel.values.max(1) as f64).sqrt()),
            "count": [self.count],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_and_the_whole_have_the_same_statistics() {
        let values: Vec<u16> = (0..600_u32).map(|k| (k * k % 65_521) as u16).collect();
        let mut joined = Stats::new(3);
        for part in values.chunks(150) {
            joined.join(&Stats::of_image(3, 255.0, part.iter().copied()));
        }
        let found = joined.json(true);
        assert_eq!(found["count"], json!([4]));
        for channel in 0..3 {
            let own: Vec<f64> = values
                .iter()
                .skip(channel)
                .step_by(3)
                .map(|&v| f64::from(v) / 255.0)
                .collect();
            let n = own.len() as f64;
            let mean = own.iter().sum::<f64>() / n;
            let std = (own.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
            for (name, truth) in [
                ("mean", mean),
                ("std", std),
                ("min", own.iter().copied().fold(f64::MAX, f64::min)),
                ("max", own.iter().copied().fold(f64::MIN, f64::max)),
            ] {
                let value = found[name][channel][0][0].as_f64().unwrap();
                assert!(
                    (value - truth).abs() < 1e-9 * truth.max(1.0),
                    "{name}: {value} {truth}"
                );
            }
        }
        let times = Stats::of_numbers([3.0, 5.0].into_iter()).json(false);
        assert_eq!(times["mean"], json!([4.0]));
        assert_eq!(times["std"], json!([1.0]));
    }
}
