"""A plain Python reader of a recording, as somebody writes it in five minutes:
every IMU message decoded, and a EuRoC table written.

usage: extract_bench.py RECORDING.mcap OUT.csv
"""

import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file, open(sys.argv[2], "w") as out:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    rows = 0
    for _, _, _, message in reader.iter_decoded_messages(topics=["/board/imu"]):
        stamp = message.header.stamp
        w, a = message.angular_velocity, message.linear_acceleration
        out.write(f"{stamp.sec * 10**9 + stamp.nanosec},{w.x},{w.y},{w.z},{a.x},{a.y},{a.z}\n")
        rows += 1
print(rows)
