//! Writes an H.264 video of re-transmitted strobes, as a phone would record it.
//!
//! `render_strobes OUT.mp4 [SECONDS] [WIDTHxHEIGHT] [FPS] [BIAS_US]`
//!
//! The first second has no flashes. Noise repeats every second, so that a long
//! video is written quickly; the true bias is constant.

use std::path::PathBuf;

use anyhow::{Context, Result};
use rig::rolling_shutter::{FlashTrain, GreyImage, RollingShutter};
use rig::video_writer::{Mp4Writer, Quality, VideoSettings};

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let out = PathBuf::from(
        args.next()
            .context("usage: render_strobes OUT.mp4 [SECONDS] [WIDTHxHEIGHT] [FPS] [BIAS_US]")?,
    );
    let seconds: f64 = args.next().map_or(Ok(10.0), |s| s.parse())?;
    let size = args.next().unwrap_or_else(|| "1920x1080".to_owned());
    let (columns, rows) = size.split_once('x').context("size as WIDTHxHEIGHT")?;
    let frame_rate: f64 = args.next().map_or(Ok(30.0), |s| s.parse())?;
    let bias_us: f64 = args.next().map_or(Ok(123.4), |s| s.parse())?;

    let (columns, rows): (usize, usize) = (columns.parse()?, rows.parse()?);
    let camera = RollingShutter {
        columns,
        rows,
        // The read-out takes as long at every size.
        row_time_ns: 11.016e6 / rows as f64,
        ..RollingShutter::default()
    };
    let center = camera.middle_offset_ns() + 1e3 * bias_us;
    let flashes: Vec<_> = FlashTrain::NFOV
        .centered_at(center.round() as i64)
        .collect();
    let second = frame_rate.round().max(1.0) as u64;
    let frames = (seconds * frame_rate).round() as u64;
    let mut writer = Mp4Writer::create(
        &out,
        VideoSettings {
            width: columns,
            height: rows,
            frame_rate,
            quality: Quality::BitRate(17_000_000),
        },
    )?;
    let mut image = GreyImage::default();
    for frame in 0..second.min(frames) {
        camera.render_into(0, frame, &[], &mut image);
        writer.write(&image)?;
    }
    let lit: Vec<GreyImage> = (0..second)
        .map(|frame| camera.render(0, second + frame, &flashes))
        .collect();
    for image in lit
        .iter()
        .cycle()
        .take(frames.saturating_sub(second) as usize)
    {
        writer.write(image)?;
    }
    writer.finish()?;
    Ok(())
}
