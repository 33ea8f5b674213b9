//! Sentences of the report about the depth camera's part.

use crate::depth::depth_clock::MatchError;
use crate::layout::number;
use recording::strobes::SeenExposures;

/// End of the advice to set something in the rig profile.
pub(super) const WITH_PROFILE: &str = "then extract with `--profile rig.toml`";

/// Returns nanoseconds as microseconds.
fn micros(nanos: i64) -> String {
    number(nanos as f64 / 1000.0, 3)
}

/// Depth frames have the time of their own flashes, whose mean is `change` ns after the profile's
/// middle of exposure; that was measured, and another one, if it `disagrees`.
pub(super) fn own_strobes(seen: &SeenExposures, change: i64, disagrees: bool) -> String {
    let advice = if disagrees {
        ", which was measured otherwise: measure it again with `smartdepthsync record --calibrate`"
    } else {
        ""
    };
    format!(
        "each depth frame is timed by its own flashes: {}; {} µs later than by the profile{advice}",
        seen.text(),
        micros(change)
    )
}

/// Delays in the depth camera's file, ns: `subordinate` from trigger to colour, `depth` from
/// colour to depth, `total` as applied.
pub(super) fn file_delays(subordinate: i64, depth: i64, total: i64) -> String {
    format!(
        "the depth camera's file has delays that the profile does not know: \
         {} µs after the trigger (K4A_SUBORDINATE_DELAY_NS) and {} µs of depth after colour \
         (K4A_DEPTH_DELAY_NS); depth is timed {} µs later by that",
        micros(subordinate),
        micros(depth),
        micros(total)
    )
}

/// Colour was recorded with an exposure that is not known.
pub(super) fn color_exposure_unknown() -> String {
    format!(
        "the depth camera recorded colour too: it exposes depth later by half of what the colour \
         exposure is longer than the train of infrared pulses (12.725 ms; WFOV_UNBINNED 20.245 ms). \
         The file does not say that exposure: set color_exposure_us in the rig profile if it may be longer, \
         {WITH_PROFILE}"
    )
}

/// Depth is `later` ns later because of a colour exposure of `exposure` ns.
pub(super) fn delayed_by_color(later: i64, exposure: i64) -> String {
    format!(
        "depth is timed {} µs later, because the camera exposed colour for {} µs",
        micros(later),
        micros(exposure)
    )
}

/// The camera recorded in another mode than the profile's; `change` is by how much the time to
/// the centre of exposure differs, ns, if that is known.
pub(super) fn other_mode(file: &str, profile: &str, change: Option<i64>) -> String {
    let file: String = file.chars().take(32).collect();
    let consequence = match change {
        Some(0) => String::from("the time from pulse to centre of exposure is the same in both"),
        Some(change) => format!(
            "depth is timed {} µs later than the profile's center_offset_us says, by the difference of \
             the modes",
            micros(change)
        ),
        None => format!(
            "the time from pulse to centre of exposure is the profile's; set its center_offset_us, {WITH_PROFILE}"
        ),
    };
    format!(
        "the depth camera recorded in mode {file} and the profile says {profile}: {consequence}"
    )
}

/// The time to the centre of exposure is the nominal one of a mode, `center` ns.
pub(super) fn nominal_center(mode: &str, center: i64) -> String {
    format!(
        "from pulse to centre of exposure: {:.1} µs, half of the infrared train of mode {mode}; \
         measure it, set center_offset_us in the rig profile, {WITH_PROFILE}",
        center as f64 / 1000.0
    )
}

/// The time to the centre of exposure is not known.
pub(super) fn unknown_center(mode: Option<&str>) -> String {
    let reason = match mode {
        Some(mode) => format!("there is no known value for depth mode {mode}"),
        None => String::from("the depth recording does not say its mode"),
    };
    format!(
        "the time from pulse to centre of exposure is not known ({reason}): depth timestamps \
         are the pulses; set center_offset_us in the rig profile, {WITH_PROFILE}"
    )
}

/// The camera's colour images are in another `format` than JPEG.
pub(super) fn no_jpeg(format: &str) -> String {
    let format: String = format.chars().filter(|c| !c.is_control()).collect();
    format!(
        "the camera's colour images are {format}, expected MJPG: their times are in \
         camera_frames.csv, and no images are written; record with an MJPG colour mode"
    )
}

/// Some frames have a fault; the first of them are listed.
pub(super) fn faulty_frames(frames: &[usize], fault: &str) -> String {
    let first: Vec<String> = frames.iter().take(10).map(ToString::to_string).collect();
    format!("{} {fault} (frames {} ...)", frames.len(), first.join(" "))
}

/// There is no depth recording.
pub(super) const NO_RECORDING: &str = "there is no depth recording; give the file with --depth";

/// A file that another program wrote again has rounded times.
pub(super) const ROUNDED: &str =
    "with rounded times it is not found which pulse made which depth frame";

/// Faults of frames, for [`faulty_frames`].
pub(super) const DAMAGED: &str = "depth frames lie in a part of the file whose checksum is wrong";
pub(super) const BLACK: &str = "depth frames are black: no pixel has a depth";
pub(super) const COLOR_BROKEN: &str = "colour images of the depth camera are not whole JPEG files";

/// The pulses could not be matched; the frames have the recorded offset.
pub(super) fn offset_alone(error: &MatchError) -> String {
    format!("depth frames have the one offset that was recorded, without pulses: {error}")
}

/// Pulses without a depth frame.
pub(super) fn missing(pulses: usize) -> String {
    format!("{pulses} pulses have no depth frame; depth_frames.csv and report.json name them")
}

/// Frames that are cut short.
pub(super) fn broken(frames: usize) -> String {
    format!("{frames} depth frames do not hold a whole image")
}

/// Frames without depth outside of the recorded span, in which a camera adopts the trigger's phase.
pub(super) fn outside(frames: usize) -> String {
    format!(
        "depth frames without depth from before the trigger was aligned or after the recording: \
         {frames}"
    )
}

/// Pixels that the format cannot hold.
pub(super) fn out_of_range(pixels: u64) -> String {
    format!("{pixels} pixels lie beyond the 13.107 m that the format can hold and became 0")
}
