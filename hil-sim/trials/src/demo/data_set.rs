//! The data set of the demonstration: extracted by the tool, and every time in it judged by
//! the truth.

use std::collections::HashSet;
use std::fmt::Write as _;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::imageops::{FilterType, resize};
use image::{GrayImage, ImageFormat};
use recording::session_file::SessionFile;

use super::judge::Truth;
use crate::whole_chain::extraction::{self, ExtractionFigures, table};
use crate::whole_chain::{Programs, Recorded, ask, pulses};
use rig::k4a_mkv::device_us;

/// Pairs in the strip.
const SHOWN: usize = 6;

/// Size of a picture in the strip.
const SIZE: (u32, u32) = (160, 90);

/// Depths that are shown as white and as black, mm.
const SHADES_MM: (f64, f64) = (600.0, 3_000.0);

/// A data set, and how right it is.
#[derive(Debug)]
pub struct DataSet {
    /// Its folder.
    pub folder: PathBuf,
    /// Against the truth.
    pub figures: ExtractionFigures,
    /// Pairs of pictures, as SVG.
    pub strip: String,
}

/// Extracts the recording in `folder`, whose phone's files lie beside it, and judges it.
///
/// # Errors
///
/// The extraction fails, or a frame, a pulse or a pair is not the true one.
pub fn make(mut truth: Truth, folder: &Path, phone: &Path, program: &Path) -> Result<DataSet> {
    let programs = Programs {
        smartdepthsync: program.to_owned(),
        elf: None,
        speed: 1.0,
    };
    // Another address of its report is wanted, now that nothing is missing any more.
    ask(&programs, &["report"], &[folder])?;
    let report = ask(&programs, &["extract", "--overwrite"], &[folder])?;
    let name = folder.file_name().context("the recording has no name")?;
    let data = folder.with_file_name(format!("{}-euroc", name.to_string_lossy()));

    // Of all frames that the camera made, those that its recorder was there for.
    let delivered: HashSet<i64> = table(&data.join("depth_frames.csv"), &[1])?
        .iter()
        .filter_map(|row| row.first().copied().flatten())
        .collect();
    let device_ns = |ticks| i64::try_from(device_us(ticks) * 1_000).unwrap_or(i64::MAX);
    truth
        .depth
        .retain(|frame| delivered.contains(&device_ns(frame.device_ticks)));
    ensure!(
        truth.depth.len() == delivered.len(),
        "{} depth frames are in the data set, of which the camera made {}",
        delivered.len(),
        truth.depth.len()
    );
    let pulses = pulses(folder)?;
    let recorded = Recorded {
        folder: folder.to_owned(),
        phone: phone.to_owned(),
        depth: folder.join("depth.mkv"),
        profile: PathBuf::new(),
        session: SessionFile::load(folder)?,
        base: truth.timebase.refined(&pulses, &truth.depth)?,
        truth,
        pulses,
    };
    let figures = extraction::judge(&recorded, &data, &report)?;
    let strip = strip(&data)?;
    Ok(DataSet {
        folder: data,
        figures,
        strip,
    })
}

/// Pairs of pictures from the middle of the data set: the phone's above, the depth camera's
/// below it.
fn strip(data: &Path) -> Result<String> {
    let pairs = table(&data.join("pairs.csv"), &[1, 3])?;
    let (width, height) = SIZE;
    let gap = 6;
    let whole = (SHOWN as u32 * (width + gap) - gap, 2 * height + gap);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0} {1}\" width=\"{0}\" height=\"{1}\">\n",
        whole.0, whole.1
    );
    // Neighbours: the thing moves from one to the next.
    let from = pairs.len() / 2;
    let shown = pairs.iter().skip(from).step_by(4).take(SHOWN);
    for (index, row) in shown.enumerate() {
        let (Some(Some(phone)), Some(Some(depth))) = (row.first(), row.get(1)) else {
            continue;
        };
        let picture = |camera: &str, at: &i64| {
            let path = data.join(format!("mav0/{camera}/data/{at:019}.png"));
            image::open(&path).with_context(|| format!("cannot read {}", path.display()))
        };
        let phone = resize(
            &picture("cam0", phone)?.to_luma8(),
            width,
            height,
            FilterType::Triangle,
        );
        let depth = picture("depth0", depth)?.to_luma16();
        let shade = |mm: u16| {
            let (near, far) = SHADES_MM;
            (255.0 * ((far - f64::from(mm)) / (far - near)).clamp(0.0, 1.0)) as u8
        };
        let depth = GrayImage::from_fn(depth.width(), depth.height(), |x, y| {
            image::Luma([shade(depth.get_pixel(x, y).0[0])])
        });
        let depth = resize(&depth, width, height, FilterType::Triangle);
        let x = index as u32 * (width + gap);
        for (y, image) in [(0, phone), (height + gap, depth)] {
            let mut png = Cursor::new(Vec::new());
            image.write_to(&mut png, ImageFormat::Png)?;
            let _ = writeln!(
                svg,
                "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{}\"/>",
                STANDARD.encode(png.get_ref())
            );
        }
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}
