"""Opens an extracted data set with smartdepthsync-data and compares what it gives with the files
themselves, read by other libraries; and does to two recordings what the fleet does on a node.

usage: check_data.py EUROC ROS2 RECORDING PROGRAM
"""

import json
import os
import pickle
import shutil
import sys
import tarfile
import tempfile
from pathlib import Path
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[4] / "host/data/smartdepthsync-data/src"))

from smartdepthsync_data import Dataset, DatasetError, Imu, sequences
from smartdepthsync_data.fleet import run, table, work
from smartdepthsync_data.lerobot import rotation

euroc, ros2, recording, program = map(Path, sys.argv[1:])


def refused(path, expected, **more):
    try:
        Dataset(path, **more)
    except DatasetError as error:
        assert expected in str(error), error
    else:
        raise AssertionError(f"{path} was opened")


def is_same(text, other):
    try:
        return json.loads(text or b"") == json.loads(other)
    except ValueError:
        return False


def no_change_is_good(folder):
    """Every file but the page, gone, empty, cut, cut at a line, longer, with one byte changed, with a line
    repeated, or exchanged with another: none is opened and read to its end."""
    copy = folder / "changed"
    shutil.copytree(euroc, copy, ignore=shutil.ignore_patterns(".extraction"))

    def is_good():
        try:
            dataset = Dataset(copy)
            for pair in dataset:
                pair.image, pair.depth
            return len(dataset.board_imu) > 0
        except DatasetError:
            return False

    assert is_good()
    files = [path for path in sorted(copy.rglob("*")) if path.is_file() and path.name != "report.html"]
    images = [path for path in files if path.suffix in (".png", ".jpg")]
    tables = [path for path in files if path not in images]
    assert len(tables) > 12 and len(images) > 60
    paired = [copy / name for pair in list(Dataset(copy))[::40] for name in (pair.image_path, pair.depth_path)]
    tried, good = 0, []
    for path in [*tables, *paired]:
        whole = path.read_bytes()
        lines = whole.splitlines(keepends=True)
        others = (one for one in [*tables, *paired] if one != path and one.suffix == path.suffix)
        other = next(others, path)
        for what, changed in [
            ("gone", None),
            ("empty", b""),
            ("cut", whole[: len(whole) // 2]),
            ("cut at a line", b"".join(lines[: len(lines) // 2])),
            ("without a line", b"".join(lines[:1] + lines[2:])),
            ("longer", whole + b"\n"),
            ("changed", whole[: len(whole) // 2] + bytes([whole[len(whole) // 2] ^ 1]) + whole[len(whole) // 2 + 1 :]),
            ("a line twice", b"".join(lines[:2] + lines[1:])),
            ("lines exchanged", b"".join(lines[:1] + lines[2:3] + lines[1:2] + lines[3:])),
            ("another", other.read_bytes()),
        ]:
            if changed == whole or (path.name == "contents.json" and is_same(changed, whole)):
                continue
            path.unlink() if changed is None else path.write_bytes(changed)
            tried += 1
            if is_good():
                good.append(f"{path.relative_to(copy)} {what}")
        path.write_bytes(whole)
    print(f"{tried} changes of a data set")
    assert not good, good
    assert tried > 150 and is_good()


def the_data_set(folder):
    dataset = Dataset(euroc)
    pairs = pd.read_csv(euroc / "pairs.csv")
    report = json.loads((euroc / "report.json").read_text())
    phone, apart = pairs["phone_timestamp [ns]"], pairs["depth_minus_phone [ns]"]
    assert len(dataset) == len(pairs) > 30
    assert (dataset.times_ns == phone).all() and dataset.times_ns.dtype == np.int64
    assert (dataset.depth_times_ns - dataset.times_ns == apart).all()
    assert abs(dataset.sigma_ns / 1e3 - report["pairs"]["sigma_us"]) < 1e-9
    assert dataset.task == "walk past the wall"
    # The tar file of it is the same, and so is what a worker of a loader gets.
    whole = folder / "data.tar"
    with tarfile.open(whole, "w") as tar:
        tar.add(euroc, arcname="")
    for same in [dataset, Dataset(whole), pickle.loads(pickle.dumps(dataset))]:
        for index in [0, 7, -1]:
            pair = same[index]
            depth = euroc / f"mav0/depth0/data/{pair.depth_time_ns:019}.png"
            # By matplotlib, which has 16 bits as fractions.
            stored = np.round(matplotlib.image.imread(depth) * 65535)
            assert pair.depth.dtype == np.float32 and (pair.depth_mm == stored).all()
            assert np.abs(pair.depth - stored / 1000).max() < 1e-6
            image = matplotlib.image.imread(euroc / f"mav0/cam0/data/{pair.time_ns:019}.png")
            assert (pair.image == np.round(image[..., :3] * 255)).all()
    # The wall is at 1,000 mm plus the number of the frame.
    seen = [np.median(pair.depth[pair.depth > 0]) for pair in dataset[10:30]]
    assert np.abs(seen - (1 + pairs["depth_frame"][10:30] / 1e3)).max() < 1e-6, seen
    part = dataset[10:20:2]
    assert len(part) == 5 and part[1].time_ns == dataset[12].time_ns and len(dataset) == len(pairs)
    near = dataset.within(float(apart.abs().median()) / 1e9)
    assert 0 < len(near) < len(dataset)
    assert dataset.nearest(dataset[9].time_ns + 1_000_000) == 9
    assert [len(one) for one in sequences(euroc)] == [len(dataset)]
    for name, imu in {"imu0": dataset.board_imu, "imu1": dataset.phone_imu}.items():
        rows = pd.read_csv(euroc / f"mav0/{name}/data.csv")
        assert (imu.time_ns == rows.iloc[:, 0]).all() and len(imu) > 1000
        assert (np.hstack([imu.gyro, imu.accel]) == rows.iloc[:, 1:].to_numpy()).all()
        middle = imu.between(imu.time_ns[10], imu.time_ns[20])
        assert len(middle) == 10 and middle.time_ns[0] == imu.time_ns[10]
        assert np.allclose(imu.at(imu.time_ns[3:5]), rows.iloc[3:5, 1:])
    cameras = dataset.cameras
    yaml = (euroc / "mav0/cam0/sensor.yaml").read_text()
    matrix, (width, height) = cameras["phone"].matrix, cameras["phone"].size
    flat = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    assert f"intrinsics: [{', '.join(f'{number:.12g}' for number in flat)}]" in yaml, (flat, yaml)
    assert dataset[0].image.shape == (height, width, 3)
    # T_BS of the file is the way back.
    place = [text.split("[")[1] for text in yaml.split("T_BS")[1].split("]")[:1]][0]
    place = np.array(place.replace("\n", " ").split(","), float).reshape(4, 4)
    assert np.allclose(place @ cameras["phone"].from_imu, np.eye(4), atol=1e-9)
    assert cameras["depth"].matrix is not None and cameras["phone"].rolling_shutter[1] == "down"
    refused(folder / "none", "smartdepthsync extract")
    refused(folder, "report.json")
    refused(ros2, "--format euroc")
    refused(euroc, "no part seq_7", sequence="seq_7")


def actions():
    # One turn a second about z for half a second, in frames of 0.1 s.
    times = np.arange(0, 1_000_000_001, 2_000_000)
    gyro = np.zeros((len(times), 3))
    gyro[:, 2] = 2 * np.pi
    frames = np.arange(0, 500_000_001, 100_000_000)
    turning = SimpleNamespace(board_imu=Imu(times, gyro, gyro), times_ns=frames)
    names, turned = rotation(turning)
    assert len(names) == 3 and np.allclose(turned[:-1, 2], 0.2 * np.pi) and not turned[-1].any()


def the_node(folder):
    source, out = folder / "recordings", folder / "out"
    shutil.copytree(recording, source / "day/walk")
    shutil.copytree(recording, source / "broken")
    (source / "broken/recording.mcap").write_bytes(b"no recording")
    # The program, noting each extraction.
    noted = folder / "noted"
    wrapper = folder / "program"
    wrapper.write_text(f'#!/bin/sh\n[ "$1" = extract ] && echo "$2" >> {noted}\nexec {program} "$@"\n')
    wrapper.chmod(0o755)
    find = lambda: {job.name: job for job in run.find(str(source), str(out), program=str(wrapper))}
    jobs = find()
    assert list(jobs) == ["day/walk", "broken"] and jobs["day/walk"].size > jobs["broken"].size
    rows = [work.extract(job) for job in jobs.values()]
    assert [row["verdict"] for row in rows] == ["good", "failed"], rows
    assert rows[1]["exit_code"] not in (0, 4) and "recording.mcap" in rows[1]["message"], rows[1]
    there = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    names = {"day/walk.tar", "day/walk.log", "day/walk.json", "broken.log", "broken.json"}
    assert there == names, there
    dataset = Dataset(out / "day/walk.tar")
    assert len(dataset) == rows[0]["pairs"] > 100 and dataset[0].depth.max() > 0
    # Neither the same files again, nor the same content with other dates, nor after a loss of
    # the row alone; but other options, and what failed.
    for change, more in [(None, 0), ("dates", 0), ("row", 1), ("options", 1), ("failed", 1)]:
        job = jobs["broken" if change == "failed" else "day/walk"]
        if change == "dates":
            os.utime(source / "day/walk/recording.mcap", (1, 1))
            assert find()["day/walk"].state != job.state
            job = find()["day/walk"]
        elif change == "row":
            (out / "day/walk.json").unlink()
        elif change == "options":
            job = work.Job(**{**vars(job), "options": ("--infrared",)})
        before = noted.read_text().count("\n")
        row = work.extract(job)
        assert noted.read_text().count("\n") == before + more, change
        assert row["verdict"] == ("failed" if change == "failed" else "good")
    rows.sort(key=table.worst_first)
    table.parquet(rows, folder / "index.parquet")
    table.html(rows, folder / "index.html")
    read = pd.read_parquet(folder / "index.parquet")
    assert list(read["name"]) == ["broken", "day/walk"] and read["phase_sigma_us"][1] > 0
    assert "1 failed, 0 loss, 1 good" in (folder / "index.html").read_text()


with tempfile.TemporaryDirectory() as folder:
    the_data_set(Path(folder))
    no_change_is_good(Path(folder))
    actions()
    the_node(Path(folder))
print("ok")
