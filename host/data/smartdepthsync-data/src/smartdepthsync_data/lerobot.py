"""Conversion to LeRobot datasets, by LeRobot's own library.

A hand-held rig has no robot, so a recording has no commands. The columns are:

===========================  =====================================================
``observation.images.phone`` the phone's images, a video
``observation.images.depth`` depth in whole millimetres, an image of 16 bits, marked as
                             a depth map (``is_depth_map``)
``observation.state``        rates and accelerations of the board's IMU at the
                             phone's image: rad/s and m/s²
``action``                   by default the integral of the rates up to the next
                             image, rad; ``actions`` replaces it by what a policy learns
``phone_time_ns``,           board time of both images
``depth_time_ns``
===========================  =====================================================

LeRobot has no place for constants of a recording: ``meta/recordings.json``
has an object per episode with its recording, the 1-sigma of a pair's times, and the cameras.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .dataset import Dataset, DatasetError

PHONE, DEPTH = "observation.images.phone", "observation.images.depth"
STATE, ACTION = "observation.state", "action"
#: Task of recordings whose profile names none.
NO_TASK = "recording"

#: Number of threads that write image files before the video is encoded.
IMAGE_WRITERS = 4

#: Function that returns the actions a policy learns: names of the columns, and a row per pair.
Actions = Callable[[Dataset], tuple[list[str], np.ndarray]]


def rotation(dataset: Dataset) -> tuple[list[str], np.ndarray]:
    """Returns the integral of the board's angular rates from each image to the next one, rad."""
    imu, times = dataset.board_imu, dataset.times_ns
    since = (imu.time_ns - imu.time_ns[0]) / 1e9
    steps = np.diff(since)[:, None] * (imu.gyro[1:] + imu.gyro[:-1]) / 2
    angles = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    at = (times - imu.time_ns[0]) / 1e9
    turned = np.stack([np.interp(at, since, column) for column in angles.T], axis=1)
    # After the last image the rig is assumed to rest.
    turned = np.diff(turned, axis=0, append=turned[-1:])
    return [f"rotation_{axis}_rad" for axis in "xyz"], turned


