//! Row profiles of a recording, in bounded memory.
//!
//! Profiles are small, but an hour of 4K at 60 fps has many. Each frame draws a random
//! level, with half as many frames on each level as on the one below. When the store is
//! full it drops the frames of the lowest level, and ignores such frames from then on. The
//! choice is random because the depth camera may flash on every second or sixth frame, and a
//! regular choice could contain only those. The seed is fixed, so that the same recording
//! gives the same result.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};

use crate::footage::frame::RowProfile;

/// Memory for the profiles of one recording, bytes.
pub(crate) const DEFAULT_CAPACITY: usize = 96 << 20;

/// One retained frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoredFrame {
    /// Number of the frame in its recording, from 0.
    pub index: usize,
    /// Seconds since the recording's first frame, in the camera's clock.
    pub time_s: f64,
    /// Mean brightness of the used rows.
    pub rows: Vec<f32>,
}

/// Store of profiles, up to a given amount of memory.
#[derive(Debug, Clone)]
pub(crate) struct ProfileStore {
    /// Each with its level.
    frames: Vec<(u32, StoredFrame)>,
    capacity: usize,
    bytes: usize,
    /// Lowest level that is retained.
    level: u32,
    random: Pcg64Mcg,
}

impl ProfileStore {
    /// Creates a store of `capacity` bytes; at least 64 frames are retained in any case.
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            frames: Vec::new(),
            capacity,
            bytes: 0,
            level: 0,
            random: Pcg64Mcg::seed_from_u64(0),
        }
    }

    /// Adds the next frame, or ignores it if its level is too low.
    pub(crate) fn push(&mut self, index: usize, time_s: f64, profile: &RowProfile) {
        let level = self.random.next_u64().trailing_zeros();
        if level < self.level {
            return;
        }
        self.bytes += size_of_val(profile.rows.as_slice());
        let rows = profile.rows.clone();
        let frame = StoredFrame {
            index,
            time_s,
            rows,
        };
        self.frames.push((level, frame));
        while self.bytes > self.capacity && self.frames.len() > 128 {
            self.level += 1;
            self.frames.retain(|(level, _)| *level >= self.level);
            let sizes = self.frames.iter();
            self.bytes = sizes.map(|(_, f)| size_of_val(f.rows.as_slice())).sum();
        }
    }

    /// Returns n where one in n frames was retained, on average.
    pub(crate) fn one_in(&self) -> u64 {
        1u64.checked_shl(self.level).unwrap_or(u64::MAX)
    }

    /// Returns the retained frames, in order.
    pub(crate) fn into_frames(self) -> Vec<StoredFrame> {
        self.frames.into_iter().map(|(_, frame)| frame).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_bounded_and_the_choice_has_no_period() {
        let profile = RowProfile {
            rows: vec![0.0; 250],
            saturated: 0.0,
        };
        let capacity = 1000 * 1000;
        let mut store = ProfileStore::new(capacity);
        for i in 0..20_000 {
            store.push(i, i as f64, &profile);
            assert!(store.bytes <= capacity);
        }
        assert!(store.one_in() >= 16);
        let frames = store.into_frames();
        assert!((300..=1000).contains(&frames.len()), "{}", frames.len());
        assert!(frames.is_sorted_by_key(|f| f.index));
        let mut by_remainder = [0; 6];
        for f in &frames {
            by_remainder[f.index % 6] += 1;
        }
        let least = frames.len() / 12;
        assert!(by_remainder.iter().all(|&n| n > least), "{by_remainder:?}");
    }

    #[test]
    fn everything_is_kept_while_there_is_room() {
        let profile = RowProfile {
            rows: vec![0.0; 1080],
            saturated: 0.0,
        };
        let mut store = ProfileStore::new(DEFAULT_CAPACITY);
        for i in 0..9000 {
            store.push(i, 0.0, &profile);
        }
        assert_eq!((store.one_in(), store.into_frames().len()), (1, 9000));
    }
}
