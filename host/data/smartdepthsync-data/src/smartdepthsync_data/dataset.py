"""Data sets in EuRoC's layout, as ``smartdepthsync extract`` writes them by default.

What is read: ``report.json``, ``pairs.csv``, ``cameras.json``, and below ``mav0`` the images
and the tables of both IMUs. Times are nanoseconds of board time, as integers.
"""

from __future__ import annotations

import io
import json
import operator
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .files import Files

MILLIMETRES = 1000.0


class DatasetError(Exception):
    """A folder is no data set that can be read; says what is and what to do."""


@dataclass(frozen=True)
class Imu:
    """Samples of an IMU: board time in ns, rad/s and m/s² (n, 3)."""

    time_ns: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def __len__(self) -> int:
        return len(self.time_ns)

    def between(self, begin_ns: int, end_ns: int) -> Imu:
        """The samples from ``begin_ns`` to before ``end_ns``."""
        first, end = np.searchsorted(self.time_ns, [begin_ns, end_ns])
        return Imu(self.time_ns[first:end], self.gyro[first:end], self.accel[first:end])

    def at(self, times_ns: np.ndarray) -> np.ndarray:
        """Rates and accelerations (n, 6) at these times, between samples linearly."""
        since, wanted = self.time_ns - self.time_ns[0], times_ns - self.time_ns[0]
        values = np.hstack([self.gyro, self.accel])
        return np.stack([np.interp(wanted, since, column) for column in values.T], axis=1)


@dataclass(frozen=True)
class Camera:
    """What is known of a camera; None where the profile and the depth camera say nothing."""

    #: Width and height, pixels.
    size: tuple[int, int] | None = None
    #: 3 x 3; the centre of the first pixel is (0, 0).
    matrix: np.ndarray | None = None
    #: ``none``, ``radtan``, ``rational`` or ``equidistant``, and its numbers.
    distortion: tuple[str, tuple[float, ...]] | None = None
    #: 4 x 4, metres: from the frame of the board's IMU to the camera's.
    from_imu: np.ndarray | None = None
    #: Time from one row (or column) to the next in ns, and where the readout goes.
    rolling_shutter: tuple[int, str] | None = None

    @classmethod
    def _of(cls, known: dict[str, Any]) -> Camera:
        lens, pose = known.get("intrinsics"), known.get("from_imu")
        shutter = known.get("shutter")
        values: dict[str, Any] = {}
        if lens:
            (fx, fy), (cx, cy) = lens["focal"], lens["center"]
            values["size"] = (lens["width"], lens["height"])
            values["matrix"] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
            values["distortion"] = (lens["distortion"], tuple(lens["coefficients"]))
        return cls(
            **values,
            from_imu=None if pose is None else np.array(pose, dtype=float),
            rolling_shutter=None if shutter is None else tuple(shutter),
        )


@dataclass(frozen=True)
class Pair:
    """An image of the phone and the depth image nearest to it. Images are read when asked for."""

    #: Board time of the phone's image: middle of exposure of the middle row.
    time_ns: int
    #: Board time of the depth image: centre of exposure.
    depth_time_ns: int
    #: 1-sigma of the difference of the two, the constant included; None if it is not known.
    sigma_ns: float | None
    files: Files
    image_path: str
    depth_path: str

    @cached_property
    def image(self) -> np.ndarray:
        """The phone's image: (height, width, 3), 8 bits, red first."""
        return np.array(_open(self.files, self.image_path).convert("RGB"))

    @cached_property
    def depth_mm(self) -> np.ndarray:
        """Depth as it is stored: (height, width), whole millimetres in 16 bits; 0 is none."""
        return np.array(_open(self.files, self.depth_path)).astype(np.uint16)

    @property
    def depth(self) -> np.ndarray:
        """Depth: (height, width), metres in 32-bit floats; 0 is none."""
        return self.depth_mm.astype(np.float32) / np.float32(MILLIMETRES)


