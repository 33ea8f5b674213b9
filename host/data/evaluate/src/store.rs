//! Row profiles of a recording, in bounded memory.
//!
//! Profiles are small, but an hour of 4K at 60 fps has many. When the store is
//! full it drops about half of its frames and from then on keeps only such
//! frames. Which frames stay is decided by a hash of the frame's number and not by
//! its being even or a multiple of something: the depth camera may flash on every
//! second or sixth frame, and a regular choice could see only those.

use super::frame::RowProfile;

/// Memory for the profiles of one recording, bytes.
pub(crate) const DEFAULT_CAPACITY: usize = 96 << 20;

/// One kept frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoredFrame {
    /// Number of the frame in its recording, from 0.
    pub index: usize,
    /// Seconds since the recording's first frame, in the camera's clock.
    pub time_s: f64,
    /// Mean brightness of the used rows.
    pub rows: Vec<f32>,
}

/// Keeps profiles up to a given amount of memory.
#[derive(Debug, Clone)]
pub(crate) struct ProfileStore {
    frames: Vec<StoredFrame>,
    capacity: usize,
    bytes: usize,
    /// Frames are kept whose hash ends in so many zero bits.
    level: u32,
}

impl ProfileStore {
    /// A store of `capacity` bytes; at least 64 frames are kept in any case.
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            frames: Vec::new(),
            capacity,
            bytes: 0,
            level: 0,
        }
    }

    /// Keeps the frame, or not.
    pub(crate) fn push(&mut self, index: usize, time_s: f64, profile: &RowProfile) {
        if hash(index).trailing_zeros() < self.level {
            return;
        }
        self.bytes += size_of_val(profile.rows.as_slice());
        self.frames.push(StoredFrame {
            index,
            time_s,
            rows: profile.rows.clone(),
        });
        while self.bytes > self.capacity && self.frames.len() > 128 {
            self.level += 1;
            let level = self.level;
            self.frames
                .retain(|f| hash(f.index).trailing_zeros() >= level);
            self.bytes = self
                .frames
                .iter()
                .map(|f| size_of_val(f.rows.as_slice()))
                .sum();
        }
    }

    /// One frame in this many was kept, on average.
    pub(crate) fn one_in(&self) -> u64 {
        1u64.checked_shl(self.level).unwrap_or(u64::MAX)
    }

    /// The kept frames, in order.
    pub(crate) fn into_frames(self) -> Vec<StoredFrame> {
        self.frames
    }
}

/// SplitMix64's finaliser: neighbouring numbers give unrelated bits.
fn hash(index: usize) -> u64 {
    let mut z = (index as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
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
        let mut of_six = [0; 6];
        for f in &frames {
            of_six[f.index % 6] += 1;
        }
        assert!(of_six.iter().all(|&n| n > frames.len() / 12), "{of_six:?}");
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
