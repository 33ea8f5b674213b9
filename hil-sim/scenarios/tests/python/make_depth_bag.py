"""Writes a ROS 2 bag (MCAP, MCAP with chunks packed with Zstandard, or sqlite3) with depth
images as a camera's driver publishes them, by `rosbags`: stamps of the camera's clock in the
headers, times of arrival that say nothing but the order.

usage: make_depth_bag.py STAMPS_FILE BAG_FOLDER mcap|zstd|sqlite3

STAMPS_FILE has a stamp in ns a line. Pixel n of frame f is (1000 + 7 f + n) mm.
"""

import random
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

stamps = [int(line) for line in Path(sys.argv[1]).read_text().split()]
store = get_typestore(Stores.ROS2_HUMBLE)
types = store.types
Time = types["builtin_interfaces/msg/Time"]
Header = types["std_msgs/msg/Header"]
Image = types["sensor_msgs/msg/Image"]
KIND = "sensor_msgs/msg/Image"
random.seed(1)


def image(stamp, frame, encoding, pixels):
    height, width = pixels.shape[:2]
    return store.serialize_cdr(Image(
        header=Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id=frame),
        height=height, width=width, encoding=encoding, is_bigendian=0,
        step=pixels.strides[0], data=np.ascontiguousarray(pixels).view(np.uint8).ravel()), KIND)


form = sys.argv[3]
storage = StoragePlugin.SQLITE3 if form == "sqlite3" else StoragePlugin.MCAP
writer = Writer(Path(sys.argv[2]), version=9, storage_plugin=storage)
if form == "zstd":
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
with writer:
    depth = writer.add_connection("/camera/depth/image_raw", KIND, typestore=store)
    color = writer.add_connection("/camera/color/image_raw", KIND, typestore=store)
    over = writer.add_connection("/camera/aligned_depth_to_color/image_raw", KIND, typestore=store)
    arrived = 0
    for frame, stamp in enumerate(stamps):
        arrived = max(arrived + 1, stamp + 10**18 + random.randrange(40_000_000))
        pixels = (1000 + 7 * frame + np.arange(6 * 4, dtype=np.uint16)).reshape(4, 6)
        writer.write(color, arrived, image(stamp, "color", "rgb8", np.zeros((4, 6, 3), np.uint8)))
        writer.write(depth, arrived, image(stamp, "depth", "16UC1", pixels.astype(np.uint16)))
        writer.write(over, arrived, image(stamp, "color", "16UC1", pixels.astype(np.uint16)))
