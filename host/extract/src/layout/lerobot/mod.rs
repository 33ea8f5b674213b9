//! LeRobot v3: one dataset of one episode for each sequence.
//!
//! | file | what |
//! |---|---|
//! | `meta/info.json`, `stats.json`, `tasks.parquet`, `episodes/chunk-000/file-000.parquet` | what is where, and the statistics that training normalizes by |
//! | `data/chunk-000/file-000.parquet` | a row a pair of images: depth as a 16-bit PNG file in mm, times |
//! | `videos/observation.images.phone/chunk-000/file-000.mp4` | the phone's image of each pair |
//! | `imu/board.csv`, `imu/phone.csv` | the samples of both IMUs, beside the format |
//!
//! The format counts frames: `timestamp` is the frame's number over the frame rate, and the
//! video has it so. When the images were exposed, in nanoseconds of board time, is in
//! `phone_time_ns` and `depth_time_ns`.

mod stats;
mod table;

use std::fs;
use std::io;
use std::path::Path;

use rayon::prelude::*;
use serde_json::{Value, json};
use video::Encoder;

use self::stats::Stats;
use self::table::{Column, Table};
use super::euroc::IMU_HEADER;
use super::ros::IMAGES_AT_A_TIME;
use super::{DataSetInfo, ImageKind, ImageRow, ImuTable, Layout, SequenceTables, parts};
use crate::image::{Decoded, decode_png, read_png, write_whole};

pub(super) struct Lerobot;

const PHONE: &str = "observation.images.phone";
const DEPTH: &str = "observation.images.depth";
const INFO: &str = "meta/info.json";
const DATA: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";
/// What was done, as an episode must say; nothing is known of it.
const TASK: &str = "recording";
/// Rows that are made at a time.
const ROWS_AT_A_TIME: usize = 64;

impl Layout for Lerobot {
    fn folder(&self, kind: ImageKind) -> Option<&'static str> {
        match kind {
            ImageKind::Color => Some(".parts/phone"),
            ImageKind::Depth => Some(".parts/depth"),
            ImageKind::Infrared | ImageKind::Camera => None,
        }
    }

    fn board_imu(&self) -> ImuTable {
        ImuTable::plain("imu/board.csv", IMU_HEADER)
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        Some(ImuTable::plain("imu/phone.csv", IMU_HEADER))
    }

    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        facts: &DataSetInfo,
    ) -> io::Result<()> {
        super::auxiliary::write(folder, tables)?;
        let pairs = tables.pairs.iter();
        let pairs: Vec<Pair<'_>> = pairs
            .filter_map(|&(color, depth)| {
                Some((tables.color.get(color)?, tables.depth.get(depth)?))
            })
            .collect();
        if pairs.is_empty() {
            return Ok(());
        }
        parts::join(folder, &folder.join(INFO), tables, || {
            write(folder, &pairs, facts)
        })
    }
}

/// Images of phone and depth camera.
type Pair<'a> = (&'a ImageRow, &'a ImageRow);

