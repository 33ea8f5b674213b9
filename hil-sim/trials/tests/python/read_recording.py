"""Reads a recording with the public Python packages and prints what they found.

`mcap` with `mcap-ros2-support`, and `rosbags`, each read every message with the
definitions in the file; both must find the same. One JSON object comes out, for
the caller to compare with what was recorded.
"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader


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
        elif topic == "/board/trigger_pulse":
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


path = Path(sys.argv[1])
first, second = summary(with_mcap(path)), summary(with_rosbags(path))
assert first == second, "the two packages found different messages"
print(json.dumps(first))
