"""Writes a ROS 1 bag with the topics of the published system, from the real
gyroscope recordings, and the phone's files as the app saves them.

usage: make_published_bag.py TWIST_FOLDER OUT_FOLDER COMPRESSION

The bag's numbers are kept in OUT_FOLDER/truth.json.
"""

import csv
import json
import sys
from decimal import Decimal
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

twist, out, compression = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
store = get_typestore(Stores.ROS1_NOETIC)
types = store.types
Time = types["builtin_interfaces/msg/Time"]
Header = types["std_msgs/msg/Header"]
Vector3 = types["geometry_msgs/msg/Vector3"]
Quaternion = types["geometry_msgs/msg/Quaternion"]
Imu = types["sensor_msgs/msg/Imu"]
Temperature = types["sensor_msgs/msg/Temperature"]
TimeReference = types["sensor_msgs/msg/TimeReference"]
Image = types["sensor_msgs/msg/Image"]


def rows(name):
    with open(twist / name, newline="") as file:
        reader = csv.reader(file)
        next(reader)
        for row in reader:
            yield int(Decimal(row[0]) * 10**9), row[1:]


def time(ns):
    return Time(sec=ns // 10**9, nanosec=ns % 10**9)


def header(seq, ns, frame):
    return Header(seq=seq, stamp=time(ns), frame_id=frame)


board = list(rows("mcu_gyro_data.csv"))
phone = list(rows("smartphone_gyro_data.csv"))
first, last = board[0][0], board[-1][0]
# 30.0024 Hz; the trigger jumps by 7 ms after two seconds (the alignment).
pulses = []
at = first + 50_000_123
while at < last - 50_000_000:
    pulses.append(at)
    at += 33_330_652 + (7_000_000 if len(pulses) == 60 else 0)
offset = phone[0][0] - board[0][0]
marks = [first + 4_000_000_000, first + 7_000_000_000]
# The depth camera's clock: 300 ppm fast, from the third pulse on, without three.
dropped = [20, 21, 150]
depth = []
for number, pulse in enumerate(pulses):
    if number >= 3 and number not in dropped:
        stamp = 1_600_000_000_000_000_000 + int((pulse - first) * 1.0003)
        depth.append((number, stamp - stamp % 11_111))

messages = []  # (time received, topic, type, message)
for seq, (ns, values) in enumerate(board):
    gyro = [float(v) for v in values]
    accel = [0.25 * gyro[0], -9.81 + gyro[1], 1e-3 * seq]
    messages.append((ns, "/mcu_imu", "sensor_msgs/msg/Imu", Imu(
        header=header(seq, ns, "mcu_imu0"),
        orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=Vector3(x=gyro[0], y=gyro[1], z=gyro[2]),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=Vector3(x=accel[0], y=accel[1], z=accel[2]),
        linear_acceleration_covariance=np.zeros(9))))
    messages.append((ns, "/mcu_imu_temp", "sensor_msgs/msg/Temperature", Temperature(
        header=header(seq, ns, "mcu_imu0_temp"), temperature=35 + seq / 340, variance=0.0)))
TIMES = "sensor_msgs/msg/TimeReference"


def times(topic, seq, ns, other):
    messages.append((ns, topic, TIMES, TimeReference(
        header=header(seq, ns, topic[1:]), time_ref=time(other), source="")))


for seq, ns in enumerate(pulses):
    times("/mcu_cameras_ts", seq, ns, ns + 1_600_000_000_000_000_000)
times("/mcu_s10_ts", 0, pulses[0], pulses[0] + offset)
times("/mcu_lidar_ts", 0, first + 1_000_000_000, first + 1_000_000_001)
times("/depth_to_mcu_offset", 0, pulses[3], depth[0][1])
for seq, ns in enumerate(marks):
    times("/sequences_ts", seq, ns, ns)
for seq, (number, stamp) in enumerate(depth):
    pixels = np.arange(24, dtype=np.uint16) * 300 + number
    pixels[0] = 0
    messages.append((pulses[number] + 20_000_000, "/azure/depth/image_raw",
                     "sensor_msgs/msg/Image", Image(
        header=header(seq, stamp, "depth"), height=4, width=6, encoding="16UC1",
        is_bigendian=0, step=12, data=pixels.view(np.uint8))))

messages.sort(key=lambda message: message[0])
writer = Writer(out / "published.bag")
if compression != "none":
    writer.set_compression(Writer.CompressionFormat[compression.upper()])
with writer:
    connections = {}
    for ns, topic, kind, message in messages:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        writer.write(connections[topic], ns, store.serialize_ros1(message, kind))

folder = out / "phone" / "20210401_120000"
folder.mkdir(parents=True)
name = "VID_20210401_120000"
with open(folder / f"{name}gyro.csv", "w") as file:
    for ns, values in phone:
        file.write(",".join(values) + f",{ns}\n")
with open(folder / f"{name}accel.csv", "w") as file:
    for ns, _ in phone[::5]:
        file.write(f"0.5,-9.75,0.125,{ns}\n")
frames = [phone[0][0] + 200_000_000 + n * 33_330_652 for n in range(270)]
with open(folder / f"{name}_imu_timestamps.csv", "w") as file:
    file.writelines(f"{ns}\n" for ns in frames)

with open(out / "truth.json", "w") as file:
    json.dump({
        "imu": [[ns] + [float(v) for v in values] for ns, values in board],
        "pulses": pulses, "marks": marks, "depth": depth, "dropped": dropped,
        "frames": frames, "offset": offset, "phone_samples": len(phone),
    }, file)
