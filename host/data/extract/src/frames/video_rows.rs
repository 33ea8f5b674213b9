//! Matches the images of a phone's video to the rows of its timestamps.
//!
//! The app writes one timestamp per frame, and the encoder one image per frame. Where
//! the counts agree, they are matched in order; a row that is left out (for a frame that
//! the app received twice, a repeated timestamp) still has its image. Otherwise rows and
//! images are matched by time: the images' presentation times in the video have
//! the same distances as the timestamps (both come from the sensor). If the
//! video is too regular to show which end is missing, the two are assumed to begin together,
//! with a remark.

use crate::time::{PhoneNanos, median_step};

/// Largest number of rows or images that may be missing at the beginning.
const MAX_SHIFT: usize = 600;
/// Largest difference in scatter at which two shifts fit equally well, ns.
const ALIKE: f64 = 200e3;

/// Row of the timestamps for each image of a video.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct VideoRows {
    /// Row of each image.
    pub(crate) rows: Vec<Option<usize>>,
    /// Description of what did not match.
    pub(crate) remark: Option<String>,
}

impl VideoRows {
    /// Matches images and rows in order, for want of presentation times.
    pub(crate) fn in_order(images: usize, rows: usize) -> Self {
        Self {
            rows: (0..images)
                .map(|image| (image < rows).then_some(image))
                .collect(),
            remark: None,
        }
    }

    /// Assumes an image for each row of the timestamps' file, also for one that was left out.
    pub(crate) fn image_per_row(rows: &[Option<PhoneNanos>]) -> Self {
        let mut kept = 0..;
        let place = |row: &Option<PhoneNanos>| row.and_then(|_| kept.next());
        Self {
            rows: rows.iter().map(place).collect(),
            remark: None,
        }
    }
}

/// Matches images (presentation times in ns from the first) to timestamps.
pub(crate) fn match_by_time(images: &[i64], stamps: &[PhoneNanos]) -> VideoRows {
    if images.len() == stamps.len() {
        return VideoRows::in_order(images.len(), stamps.len());
    }
    let remark = format!(
        "the video has {} frames and there are {} timestamps",
        images.len(),
        stamps.len()
    );
    let period = median_step(stamps.iter().map(|stamp| stamp.0)).unwrap_or(0) as f64;
    let mut tries: Vec<Try> = Vec::new();
    // The first image has row k, or the first row has image k.
    let first_image = images.first().copied().unwrap_or(0);
    for shift in 0..MAX_SHIFT {
        let rows = stamps.get(shift).map(|stamp| (stamp, first_image));
        let image = images.get(shift).filter(|_| shift > 0);
        let images_first = stamps.first().zip(image.copied());
        for (stamp, image) in rows.into_iter().chain(images_first) {
            let offset = i128::from(stamp.0) - i128::from(image);
            tries.extend(match_at(images, stamps, offset, period));
        }
    }
    let better = |a: &Try, b: &Try| {
        b.matched
            .cmp(&a.matched)
            .then(a.scatter.total_cmp(&b.scatter))
    };
    tries.sort_by(better);
    let Some(best) = tries.first() else {
        return VideoRows {
            remark: Some(format!(
                "{remark}, and no presentation times to match them by"
            )),
            ..VideoRows::in_order(images.len(), stamps.len())
        };
    };
    let ambiguous = tries.iter().skip(1).any(|other| {
        other.matched == best.matched
            && other.rows != best.rows
            && (other.scatter - best.scatter).abs() < ALIKE
    });
    if ambiguous {
        return VideoRows {
            remark: Some(format!(
                "{remark}; the video is too regular to tell which frames are missing: both are taken \
                 to begin with the same frame"
            )),
            ..VideoRows::in_order(images.len(), stamps.len())
        };
    }
    VideoRows {
        remark: Some(format!(
            "{remark}; matched by time, {} timestamps have no image and {} images no timestamp",
            stamps.len() - best.matched,
            images.len() - best.matched
        )),
        rows: best.rows.clone(),
    }
}

struct Try {
    matched: usize,
    scatter: f64,
    rows: Vec<Option<usize>>,
}

