"""Reads a recording with the public Python packages and prints what they found.

`mcap` with `mcap-ros2-support`, and `rosbags` (the file, and its folder as a rosbag2),
each read every message with the definitions in the file; all must find the same. One JSON object
comes out, for the caller to compare with what was recorded.
"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg

PACKAGE = Path(__file__).parents[4] / "host/live/recording/ros/smartdepthsync_msgs/msg"


def nanos(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def imu(message):
    rate, force = message.angular_velocity, message.linear_acceleration
    return [nanos(message.header.stamp), rate.x, rate.y, rate.z, force.x, force.y, force.z]


def summary(messages):
    found = {"counts": {}, "imu": [], "pulses": [], "markers": []}
    for topic, time, message in messages:
        found["counts"][topic] = found["counts"].get(topic, 0) + 1
        if topic == "/board/imu":
            assert time == nanos(message.header.stamp)
            found["imu"].append(imu(message))
        elif topic == "/board/trigger":
            assert (time * 6 + 62) // 125 == message.ticks
            found["pulses"].append([message.ticks, message.number, message.aligned])
        elif topic == "/session/markers":
            found["markers"].append(message.source)
    return found


def with_mcap(path):
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, decoded in reader.iter_decoded_messages():
            yield channel.topic, message.log_time, decoded


def with_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, reader.deserialize(data, connection.msgtype)


def check_folder(folder, counts):
    with Reader(folder) as bag:
        assert bag.message_count == sum(counts.values())
        assert {topic: info.msgcount for topic, info in bag.topics.items() if info.msgcount} == counts
        for connection in bag.connections:
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.reliability == QosReliability.RELIABLE and qos.depth == 1000
        # The installable package has the types of the file.
        own = {connection.msgtype: connection.msgdef.data for connection in bag.connections
               if connection.msgtype.startswith("smartdepthsync_msgs/")}
        assert sorted(own) == sorted(f"smartdepthsync_msgs/msg/{path.stem}" for path in PACKAGE.glob("*.msg"))
        for name, definition in own.items():
            packaged = (PACKAGE / f"{name.split('/')[-1]}.msg").read_text()
            assert get_types_from_msg(packaged, name)[name] == get_types_from_msg(definition, name)[name]


path = Path(sys.argv[1])
first, second = summary(with_mcap(path)), summary(with_rosbags(path))
assert first == second, "the two packages found different messages"
assert first == summary(with_rosbags(path.parent)), "the folder is another bag than its file"
check_folder(path.parent, first["counts"])
print(json.dumps(first))
