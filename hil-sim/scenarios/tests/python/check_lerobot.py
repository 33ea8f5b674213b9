"""Holds a LeRobot v3 dataset against its documented schema, as `LeRobotDataset` reads it, and
its content against the EuRoC folder of the same extraction.

usage: check_lerobot.py EUROC OUT
"""

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

euroc, out = map(Path, sys.argv[1:])
PHONE, DEPTH = "observation.images.phone", "observation.images.depth"

info = json.loads((out / "meta/info.json").read_text())
assert info["codebase_version"] == "v3.0"
features, fps = info["features"], info["fps"]
pairs = pd.read_csv(euroc / "pairs.csv")
count = len(pairs)
assert count > 100 and info["total_frames"] == count and info["total_episodes"] == 1

# Every feature that is no video is a column of its type, and there is no other.
data = pq.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
types = {key: image if feature["dtype"] == "image" else pa.type_for_alias(feature["dtype"])
         for key, feature in features.items() if feature["dtype"] != "video"}
assert {field.name: field.type for field in data.schema} == types, data.schema
for key in ["timestamp", "frame_index", "episode_index", "index", "task_index"]:
    assert features[key]["shape"] == [1], key
rows = np.arange(count)
assert (data["index"].to_numpy() == rows).all() and (data["frame_index"].to_numpy() == rows).all()
assert (data["timestamp"].to_numpy() == (rows / fps).astype(np.float32)).all()
assert not data["episode_index"].to_numpy().any() and not data["task_index"].to_numpy().any()

# The tasks are found by position and named by the index.
tasks = pd.read_parquet(out / "meta/tasks.parquet")
assert tasks.iloc[0].name == "recording" and list(tasks["task_index"]) == [0]

(episode,) = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
assert episode["tasks"] == ["recording"] and episode["length"] == count
assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (0, count)
video = out / info["video_path"].format(
    video_key=PHONE, chunk_index=episode[f"videos/{PHONE}/chunk_index"],
    file_index=episode[f"videos/{PHONE}/file_index"])
begin, end = episode[f"videos/{PHONE}/from_timestamp"], episode[f"videos/{PHONE}/to_timestamp"]
assert begin == 0 and abs(end - count / fps) < 1e-9

# Times and depth, to the nanosecond and the millimetre.
phone_times, depth_times = data["phone_time_ns"].to_numpy(), data["depth_time_ns"].to_numpy()
stamps = pd.read_csv(euroc / "phone_frames.csv")
assert set(phone_times) <= set(stamps["timestamp [ns]"])
assert (phone_times == sorted(phone_times)).all()
difference = pairs["depth_minus_phone [ns]"].to_numpy()
assert (depth_times - phone_times == difference).all()
height, width, channels = features[DEPTH]["shape"]
assert channels == 1 and features[DEPTH]["info"]["is_depth_map"]
for row in rows[::7]:
    stored = data[DEPTH][int(row)].as_py()
    own = euroc / "mav0/depth0/data" / f"{depth_times[row]:019}.png"
    assert stored["path"] is None and stored["bytes"] == own.read_bytes()
    opened = np.array(Image.open(io.BytesIO(stored["bytes"])))
    assert opened.shape == (height, width)

# Frame k of the video is shown at k / fps, and is the phone's image of that pair.
shown = subprocess.run(
    ["ffprobe", "-v", "error", "-select_streams", "v", "-show_entries", "frame=pts_time",
     "-of", "csv=p=0", video], capture_output=True, text=True, check=True).stdout.split()
shown = np.array([float(text.strip(",")) for text in shown])
assert len(shown) == count and np.abs(shown - rows / fps).max() < 1e-4
height, width, channels = features[PHONE]["shape"]
raw = subprocess.run(["ffmpeg", "-v", "error", "-i", video, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
                     capture_output=True, check=True).stdout
frames = np.frombuffer(raw, np.uint8).reshape(count, height, width, channels)
shown = rows[7:-7:7]
own = np.stack([np.array(Image.open(euroc / "mav0/cam0/data" / f"{phone_times[row]:019}.png"))
                for row in shown]).astype(int)
off = {shift: np.abs(frames[shown + shift] - own).mean(axis=(1, 2, 3)) for shift in [-1, 0, 1]}
assert off[0].max() < 8, off
# A frame more or less, and it is another picture.
assert off[0].mean() < min(off[-1].mean(), off[1].mean()) - 0.1, off

# The statistics that training normalizes by.
stats = json.loads((out / "meta/stats.json").read_text())
assert stats.keys() == features.keys()
depths = (np.array(Image.open(io.BytesIO(item.as_py()["bytes"]))).astype(float) for item in data[DEPTH])
means, squares = np.array([[depth.mean(), (depth**2).mean()] for depth in depths]).T
mean, std = (np.array(stats[DEPTH][name]) for name in ["mean", "std"])
assert mean.shape == (1, 1, 1) and abs(mean.item() - means.mean()) < 1e-6 * means.mean()
assert abs(std.item() - np.sqrt(squares.mean() - means.mean()**2)) < 1e-6 * std.item()
assert np.array(stats[PHONE]["mean"]).shape == (3, 1, 1) and stats[PHONE]["count"] == [count]
print("ok")
