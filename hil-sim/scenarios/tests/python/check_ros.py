"""Reads the bags of one extraction (ROS 2 by `rosbags` and by `mcap` with
`mcap-ros2-support`, and what `rosbags-convert` makes of it for ROS 1) and compares every
message with the same extraction as EuRoC.

usage: check_ros.py EUROC ROS2 ROS1_BAG
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image
from rosbags.highlevel import AnyReader

euroc, ros2, ros1 = map(Path, sys.argv[1:])
OFFSET = 1_000_000_000_000


def with_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, reader.deserialize(data, connection.msgtype)


def with_mcap(path):
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            yield channel.topic, message.log_time, decoded


def either(message, name):
    """A matrix of CameraInfo has a small letter in ROS 2 and a capital one in ROS 1."""
    return np.array(getattr(message, name if hasattr(message, name) else name.upper()))


def check(messages, what):
    images = {name: pd.read_csv(euroc / f"mav0/{name}/data.csv") for name in ["cam0", "cam1", "depth0"]}
    images = {name: list(table.itertuples(index=False)) for name, table in images.items()}
    for rows in images.values():
        # Whoever sorts names has the images in order of time.
        names = [file for _, file in rows]
        assert names == sorted(names) and len({len(name) for name in names}) == 1, names[:3]
    tables = {name: pd.read_csv(euroc / f"mav0/{name}/data.csv") for name in ["imu0", "imu1"]}
    samples = {name: list(zip(table.iloc[:, 0].tolist(), table.iloc[:, 1:].to_numpy().tolist()))
               for name, table in tables.items()}
    rates = {name: 1e9 * (len(rows) - 1) / (rows[-1][0] - rows[0][0]) for name, rows in samples.items()}
    counts, last = {}, 0
    for topic, time, message in messages:
        number = counts[topic] = counts.get(topic, -1) + 1
        name = topic.split("/")[1]
        stamp = message.header.stamp
        nanos = stamp.sec * 1_000_000_000 + (stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec)
        assert nanos == time >= last, (what, topic, nanos, time, last)
        last = time
        assert message.header.frame_id == name
        if name in samples:
            at, values = samples[name][number]
            assert time - OFFSET == at, (what, topic, number)
            rate, force = message.angular_velocity, message.linear_acceleration
            found = [rate.x, rate.y, rate.z, force.x, force.y, force.z]
            assert found == values, (what, topic, number)
            assert message.orientation_covariance[0] == -1
            if name == "imu0" and number % 100 == 0:
                # 0.005 °/s/√Hz and 400 µg/√Hz (data sheet), at the rate of the samples.
                pairs = [(message.angular_velocity_covariance, np.radians(0.005)),
                         (message.linear_acceleration_covariance, 400e-6 * 9.81)]
                for covariance, density in pairs:
                    matrix = np.array(covariance).reshape(3, 3)
                    assert np.allclose(matrix, np.eye(3) * matrix[0, 0], rtol=0, atol=0)
                    assert abs(matrix[0, 0] / (density**2 * rates[name]) - 1) < 0.02, (matrix, rates)
            continue
        at, file = images[name][number]
        assert time - OFFSET == int(at), (what, topic, number)
        path = euroc / "mav0" / name / "data" / file
        if topic.endswith("camera_info"):
            with Image.open(path) as image:
                assert (message.width, message.height) == image.size, (what, topic)
            if name == "cam0":
                x, y = [1412.5, 0, 958], [0, 1410.25, 541.5]
                assert list(either(message, "k")) == [*x, *y, 0, 0, 1]
                assert list(either(message, "p")) == [*x, 0, *y, 0, 0, 0, 1, 0]
                assert message.distortion_model == "plumb_bob"
                assert list(either(message, "d")) == [-0.28, 0.07, 0.0002, 1.7e-05, 0]
            elif name == "depth0":
                assert message.distortion_model == "rational_polynomial"
                assert len(either(message, "d")) == 8 and either(message, "k")[0] > 100
        elif topic.endswith("compressed"):
            assert message.format == "jpeg" and bytes(message.data) == path.read_bytes()
        elif number % 20 == 0:
            kind, shape = {"rgb8": (np.uint8, (-1, 3)), "16UC1": ("<u2", (-1,))}[message.encoding]
            pixels = np.frombuffer(bytes(message.data), kind).reshape(message.height, message.width, *shape[1:])
            assert (pixels == np.array(Image.open(path))).all(), (what, topic, number)
            assert message.step * message.height == len(message.data) and not message.is_bigendian
    expected = {f"/{name}": len(table) - 1 for name, table in samples.items()}
    for name, table in images.items():
        compressed = "/compressed" if name == "cam1" else ""
        expected[f"/{name}/image_raw{compressed}"] = expected[f"/{name}/camera_info"] = len(table) - 1
    assert counts == expected, (what, counts, expected)
    assert min(counts.values()) > 30, counts


check(with_rosbags(ros2 / "ros2"), "rosbag2 by rosbags")
check(with_mcap(ros2 / "ros2/data.mcap"), "MCAP by mcap-ros2-support")
check(with_rosbags(ros1), "ROS 1 by rosbags")
print("ok")
