"""Reads the extractions of the published system's bag with public packages and
compares every number with what went into the bag.

usage: check_published.py TRUTH_FOLDER TOPICS EUROC TUM KALIBR
"""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from evo.core import sync
from PIL import Image

truth_folder, topics, euroc, tum, kalibr = map(Path, sys.argv[1:])
truth = json.loads((truth_folder / "truth.json").read_text())
imu = np.array([row[1:] for row in truth["imu"]])
stamps = np.array([row[0] for row in truth["imu"]])
marks = truth["marks"]
pulses = np.array(truth["pulses"])
PARTS = [f"seq_{n}" for n in range(3)]
DELAY = 1_900_000
CENTER = 6_362_500


def same(a, b, what):
    assert len(a) == len(b), f"{what}: {len(a)} and {len(b)} rows"
    assert (np.asarray(a) == np.asarray(b)).all(), what


def together(base, name, **options):
    parts = [pd.read_csv(base / part / name, **options) for part in PARTS]
    bounds = [0, *marks, 2**63 - 1]
    for part, low, high in zip(parts, bounds, bounds[1:]):
        assert ((part.iloc[:, 0] >= low) & (part.iloc[:, 0] < high)).all(), name
    return pd.concat(parts, ignore_index=True)


# The published layout: the same numbers, to the last digit.
table = together(topics, "_mcu_imu/imu.csv", header=None)
same(table[0], stamps, "stamps of the topics layout")
same(table[[1, 2, 3]], imu, "angular rates of the topics layout")
same(table[6], 1e-3 * np.arange(len(stamps)), "accelerations")
same(table[7], 35 + np.arange(len(stamps)) / 340, "temperatures")
parts = [pd.read_csv(topics / part / "_mcu_cameras_ts/time_ref.csv", header=None) for part in PARTS]
cameras = pd.concat(parts)
same(cameras[0], np.arange(len(pulses)), "sequence numbers")
same(cameras[1], pulses, "pulses")
same(cameras[2], pulses + 1_600_000_000_000_000_000, "time references")
s10 = pd.read_csv(topics / "seq_0/_mcu_s10_ts/time_ref.csv", header=None)
assert s10[2][0] - s10[1][0] == truth["offset"]
same(pd.concat([pd.read_csv(topics / part / "_sequences_ts/time_ref.csv", header=None)
                for part in PARTS[1:]])[1], marks, "marks")

# Depth: every frame at its pulse, every pixel its own.
expected = {int(pulses[number]): number for number, _ in truth["depth"]}
found = {}
for part in PARTS:
    for path in (topics / part / "_azure_depth_image_raw").glob("*.png"):
        found[int(path.stem)] = np.array(Image.open(path))
assert sorted(found) == sorted(expected), "depth stamps"
# Whoever sorts names has the images in order of time, in every format.
for base, folder in [(topics, "_azure_depth_image_raw"), (euroc, "mav0/depth0/data"), (tum, "depth")]:
    for part in PARTS:
        names = sorted(path.name for path in (base / part / folder).glob("*.png"))
        same(names, sorted(names, key=lambda name: float(Path(name).stem)), "order of names")
        assert len({len(name) for name in names}) == 1, names[:3]
for stamp, pixels in found.items():
    wanted = np.arange(24) * 300 + expected[stamp]
    wanted[0] = 0
    same(pixels.reshape(-1), wanted, "depth pixels")
frames = pd.read_csv(topics / "depth_frames.csv")
assert (frames["state"] == "matched").all()
same(frames["number"], [number for number, _ in truth["depth"]], "pulse numbers")
report = json.loads((topics / "report.json").read_text())
assert report["depth"]["missing"] == truth["dropped"], report["depth"]["missing"]
assert report["board"]["marks_ns"] == marks