class Dataset(Sequence):
    """An extracted data set: a sequence of :class:`Pair`, in order of time.

    ``path`` is its folder, or a tar file of one. A recording with marks has several parts,
    of which ``sequence`` names one (:func:`sequences` opens all). A slice is a data set too.
    """

    def __init__(self, path: str | Path, sequence: str | None = None):
        self.path = Path(path)
        if not self.path.exists():
            raise DatasetError(f"there is no {path}; expected the output of `smartdepthsync extract`")
        try:
            self.files = Files(self.path)
            self.report: dict[str, Any] = json.loads(self.files.read("report.json"))
            kind, parts = self.report["format"], [p["folder"] for p in self.report["sequences"]]
        except Exception as error:
            raise DatasetError(
                f"{path} has no readable report.json ({error}); expected the output of "
                "`smartdepthsync extract`"
            ) from error
        if kind != "euroc":
            raise DatasetError(f"{path} is of the format {kind}; extract it with --format euroc")
        if sequence is None and len(parts) > 1:
            raise DatasetError(
                f"marks divide {path} into {', '.join(parts)}; give one of them as `sequence`, or "
                "open all by `sequences`"
            )
        self.sequence = sequence or next(iter(parts), ".")
        if self.sequence not in [*parts, "."]:
            raise DatasetError(f"{path} has no part {sequence}; there are {', '.join(parts)}")
        self._rows = self._paired()

    def _name(self, name: str) -> str:
        return name if self.sequence == "." else f"{self.sequence}/{name}"

    def _paired(self) -> np.ndarray:
        """Times of the pairs of which both images are there."""
        if "pairs.csv" not in self.files:
            return np.zeros((0, 2), np.int64)
        columns = self._table("pairs.csv", np.int64, usecols=(1, 3)).reshape(-1, 2)
        have = [self._times(camera) for camera in ("cam0", "depth0")]
        return columns[np.isin(columns[:, 0], have[0]) & np.isin(columns[:, 1], have[1])]

    def _times(self, camera: str) -> np.ndarray:
        name = self._name(f"mav0/{camera}/data.csv")
        if name not in self.files:
            return np.zeros(0, np.int64)
        return self._table(name, np.int64, usecols=(0,)).reshape(-1)

    def _table(self, name: str, kind: Any, **options: Any) -> np.ndarray:
        options.setdefault("ndmin", 2)
        try:
            text = io.StringIO(self.files.read(name).decode())
            return np.loadtxt(text, kind, delimiter=",", skiprows=1, **options)
        except ValueError as error:
            raise DatasetError(f"{name} in {self.path} is damaged: {error}") from error

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return self._with(self._rows[index])
        phone, depth = map(int, self._rows[operator.index(index)])
        return Pair(
            phone,
            depth,
            self.sigma_ns,
            self.files,
            self._name(f"mav0/cam0/data/{phone:019}.png"),
            self._name(f"mav0/depth0/data/{depth:019}.png"),
        )

    def __iter__(self) -> Iterator[Pair]:
        return (self[index] for index in range(len(self)))

    def __repr__(self) -> str:
        return f"<Dataset {self.name}: {len(self)} pairs>"

    def _with(self, rows: np.ndarray) -> Dataset:
        part = object.__new__(Dataset)
        part.__dict__ = {**self.__dict__, "_rows": rows}
        return part

    def within(self, seconds: float) -> Dataset:
        """The pairs whose images are no further apart in time than that: without those from
        before the trigger was aligned."""
        apart = np.abs(self._rows[:, 1] - self._rows[:, 0])
        return self._with(self._rows[apart <= seconds * 1e9])

    def nearest(self, time_ns: int) -> int:
        """The index of the pair whose phone image is nearest to a board time."""
        if not len(self):
            raise DatasetError(f"{self.path} has no pairs")
        times = self.times_ns
        at = bisect_left(times, time_ns)
        near = [i for i in (at - 1, at) if 0 <= i < len(times)]
        return min(near, key=lambda i: abs(int(times[i]) - time_ns))

    @property
    def name(self) -> str:
        """The recording, and which part of it."""
        name = self.report["recording"]
        return name if self.sequence == "." else f"{name}/{self.sequence}"

    @property
    def task(self) -> str | None:
        """What was done, as the rig profile says it."""
        return self.report.get("task")

    @property
    def times_ns(self) -> np.ndarray:
        """Board time of each pair's phone image."""
        return self._rows[:, 0]

    @property
    def depth_times_ns(self) -> np.ndarray:
        """Board time of each pair's depth image."""
        return self._rows[:, 1]

    @property
    def sigma_ns(self) -> float | None:
        """1-sigma of the difference of a pair's times, the largest of the recording."""
        sigma = (self.report.get("pairs") or {}).get("sigma_us")
        return None if sigma is None else 1e3 * sigma

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """``phone``, ``depth`` (as it is written, so after ``--register``), and ``color`` of the
        depth camera."""
        known = json.loads(self.files.read("cameras.json")) if "cameras.json" in self.files else {}
        return {name: Camera._of(known.get(name, {})) for name in ("phone", "color", "depth")}

    @cached_property
    def board_imu(self) -> Imu:
        """The board's IMU, in whose frame the cameras' poses are."""
        return self._imu("imu0")

    @cached_property
    def phone_imu(self) -> Imu:
        """The phone's IMU."""
        return self._imu("imu1")

    def _imu(self, which: str) -> Imu:
        name = self._name(f"mav0/{which}/data.csv")
        kind = np.dtype([("time", np.int64), ("values", np.float64, 6)])
        if name in self.files:
            rows = self._table(name, kind, ndmin=1)
        else:
            rows = np.zeros(0, kind)
        return Imu(rows["time"], rows["values"][:, :3], rows["values"][:, 3:])

    def torch(self) -> Any:
        """A view for PyTorch: see :class:`smartdepthsync_data.torch.TorchDataset`."""
        from .torch import TorchDataset

        return TorchDataset(self)


def _open(files: Files, name: str) -> Image.Image:
    return Image.open(io.BytesIO(files.read(name)))


def sequences(path: str | Path) -> list[Dataset]:
    """All parts of a data set: one, unless marks divide the recording."""
    whole = Dataset(path, ".")
    parts = [part["folder"] for part in whole.report["sequences"]]
    return [Dataset(path, part) for part in parts] if len(parts) > 1 else [whole]
