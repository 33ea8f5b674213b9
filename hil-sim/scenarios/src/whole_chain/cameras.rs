//! Other depth cameras than the published rig's: the profile that the program writes for
//! them, and the recordings that their drivers leave.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use anyhow::Result;
use mcap::records::MessageHeader;
use recording::messages::camera::Image;
use recording::messages::{Header, RosMessage, Time, to_cdr};
use recording::profile::{Depth, Profile};
use rig::depth_camera::k4a_mkv::device_us;
use rig::depth_camera::{Family, FrameRecord};

use crate::programs::{Programs, ask};
use crate::virtual_session::naming_pixel;

/// Size of an image.
const SIZE: (u32, u32) = (16, 12);

/// Takes what `profile init` writes about such a camera into the owner's profile. What it
/// writes about the middle of exposure is left out: the owner has measured that.
pub(super) fn into_profile(
    depth: &mut Depth,
    family: Family,
    programs: &Programs,
    folder: &Path,
) -> Result<()> {
    if family == Family::AzureKinect {
        return Ok(());
    }
    let path = folder.join("init.toml");
    let init = ["profile", "init", "--camera", family.word()];
    ask(programs, &init, &[&path])?;
    *depth = Depth {
        fps: depth.fps,
        center_offset_us: depth.center_offset_us,
        center_offset_sigma_us: depth.center_offset_sigma_us,
        ..Profile::load(&path)?.depth
    };
    Ok(())
}

/// A bag as a driver's recorder leaves it, in a folder of its own: stamps of the camera's
/// clock, and images that name their frame.
pub(super) fn write_bag(folder: &Path, frames: &[FrameRecord]) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(
        folder.join("metadata.yaml"),
        "rosbag2_bagfile_information:\n",
    )?;
    let file = File::create(folder.join("depth_0.mcap"))?;
    let mut bag = mcap::WriteOptions::new()
        .profile("ros2")
        .compression(None)
        .create(std::io::BufWriter::new(file))?;
    let schema = bag.add_schema(Image::TYPE, "ros2msg", Image::DEFINITION.as_bytes())?;
    let topic = "/camera/depth/image_raw";
    let channel = bag.add_channel(schema, topic, "cdr", &BTreeMap::new())?;
    for (sequence, frame) in (0..).zip(frames.iter().filter(|frame| frame.delivered)) {
        let us = device_us(frame.device_ticks);
        let (width, height) = SIZE;
        let image = Image {
            header: Header {
                stamp: Time::from_nanos(i64::try_from(us)? * 1000),
                frame_id: String::from("camera_depth_optical_frame"),
            },
            height,
            width,
            encoding: String::from("16UC1"),
            is_bigendian: 0,
            step: 2 * width,
            data: (0..u64::from(width * height))
                .flat_map(|index| naming_pixel(frame, index).to_le_bytes())
                .collect(),
        };
        let header = MessageHeader {
            channel_id: channel,
            sequence,
            log_time: us * 1000,
            publish_time: us * 1000,
        };
        bag.write_to_known_channel(&header, &to_cdr(&image)?)?;
    }
    bag.finish()?;
    Ok(())
}