# EuRoC: the same samples, their low-pass delay subtracted.
table = together(euroc, "mav0/imu0/data.csv")
same(table["#timestamp [ns]"], stamps - DELAY, "EuRoC stamps")
same(table[["w_RS_S_x [rad s^-1]", "w_RS_S_y [rad s^-1]", "w_RS_S_z [rad s^-1]"]], imu, "EuRoC rates")
phone = pd.concat([pd.read_csv(euroc / part / "mav0/imu1/data.csv") for part in PARTS])
assert abs(len(phone) - truth["phone_samples"]) <= 5
same(phone["a_RS_S_y [m s^-2]"], np.full(len(phone), -9.75), "phone accelerations")
assert (np.diff(phone["#timestamp [ns]"]) > 0).all()
depth = pd.concat([pd.read_csv(euroc / part / "mav0/depth0/data.csv") for part in PARTS])
same(depth["#timestamp [ns]"], sorted(stamp + CENTER for stamp in expected), "EuRoC depth")
for part in PARTS:
    rows = pd.read_csv(euroc / part / "mav0/depth0/data.csv")
    for name in rows["filename"]:
        assert (euroc / part / "mav0/depth0/data" / name).exists(), name

# Pairs: those that a public association of the two lists gives.
pairs = pd.read_csv(euroc / "pairs.csv")
color = pd.read_csv(euroc / "phone_frames.csv")
same(pairs["depth_minus_phone [ns]"],
     pairs["depth_frame"].map(pd.read_csv(euroc / "depth_frames.csv")["timestamp [ns]"])
     - pairs["#phone_frame"].map(color["timestamp [ns]"]), "differences")
seconds = (color["timestamp [ns]"].to_numpy() - int(pulses[0])) * 1e-9
depths = (depth["#timestamp [ns]"].to_numpy() - int(pulses[0])) * 1e-9
ours, theirs = sync.matching_time_indices(seconds, depths, max_diff=0.0166)
by_evo = set()
for a, b in zip(ours, theirs):
    by_evo.add((int(a), int(b)))
mine = {(int(a), int(b)) for a, b in zip(pairs["#phone_frame"], pairs["depth_frame"])}
assert mine <= by_evo, sorted(mine - by_evo)[:5]
assert len(mine) >= 0.95 * len({b for _, b in by_evo}), (len(mine), len(by_evo))

# TUM: depth is five a millimetre, and the lists read as the format's tools read them.
count = 0
for part in PARTS:
    lines = [line.split() for line in (tum / part / "depth.txt").read_text().splitlines()
             if not line.startswith("#")]
    for stamp, name in lines:
        pixels = np.array(Image.open(tum / part / name)).reshape(-1).astype(int)
        number = int(pixels[1] / 5) - 300
        wanted = (np.arange(24) * 300 + number) * 5
        wanted[0] = 0
        same(pixels, wanted, "TUM pixels")
        assert stamp == f"{(int(pulses[number]) + CENTER + 500) // 1000 / 1e6:.6f}", stamp
        count += 1
    accelerometer = np.loadtxt(tum / part / "accelerometer.txt")
    assert accelerometer.shape[1] == 4
assert count == len(expected), count

# Kalibr: its bag creator takes the last nine digits of a stamp's text for nanoseconds and
# what is before for seconds, of names and of rows alike, and ROS has no time zero.
def as_kalibr(text):
    assert int(text[:-9]) >= 1000
    return int(text[:-9]) * 1_000_000_000 + int(text[-9:])


OFFSET = 1_000_000_000_000
rows = [line.split(",") for part in PARTS
        for line in (kalibr / part / "kalibr/imu0.csv").read_text().splitlines()[1:]]
same([as_kalibr(row[0]) for row in rows], stamps - DELAY + OFFSET, "Kalibr's stamps")
same([[float(cell) for cell in row[1:4]] for row in rows], imu, "Kalibr's rates")
names = [path.stem for part in PARTS for path in (kalibr / part / "kalibr/depth0").glob("*.png")]
same(sorted(map(as_kalibr, names)), np.array(sorted(expected)) + CENTER + OFFSET, "Kalibr's images")
# ORB-SLAM3 takes each line of its times file for a name without its ending.
for part in PARTS:
    folder = euroc / part / "mav0/depth0"
    times = (folder / "times.txt").read_text().split()
    same(times, [path.stem for path in sorted((folder / "data").glob("*.png"))], "times of ORB-SLAM3")
print("ok")
