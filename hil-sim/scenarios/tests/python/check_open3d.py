"""Loads each pair of a TUM data set with Open3D's `create_from_tum_format`, and looks for the
wall that the depth camera saw: a plane as far away as the pair says, tilted as colour is.

usage: check_open3d.py CALIBRATION OUT

The wall is at 1,000 mm plus the number of the frame.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import open3d as o3d

calibration_path, out = map(Path, sys.argv[1:])
cameras = json.loads(calibration_path.read_text())["CalibrationInformation"]["Cameras"]
# From the depth camera to colour, in metres.
rotation = np.reshape(cameras[1]["Rt"]["Rotation"], (3, 3))
translation = np.array(cameras[1]["Rt"]["Translation"])
normal = rotation @ [0, 0, 1]

known = json.loads((out / "cameras.json").read_text())["color"]["intrinsics"]
width, height = known["width"], known["height"]
pinhole = o3d.camera.PinholeCameraIntrinsic(width, height, *known["focal"], *known["center"])
with open(out / "depth_frames.csv") as file:
    frames = list(csv.DictReader(file))
number_of = {f"{(int(row['timestamp [ns]']) + 500) // 1000 / 1e6:.6f}": int(row["#frame"])
             for row in frames if row["timestamp [ns]"]}

o3d.utility.random.seed(0)
lines = [line.split() for line in (out / "associations.txt").read_text().splitlines()]
assert len(lines) > 100, len(lines)
for index, (_, color_name, stamp, depth_name) in enumerate(lines):
    pair = o3d.geometry.RGBDImage.create_from_tum_format(
        o3d.io.read_image(str(out / color_name)), o3d.io.read_image(str(out / depth_name)))
    depth = np.asarray(pair.depth)
    assert depth.shape == np.asarray(pair.color).shape == (height, width), depth.shape
    wall = 1 + number_of[stamp] / 1e3
    # The tilted wall is nearer at the top and farther at the bottom.
    assert abs(np.median(depth[depth > 0]) - wall) < 0.03, (depth_name, wall)
    if index % 30:
        continue
    cloud = o3d.geometry.PointCloud.create_from_rgbd_image(pair, pinhole)
    plane, inliers = cloud.segment_plane(distance_threshold=0.005, ransac_n=3, num_iterations=200)
    plane = np.array(plane) * np.sign(plane[2])
    assert len(inliers) > 0.95 * len(cloud.points), (depth_name, len(inliers), len(cloud.points))
    tilt = np.degrees(np.arccos(np.clip(plane[:3] @ normal, -1, 1)))
    away = wall + normal @ translation
    assert tilt < 0.5 and abs(-plane[3] - away) < 0.005, (depth_name, plane, away, tilt)
print("ok")
