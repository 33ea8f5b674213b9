"""Reads a ROS 1 bag with ROS 1's own `rosbag`, by which Kalibr, OpenVINS and VINS-Fusion
read theirs, and compares what they take from it with the same extraction as EuRoC.

usage: check_rosbag.py EUROC BAG
"""

import csv
import sys
from pathlib import Path

import rosbag

euroc, path = map(Path, sys.argv[1:])
OFFSET = 1_000_000_000_000


def listed(name):
    with open(euroc / "mav0" / name / "data.csv") as file:
        return list(csv.reader(file))[1:]


with rosbag.Bag(str(path)) as bag:
    for name, topic in [("cam0", "/cam0/image_raw"), ("imu0", "/imu0"), ("imu1", "/imu1")]:
        rows, count = listed(name), bag.get_message_count(topic)
        assert count == len(rows) > 100, (topic, count, len(rows))
        # By each message's own definition and its MD5, as ROS 1 knows it.
        for row, (_, message, received) in zip(rows, bag.read_messages(topics=[topic])):
            stamp = message.header.stamp
            assert received == stamp and stamp.to_nsec() - OFFSET == int(row[0]), (topic, row)
            if name == "cam0":
                assert message._type == "sensor_msgs/Image" and message.encoding == "rgb8"
                assert len(message.data) == message.height * message.step == 3 * message.height * message.width
            else:
                assert message._type == "sensor_msgs/Imu"
                rate, force = message.angular_velocity, message.linear_acceleration
                found = [rate.x, rate.y, rate.z, force.x, force.y, force.z]
                assert found == [float(value) for value in row[1:]], (topic, row)
print("ok")
