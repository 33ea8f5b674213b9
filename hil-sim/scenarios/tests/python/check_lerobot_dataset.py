"""Loads a LeRobot dataset with `LeRobotDataset`, as training does, and compares what it gives
with the EuRoC folder of the same extraction.

usage: check_lerobot_dataset.py EUROC OUT
"""

import csv
import os
import sys
from pathlib import Path

# What is not in the folder shall not be looked for elsewhere.
os.environ["HF_HUB_OFFLINE"] = "1"

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from PIL import Image
from torch.utils.data import DataLoader

euroc, out = map(Path, sys.argv[1:])
PHONE, DEPTH = "observation.images.phone", "observation.images.depth"


def own(folder, at):
    return np.array(Image.open(euroc / "mav0" / folder / "data" / f"{at:019}.png"))


with open(euroc / "pairs.csv") as file:
    pairs = list(csv.reader(file))[1:]
dataset = LeRobotDataset("local/walk", root=out)
assert len(dataset) == dataset.num_frames == len(pairs) > 100 and dataset.num_episodes == 1
phone_off = []
for index in range(7, len(dataset) - 7, 7):
    item = dataset[index]
    assert item["task"] == "recording" and item["frame_index"] == index
    assert abs(item["timestamp"] - index / dataset.fps) < 1e-4
    depth_at, phone_at = int(item["depth_time_ns"]), int(item["phone_time_ns"])
    # Whole millimetres, and colours from 0 to 1.
    assert (item[DEPTH].numpy() == own("depth0", depth_at)).all(), index
    seen = 255 * item[PHONE].numpy().transpose(1, 2, 0)
    phone_off.append(np.abs(seen - own("cam0", phone_at)).mean())
# The video is packed anew; a frame of another time is farther off.
assert max(phone_off) < 8, max(phone_off)

# With the frame before, in batches.
before = LeRobotDataset("local/walk", root=out, delta_timestamps={PHONE: [-1 / dataset.fps, 0]})
batch = next(iter(DataLoader(before, batch_size=8)))
height, width, _ = dataset.features[PHONE]["shape"]
assert batch[PHONE].shape == (8, 2, 3, height, width), batch[PHONE].shape
assert (batch[PHONE][1:, 0] == batch[PHONE][:-1, 1]).all()
print("ok")
