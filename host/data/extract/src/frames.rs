//! Frames of the phone and of the depth camera, with their times in board time.

pub(crate) mod pairs;
pub(crate) mod trigger_offset;
pub(crate) mod video_rows;

use crate::constants::nanos;
use crate::depth::DepthIndex;
use crate::depth::depth_clock::{DepthMatch, FrameState, PulseTime};
use crate::time::{BoardNanos, DeviceNanos, PhoneNanos, PiecewiseMap, SECOND};
use recording::strobes::SeenExposure;

/// A frame of the phone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ColorFrame {
    /// Timestamp on the phone's clock: start of exposure of the first row.
    pub(crate) phone: PhoneNanos,
    /// Board time of the timestamp.
    pub(crate) start: BoardNanos,
    /// Board time of the image: middle of exposure of the middle row.
    pub(crate) at: BoardNanos,
    /// Index of the frame in the video, if it is there.
    pub(crate) image: Option<usize>,
}

/// A frame of the depth camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DepthFrame {
    /// Timestamp on the camera's clock.
    pub(crate) device: DeviceNanos,
    /// Board time of the centre of exposure; `None` if frames and pulses were not matched.
    pub(crate) at: Option<BoardNanos>,
    /// Relation to the pulses; `None` if frames and pulses were not matched.
    pub(crate) state: Option<FrameState>,
    /// Index of the frame's pulse.
    pub(crate) pulse: Option<usize>,
    /// Frame − pulse on the fitted clock, ns.
    pub(crate) residual: i64,
    /// True if the file has all bytes of the image.
    pub(crate) whole: bool,
}

/// A colour image of the depth camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CameraFrame {
    /// Timestamp on the camera's clock: the centre of exposure.
    pub(crate) device: DeviceNanos,
    /// Board time of the timestamp; `None` where the nearest depth frame has none.
    pub(crate) at: Option<BoardNanos>,
}

impl DepthFrame {
    /// Returns true if the frame has a place in the data set.
    pub(crate) fn is_used(&self) -> bool {
        self.at.is_some() && self.whole && self.state != Some(FrameState::Doubled)
    }
}

/// Returns the phone's frames in board time, each `to_middle` (ns) after its timestamp. `images`
/// has the index in the video of each timestamp. Frames that the clock does not map are left out.
pub(crate) fn color_frames(
    stamps: &[PhoneNanos],
    images: &[Option<usize>],
    clock: &PiecewiseMap<PhoneNanos, BoardNanos>,
    to_middle: i64,
) -> Vec<ColorFrame> {
    let frame = |(row, &phone): (usize, &PhoneNanos)| {
        // Exposure and readout elapse on the phone's clock.
        let middle = PhoneNanos(phone.0.saturating_add(to_middle));
        Some(ColorFrame {
            phone,
            start: clock.apply(phone)?,
            at: clock.apply(middle)?,
            image: images.get(row).copied().flatten(),
        })
    };
    stamps.iter().enumerate().filter_map(frame).collect()
}

/// Returns the depth frames in board time: the middle of the exposure that a photodiode saw after
/// their pulse, of those in `seen`, or else `center` (ns) after their pulses.
pub(crate) fn depth_frames(
    index: &DepthIndex,
    found: Option<&DepthMatch>,
    pulses: &[PulseTime],
    seen: &[SeenExposure],
    center: i64,
) -> Vec<DepthFrame> {
    let own = |pulse: Option<usize>| {
        let edge = pulses.get(pulse?)?.at.ticks();
        let place = seen.binary_search_by_key(&edge, |exposure| exposure.edge);
        nanos(seen.get(place.ok()?)?.center_us)
    };
    let frames = index.frames.iter().enumerate();
    frames
        .map(|(number, stamp)| {
            let assigned = found.and_then(|found| found.frames.get(number));
            let pulse = assigned.and_then(|assigned| assigned.pulse);
            // The pulse is exact; without one, the fitted clock is the best estimate.
            let edge = match pulse.and_then(|pulse| pulses.get(pulse)) {
                Some(pulse) => Some(pulse.at),
                None => found.and_then(|found| found.clock.apply(stamp.at)),
            };
            DepthFrame {
                device: stamp.at,
                at: edge.map(|edge| {
                    let center = own(pulse).unwrap_or(center);
                    BoardNanos(edge.0.saturating_add(center))
                }),
                state: assigned.map(|assigned| assigned.state),
                pulse,
                residual: assigned.map_or(0, |assigned| assigned.residual),
                whole: stamp.whole,
            }
        })
        .collect()
}

/// Returns the depth camera's colour images in board time: each is as far from the nearest depth
/// frame as on the camera's clock.
pub(crate) fn camera_frames(
    stamps: &[DeviceNanos],
    depth: &[DepthFrame],
    found: Option<&DepthMatch>,
) -> Vec<CameraFrame> {
    let mut near: Vec<(DeviceNanos, BoardNanos)> = depth
        .iter()
        .filter(|frame| frame.state != Some(FrameState::Doubled))
        .filter_map(|frame| Some((frame.device, frame.at?)))
        .collect();
    near.sort_by_key(|frame| frame.0);
    let board_time = |stamp: DeviceNanos| -> Option<BoardNanos> {
        let next = near[pairs::nearest(&near, stamp.0, |frame| frame.0.0)?];
        let clock = &found?.clock;
        let distance = clock.apply(stamp)?.0.checked_sub(clock.apply(next.0)?.0)?;
        // Far from any depth frame, there are no times.
        (distance.abs() <= SECOND).then(|| BoardNanos(next.1.0.saturating_add(distance)))
    };
    stamps
        .iter()
        .map(|&device| CameraFrame {
            device,
            at: board_time(device),
        })
        .collect()
}
