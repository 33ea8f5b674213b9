"""Reads a recording and the ROS 2 bag of its extraction with Rerun's reader of MCAP files:
every message of the recording is decoded, and the bag shows what the same extraction as
EuRoC has.

usage: check_rerun.py RECORDING EUROC BAG
"""

import csv
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image
from rerun.chunk import McapReader

recording, euroc, bag = map(Path, sys.argv[1:])
OFFSET = 1_000_000_000_000


def batches(path):
    """Topic and decoded messages of each of Rerun's chunks."""
    for chunk in McapReader(path).stream():
        if not chunk.is_static:
            yield chunk.entity_path, chunk.to_record_batch()


def listed(name):
    with open(euroc / "mav0" / name / "data.csv") as file:
        return list(csv.reader(file))[1:]


for path in [recording, bag]:
    rerun = Path(sys.executable).with_name("rerun")
    subprocess.run([rerun, "mcap", "check", path], check=True, stdout=subprocess.DEVNULL)
    found = Counter()
    for topic, batch in batches(path):
        found[topic] += batch.num_rows
        # What it cannot decode it shows as bytes.
        assert not any("McapMessage" in name for name in batch.schema.names), batch.schema
    channels = McapReader(path).info().channels
    expected = {channel.topic: channel.message_count for channel in channels if channel.message_count}
    assert found == expected, (path, found, expected)

tables = {f"/{name}": listed(name) for name in ["imu0", "imu1"]}
images = {f"/{name}/image_raw": listed(name) for name in ["cam0", "depth0"]}
number = Counter()
for topic, batch in batches(bag):
    if topic not in tables and topic not in images:
        continue
    times = batch.column("ros2_timestamp").cast("int64").to_pylist()
    rows = (tables | images)[topic][number[topic]:][:len(times)]
    number[topic] += len(times)
    assert [time - OFFSET for time in times] == [int(row[0]) for row in rows], topic
    if topic in tables:
        values = batch.column("Scalars:scalars").to_pylist()
        assert values == [[float(value) for value in row[1:]] for row in rows], topic
        continue
    (name,) = (name for name in batch.schema.names if name.endswith("Image:buffer"))
    for row, pixels in list(zip(rows, batch.column(name)))[::20]:
        own = np.array(Image.open(euroc / "mav0" / topic.split("/")[1] / "data" / row[1]))
        assert pixels[0].values.to_numpy().tobytes() == own.tobytes(), (topic, row)
assert number == {topic: len(rows) for topic, rows in (tables | images).items()}, number
print("ok")