/// Matches each image to the nearest row at an offset.
fn match_at(images: &[i64], stamps: &[PhoneNanos], offset: i128, period: f64) -> Option<Try> {
    if period <= 0.0 {
        return None;
    }
    let mut rows = Vec::with_capacity(images.len());
    let (mut next, mut used) = (0, None);
    let (mut matched, mut squares) = (0_usize, 0.0);
    for &image in images {
        let at = i128::from(image) + offset;
        let distance = |row: usize| (i128::from(stamps[row].0) - at).unsigned_abs();
        while next + 1 < stamps.len() && distance(next + 1) <= distance(next) {
            next += 1;
        }
        let is_near = next < stamps.len() && (distance(next) as f64) < period * 0.4;
        if is_near && used != Some(next) {
            used = Some(next);
            matched += 1;
            squares += (distance(next) as f64).powi(2);
            rows.push(Some(next));
        } else {
            rows.push(None);
        }
    }
    Some(Try {
        matched,
        scatter: (squares / matched.max(1) as f64).sqrt(),
        rows,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamps(count: i64) -> Vec<PhoneNanos> {
        // As regular as a real phone's, to a microsecond.
        (0..count)
            .map(|i| PhoneNanos(949_000_000_000_000 + i * 33_330_652 + (i * 7919 % 13) * 100))
            .collect()
    }

    fn presentation(stamps: &[PhoneNanos]) -> Vec<i64> {
        // Presentation times are multiples of 1/90000 s.
        let tick = |ns: i64| ns * 90 / 1_000_000 * 1_000_000 / 90;
        stamps.iter().map(|at| tick(at.0 - stamps[0].0)).collect()
    }

    #[test]
    fn equal_counts_belong_together() {
        let rows = stamps(100);
        let found = match_by_time(&presentation(&rows), &rows);
        assert_eq!(found, VideoRows::in_order(100, 100));
    }

    #[test]
    fn a_row_that_was_left_out_has_its_image() {
        let mut rows: Vec<Option<PhoneNanos>> = stamps(4).into_iter().map(Some).collect();
        rows[1] = None;
        let found = VideoRows::image_per_row(&rows);
        assert_eq!(found.rows, [Some(0), None, Some(1), Some(2)]);
    }

    #[test]
    fn images_lost_in_the_middle_are_found_by_time() {
        let rows = stamps(300);
        let mut kept = rows.clone();
        kept.drain(100..103);
        kept.remove(200);
        let found = match_by_time(&presentation(&kept), &rows);
        for (image, row) in found.rows.iter().enumerate() {
            assert_eq!(row.map(|row| rows[row]), Some(kept[image]));
        }
        let remark = found.remark.unwrap();
        let lost = "4 timestamps have no image and 0 images no timestamp";
        assert!(remark.contains(lost), "{remark}");
    }

    #[test]
    fn a_regular_video_short_of_a_frame_is_ambiguous() {
        let rows = stamps(300);
        let found = match_by_time(&presentation(&rows[..299]), &rows);
        assert!(found.remark.unwrap().contains("too regular"));
        assert_eq!(found.rows, VideoRows::in_order(299, 300).rows);
    }

    /// Images without a timestamp between two that belong together.
    #[test]
    fn each_timestamp_has_one_image_at_most() {
        let stamps = [0, 33_300_000].map(PhoneNanos);
        let found = match_by_time(&[0, 1, 2, 3, 4, 33_300_000], &stamps);
        let matched = found.rows.iter().flatten();
        assert_eq!(matched.collect::<Vec<_>>(), [&0, &1], "{found:?}");
        let remark = found.remark.unwrap();
        let lost = "0 timestamps have no image and 4 images no timestamp";
        assert!(remark.contains(lost), "{remark}");
    }

    #[test]
    fn nothing_to_match_does_not_panic() {
        assert_eq!(
            match_by_time(&[], &stamps(3)).rows,
            Vec::<Option<usize>>::new()
        );
        assert_eq!(match_by_time(&[0, 5], &[]).rows, [None, None]);
        let _ = match_by_time(
            &[i64::MIN, i64::MAX, 0],
            &[PhoneNanos(i64::MAX), PhoneNanos(i64::MIN)],
        );
    }
}