fn write(folder: &Path, pairs: &[Pair<'_>], facts: &DataSetInfo) -> io::Result<()> {
    let fps = facts
        .color_rate
        .map_or(30, |rate| rate.round().max(1.0) as u32);
    let (phone_size, phone) = write_video(folder, pairs, fps)?;
    let (depth_size, depth) = write_rows(folder, pairs, fps)?;
    let mut stats = json!({ PHONE: phone.json(true), DEPTH: depth.json(true) });
    let mut features = image_features(fps, phone_size, depth_size);
    for (name, column) in columns(pairs, Vec::new(), 0, fps) {
        if let Some((kind, numbers)) = column.numbers() {
            stats[name] = Stats::of_numbers(numbers.into_iter()).json(false);
            features[name] = json!({ "dtype": kind, "shape": [1], "names": null });
        }
    }
    write_json(&folder.join("meta/stats.json"), &stats)?;
    write_tasks(&folder.join("meta/tasks.parquet"))?;
    write_episode(&folder.join(EPISODES), pairs.len(), f64::from(fps))?;
    // Last: with it the dataset is whole.
    write_json(&folder.join(INFO), &info(pairs.len(), fps, features))
}

/// Seconds of a frame as the format counts them.
fn timestamp(row: usize, fps: u32) -> f32 {
    (row as f64 / f64::from(fps)) as f32
}

fn write_json(path: &Path, value: &Value) -> io::Result<()> {
    write_whole(path, &serde_json::to_vec_pretty(value)?)
}

type Size = (u32, u32);

/// The video of the phone's images; their size, and the statistics of their colours.
fn write_video(folder: &Path, pairs: &[Pair<'_>], fps: u32) -> io::Result<(Size, Stats)> {
    let path = folder.join(format!("videos/{PHONE}/chunk-000/file-000.mp4"));
    fs::create_dir_all(files::folder_of(&path))?;
    let partial = path.with_extension("partial");
    let Some((first, _)) = pairs.first() else {
        return Err(io::Error::other("there are no images"));
    };
    let size = read_png(&folder.join(&first.path))?.size;
    let mut video = Encoder::create(&partial, size, fps).map_err(io::Error::other)?;
    let mut stats = Stats::new(3);
    for pairs in pairs.chunks(IMAGES_AT_A_TIME) {
        let images: Vec<io::Result<(Decoded, Stats)>> = pairs
            .par_iter()
            .map(|(image, _)| {
                let image = read_png(&folder.join(&image.path))?;
                let stats = Stats::of_image(3, 255.0, image.pixels.iter().copied().map(u16::from));
                Ok((image, stats))
            })
            .collect();
        for image in images {
            let (image, its) = image?;
            stats.join(&its);
            if size != image.size {
                return Err(io::Error::other(format!(
                    "the phone's images have two sizes, {} x {} and {} x {}: a LeRobot video \
                     has one; choose another --format",
                    size.0, size.1, image.size.0, image.size.1
                )));
            }
            video.write(&image.pixels).map_err(io::Error::other)?;
        }
    }
    video.finish().map_err(io::Error::other)?;
    fs::rename(&partial, &path)?;
    Ok((size, stats))
}

/// The columns of rows with these files of depth; the first row has the number `first`.
fn columns(
    pairs: &[Pair<'_>],
    depth: Vec<Vec<u8>>,
    first: usize,
    fps: u32,
) -> Vec<(&'static str, Column)> {
    let rows = first..first + pairs.len();
    let phone_times = pairs.iter().map(|(phone, _)| phone.at.0).collect();
    let depth_times = pairs.iter().map(|(_, depth)| depth.at.0).collect();
    let timestamps = rows.clone().map(|row| timestamp(row, fps)).collect();
    let numbers: Vec<i64> = rows.map(|row| row as i64).collect();
    let zeros = vec![0; pairs.len()];
    vec![
        (DEPTH, Column::Image(depth)),
        ("phone_time_ns", Column::Int(phone_times)),
        ("depth_time_ns", Column::Int(depth_times)),
        ("timestamp", Column::Float(timestamps)),
        ("frame_index", Column::Int(numbers.clone())),
        ("episode_index", Column::Int(zeros.clone())),
        ("index", Column::Int(numbers)),
        ("task_index", Column::Int(zeros)),
    ]
}

/// The rows with depth and times; size and statistics of depth.
fn write_rows(folder: &Path, pairs: &[Pair<'_>], fps: u32) -> io::Result<(Size, Stats)> {
    let none = columns(&[], Vec::new(), 0, fps);
    let mut table = Table::create(&folder.join(DATA), &none, None)?;
    let (mut size, mut stats) = ((0, 0), Stats::new(1));
    let mut first = 0;
    for pairs in pairs.chunks(ROWS_AT_A_TIME) {
        let images: Vec<io::Result<(Vec<u8>, Size, Stats)>> = pairs
            .par_iter()
            .map(|(_, depth)| {
                let file = fs::read(folder.join(&depth.path))?;
                let image = decode_png(io::Cursor::new(&file))?;
                let pixels = image.pixels.chunks_exact(2);
                let millimetres = pixels.map(|pixel| u16::from_le_bytes([pixel[0], pixel[1]]));
                let stats = Stats::of_image(1, 1.0, millimetres);
                Ok((file, image.size, stats))
            })
            .collect();
        let mut files = Vec::with_capacity(pairs.len());
        for image in images {
            let (file, its_size, its) = image?;
            files.push(file);
            size = its_size;
            stats.join(&its);
        }
        table.put(columns(pairs, files, first, fps))?;
        first += pairs.len();
    }
    table.finish()?;
    Ok((size, stats))
}

/// The one task; pandas finds the row by its text.
fn write_tasks(path: &Path) -> io::Result<()> {
    let column = |name: &str, pandas: &str, numpy: &str| {
        json!({
            "name": name, "field_name": name, "pandas_type": pandas, "numpy_type": numpy,
            "metadata": null,
        })
    };
    let about = json!({
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
    });
    let columns = vec![
        ("task_index", Column::Int(vec![0])),
        ("task", Column::Text(TASK)),
    ];
    let mut table = Table::create(path, &columns, Some(("pandas", about.to_string())))?;
    table.put(columns)?;
    table.finish()
}

/// The one episode: where its rows and its part of the video are.
fn write_episode(path: &Path, count: usize, fps: f64) -> io::Result<()> {
    let int = |value: usize| Column::Int(vec![value as i64]);
    let seconds = |value: f64| Column::Double(vec![value]);
    let in_video = [
        "chunk_index",
        "file_index",
        "from_timestamp",
        "to_timestamp",
    ];
    let [chunk, file, from, to] = in_video.map(|name| format!("videos/{PHONE}/{name}"));
    let columns = vec![
        ("episode_index", int(0)),
        ("tasks", Column::TextList(TASK)),
        ("length", int(count)),
        ("data/chunk_index", int(0)),
        ("data/file_index", int(0)),
        ("dataset_from_index", int(0)),
        ("dataset_to_index", int(count)),
        (&chunk, int(0)),
        (&file, int(0)),
        (&from, seconds(0.0)),
        (&to, seconds(count as f64 / fps)),
        ("meta/episodes/chunk_index", int(0)),
        ("meta/episodes/file_index", int(0)),
    ];
    let mut table = Table::create(path, &columns, None)?;
    table.put(columns)?;
    table.finish()
}

/// What the images are; the numbers beside them follow.
fn image_features(fps: u32, phone: Size, depth: Size) -> Value {
    let image = |kind: &str, (width, height): Size, channels: u32, about: Value| {
        json!({
            "dtype": kind,
            "shape": [height, width, channels],
            "names": ["height", "width", "channels"],
            "info": about,
        })
    };
    let video = json!({
        "video.height": phone.1, "video.width": phone.0, "video.codec": "h264",
        "video.fps": fps, "video.channels": 3, "is_depth_map": false, "has_audio": false,
    });
    json!({
        PHONE: image("video", phone, 3, video),
        DEPTH: image("image", depth, 1, json!({ "is_depth_map": true, "depth_unit": "mm" })),
    })
}

fn info(count: usize, fps: u32, features: Value) -> Value {
    json!({
        "codebase_version": "v3.0",
        "robot_type": null,
        "total_episodes": 1,
        "total_frames": count,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": { "train": "0:1" },
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": features,
    })
}
