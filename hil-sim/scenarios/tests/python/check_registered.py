"""Compares depth that was registered to colour with the camera maker's own library (libk4a
in the wheel `pyk4a-bundle`), and loads the data set as Open3D's `create_from_tum_format` and
ORB-SLAM3's RGB-D example do: each line of `associations.txt` names two images of the same
size, depth with 16 bits and 5,000 a metre. COLMAP's camera with the numbers of `cameras.json`
sees points where that library does.

usage: check_registered.py CALIBRATION OUT [SAME]

The depth camera saw a wall at 1,000 mm plus the number of the frame, in mode
NFOV_UNBINNED beside colour of 720p. SAME is `mav0` of an extraction as EuRoC whose phone is
that colour camera: its depth images, in mm, must show the same, and COLMAP takes its images.
"""

import ctypes as C
import json
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap
from PIL import Image

calibration_path, out, *same = map(Path, sys.argv[1:])
libraries = Path(sysconfig.get_path("purelib")) / "pyk4a_bundle.libs"


def load(name):
    (path,) = libraries.glob(name)
    return C.CDLL(str(path), C.RTLD_GLOBAL)


load("libudev*")
k4a = load("libk4a-*")
raw = calibration_path.read_bytes() + b"\0"
calibration = C.create_string_buffer(16_384)
NFOV_UNBINNED, COLOR_720P = 2, 1
assert k4a.k4a_calibration_get_from_raw(
    raw, C.c_size_t(len(raw)), NFOV_UNBINNED, COLOR_720P, calibration) == 0
for name in ["k4a_calibration_2d_to_2d", "k4a_calibration_2d_to_3d"]:
    getattr(k4a, name).argtypes = [
        C.c_void_p, C.c_void_p, C.c_float, C.c_int, C.c_int, C.c_void_p, C.c_void_p]


def as_seen(column, row, depth):
    """Pixel of colour, and the point from there, mm."""
    pixel, point = (C.c_float * 2)(column, row), (C.c_float * 3)()
    seen, valid = (C.c_float * 2)(), C.c_int()
    k4a.k4a_calibration_2d_to_2d(calibration, pixel, depth, 0, 1, seen, C.byref(valid))
    if not valid.value:
        return None
    k4a.k4a_calibration_2d_to_3d(calibration, pixel, depth, 0, 1, point, C.byref(valid))
    return list(seen), list(point)


frames = pd.read_csv(out / "depth_frames.csv")
number_of = {f"{(at + 500) // 1000 / 1e6:.6f}": number
             for number, at in zip(frames["#frame"], frames["timestamp [ns]"])}
lines = [line.split() for line in (out / "associations.txt").read_text().splitlines()]
assert len(lines) > 30, len(lines)
pixels, points = [], []
for _, color_name, stamp, depth_name in lines[:: len(lines) // 4]:
    color, depth = Image.open(out / color_name), Image.open(out / depth_name)
    assert color.size == depth.size == (1280, 720), (color.size, depth.size)
    millimetres = np.array(depth).astype(float) / 5
    wall = 1_000 + number_of[stamp]
    for column in range(8, 640, 24):
        for row in range(8, 576, 24):
            seen = as_seen(column, row, wall)
            if seen is None:
                continue
            (x, y), point = seen
            if not (1 <= x < 1279 and 1 <= y < 719):
                continue
            # The wall is tilted against colour by less than 2 mm from pixel to pixel.
            found = millimetres[round(y), round(x)]
            assert abs(found - point[2]) < 2.5, (column, row, found, point)
            pixels.append((x, y))
            points.append(point)
assert len(points) > 1_000, len(points)

# COLMAP has the centre of the first pixel at 0.5.
known = json.loads((out / "cameras.json").read_text())["color"]["intrinsics"]
MODEL = "FULL_OPENCV"
numbers = [*known["focal"], *(at + 0.5 for at in known["center"]), *known["coefficients"]]
camera = pycolmap.Camera(model=MODEL, width=known["width"], height=known["height"], params=numbers)
off = np.abs(camera.img_from_cam(np.array(points)) - 0.5 - pixels)
assert off.max() < 0.02, off.max()
for folder in same:
    # Ten a second, in the order of their names.
    images = folder / "cam0/data"
    chosen = sorted(path.name for path in images.glob("*.png"))[::3]
    options = pycolmap.ImageReaderOptions(camera_model=MODEL, camera_params=",".join(map(str, numbers)))
    with tempfile.TemporaryDirectory() as place:
        database_path = Path(place) / "database.db"
        pycolmap.Database.open(database_path).close()
        pycolmap.import_images(database_path, images, pycolmap.CameraMode.SINGLE, chosen, options)
        database = pycolmap.Database.open(database_path)
        assert [image.name for image in database.read_all_images()] == chosen
        (taken,) = database.read_all_cameras()
        database.close()
    assert (taken.width, taken.height) == (camera.width, camera.height)
    assert np.abs(taken.params - numbers).max() < 1e-3 and taken.has_prior_focal_length

    names, others = sorted((folder / "depth0/data").glob("*.png")), sorted((out / "depth").glob("*.png"))
    assert len(names) == len(others) > 30
    for a, b in list(zip(names, others))[:: len(names) // 4]:
        off = np.abs(np.array(Image.open(a)).astype(int) * 5 - np.array(Image.open(b)).astype(int))
        # The edges of the wall may round to another pixel.
        assert (off > 5).mean() < 1e-3, a
print("ok")
