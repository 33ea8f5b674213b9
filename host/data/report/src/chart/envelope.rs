//! A series of any length in bounded memory.

/// Number of columns to which an envelope is reduced when it is full.
const COLUMNS: usize = 400;

/// Smallest and largest value in a column of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Middle of the column on the x-axis.
    pub x: f64,
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// Envelope of a series of unknown length, in bounded memory: smallest and largest value in
/// columns of equal width. When the columns are full, pairs of them are joined.
#[derive(Clone, Debug)]
pub struct Envelope {
    start: Option<f64>,
    width: f64,
    columns: Vec<Option<(f64, f64)>>,
}

impl Default for Envelope {
    fn default() -> Self {
        Self {
            start: None,
            width: 0.01,
            columns: Vec::new(),
        }
    }
}

impl Envelope {
    /// Adds a value; times before the first and values that are not finite are ignored.
    pub fn add(&mut self, x: f64, value: f64) {
        if !x.is_finite() || !value.is_finite() {
            return;
        }
        let start = *self.start.get_or_insert(x);
        if x < start {
            return;
        }
        loop {
            let index = (x - start) / self.width;
            if index < (2 * COLUMNS) as f64 {
                let index = index as usize;
                if self.columns.len() <= index {
                    self.columns.resize(index + 1, None);
                }
                if let Some(column) = self.columns.get_mut(index) {
                    *column = Some(column.map_or((value, value), |(low, high)| {
                        (low.min(value), high.max(value))
                    }));
                }
                return;
            }
            self.width *= 2.0;
            self.columns = self.columns.chunks(2).map(extremes).collect();
        }
    }

    /// Returns the columns with values.
    #[must_use]
    pub fn columns(&self) -> Vec<Column> {
        let start = self.start.unwrap_or_default();
        self.columns
            .iter()
            .enumerate()
            .filter_map(|(index, column)| {
                let (low, high) = (*column)?;
                Some(Column {
                    x: start + (index as f64 + 0.5) * self.width,
                    low,
                    high,
                })
            })
            .collect()
    }

    /// Returns the smallest and the largest value of all, or `None` without values.
    #[must_use]
    pub fn extremes(&self) -> Option<(f64, f64)> {
        extremes(&self.columns)
    }

    /// Returns the width of one column.
    #[must_use]
    pub const fn width(&self) -> f64 {
        self.width
    }
}

fn extremes(columns: &[Option<(f64, f64)>]) -> Option<(f64, f64)> {
    let known = columns.iter().flatten().copied();
    known.reduce(|(low, high), (a, b)| (low.min(a), high.max(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_envelope_keeps_every_extreme_and_stays_small() {
        let mut envelope = Envelope::default();
        for k in 0..2_000_000_u32 {
            let value = if k == 1_234_567 {
                99.0
            } else {
                f64::from(k % 7)
            };
            envelope.add(f64::from(k) * 0.002, value);
        }
        let columns = envelope.columns();
        assert!(columns.len() <= 2 * COLUMNS, "{}", columns.len());
        let top = columns
            .iter()
            .max_by(|a, b| a.high.total_cmp(&b.high))
            .unwrap();
        assert_eq!(top.high, 99.0);
        assert!((top.x - 2_469.134).abs() <= envelope.width());
        assert!(columns.iter().all(|column| column.low == 0.0));
    }

    #[test]
    fn an_envelope_takes_any_number() {
        let mut envelope = Envelope::default();
        for x in [0.0, f64::NAN, -1.0, 1e300, f64::INFINITY, 5.0] {
            envelope.add(x, x);
        }
        assert!(envelope.columns().len() <= 2 * COLUMNS);
    }
}