def to_lerobot(
    datasets: Iterable[Dataset],
    out: str | Path,
    *,
    repo_id: str = "local/recordings",
    task: str | None = None,
    actions: Actions | None = rotation,
    robot_type: str | None = None,
) -> Any:
    """Writes a LeRobot dataset with an episode per data set, and returns it opened.

    ``task`` applies to data sets whose profile names none. ``actions=None`` omits the column.
    All data sets need the same image sizes and frame rate, at least two pairs, and an IMU. ``out``
    appears only when it is complete.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    datasets, out = list(datasets), Path(out)
    if out.exists():
        raise DatasetError(f"{out} is there already; give a folder that is not")
    if not datasets:
        raise DatasetError("there are no data sets to write")
    form = [_form(dataset, actions) for dataset in datasets]
    for dataset, own in zip(datasets, form, strict=True):
        if own != form[0]:
            raise DatasetError(
                f"{dataset.name} does not go with {datasets[0].name}: frame rate, sizes or actions "
                f"are {own} and {form[0]}; write two LeRobot datasets"
            )
    rate, phone, depth, names = form[0]
    partial = out.with_name(f"{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    writer = LeRobotDataset.create(
        repo_id=repo_id,
        fps=rate,
        root=partial,
        robot_type=robot_type,
        features=_features(phone, depth, names),
        use_videos=True,
        image_writer_threads=IMAGE_WRITERS,
    )
    try:
        with _statistics_of_depth():
            for dataset in datasets:
                for frame in _frames(dataset, task, actions):
                    writer.add_frame(frame)
                writer.save_episode()
        writer.finalize()
        about = json.dumps([_about(dataset) for dataset in datasets], indent=2)
        (partial / "meta/recordings.json").write_text(about)
    except BaseException:
        # Otherwise the library would write the rest when the object is deleted.
        with suppress(Exception):
            writer.finalize()
        shutil.rmtree(partial, ignore_errors=True)
        raise
    partial.rename(out)
    return LeRobotDataset(repo_id, root=out)


def _form(dataset: Dataset, actions: Actions | None) -> tuple[int, Any, Any, list[str]]:
    """Returns the frame rate in Hz, sizes of the images, and names of the actions."""
    if len(dataset) < 2 or not len(dataset.board_imu):
        raise DatasetError(f"{dataset.name} has {len(dataset)} pairs and {len(dataset.board_imu)} "
                           "samples of the board's IMU; an episode takes two pairs and the IMU")
    rate = round(1e9 / float(np.median(np.diff(dataset.times_ns))))
    first = dataset[0]
    names = [] if actions is None else actions(dataset)[0]
    return max(rate, 1), first.image.shape, first.depth_mm.shape, names


def _about(dataset: Dataset) -> dict[str, Any]:
    cameras = {
        name: {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in vars(camera).items()
        }
        for name, camera in dataset.cameras.items()
    }
    return {"recording": dataset.name, "pair_sigma_ns": dataset.sigma_ns, "cameras": cameras}


def _features(phone: Any, depth: Any, actions: list[str]) -> dict[str, Any]:
    sides = ["height", "width", "channels"]
    state = [f"gyro_{axis}_rad_s" for axis in "xyz"] + [f"accel_{axis}_m_s2" for axis in "xyz"]
    features: dict[str, Any] = {
        PHONE: {"dtype": "video", "shape": phone, "names": sides},
        DEPTH: {
            "dtype": "image",
            "shape": (*depth, 1),
            "names": sides,
            "info": {"is_depth_map": True, "depth_unit": "mm"},
        },
        STATE: {"dtype": "float32", "shape": (6,), "names": state},
        "phone_time_ns": {"dtype": "int64", "shape": (1,), "names": None},
        "depth_time_ns": {"dtype": "int64", "shape": (1,), "names": None},
    }
    if actions:
        features[ACTION] = {"dtype": "float32", "shape": (len(actions),), "names": actions}
    return features


def _frames(
    dataset: Dataset, task: str | None, actions: Actions | None
) -> Iterator[dict[str, Any]]:
    state = dataset.board_imu.at(dataset.times_ns).astype(np.float32)
    todo = None if actions is None else np.asarray(actions(dataset)[1], np.float32)
    if todo is not None and (todo.ndim != 2 or len(todo) != len(dataset)):
        raise DatasetError(f"{len(dataset)} pairs need as many rows of actions, not {todo.shape}")
    for index, pair in enumerate(dataset):
        frame = {
            PHONE: pair.image,
            # As an image of the library's own kind: arrays of one channel are new in 0.6.
            DEPTH: Image.fromarray(pair.depth_mm),
            STATE: state[index],
            "phone_time_ns": np.array([pair.time_ns]),
            "depth_time_ns": np.array([pair.depth_time_ns]),
            "task": dataset.task or task or NO_TASK,
        }
        if todo is not None:
            frame[ACTION] = todo[index]
        yield frame


@contextmanager
def _statistics_of_depth() -> Iterator[None]:
    """Replaces the library's statistics of depth by those in millimetres. Before version 0.6 the
    library does not know depth maps, and assumes 8 bits for all images."""
    from lerobot.datasets import compute_stats, lerobot_dataset

    original = getattr(lerobot_dataset, "compute_episode_stats", None)
    if original is None:
        yield
        return

    def ours(data: dict[str, Any], features: dict[str, Any], *more: Any) -> dict[str, Any]:
        paths = data[DEPTH]
        others = {key: value for key, value in data.items() if key != DEPTH}
        stats = original(others, features, *more)
        sampled = [paths[i] for i in compute_stats.sample_indices(len(paths))]
        # In floats, as the library squares the values.
        images = np.stack([np.array(Image.open(path), np.float64) for path in sampled])
        found = compute_stats.get_feature_stats(images[:, None], axis=(0, 2, 3), keepdims=True)
        # The library expects three colours.
        stats[DEPTH] = {
            key: value if key == "count" else np.broadcast_to(value[0], (3, 1, 1))
            for key, value in found.items()
        }
        return stats

    lerobot_dataset.compute_episode_stats = ours
    try:
        yield
    finally:
        lerobot_dataset.compute_episode_stats = original
