"""Data sets in EuRoC's layout, the default of ``smartdepthsync extract``.

The package reads ``report.json``, ``pairs.csv``, ``cameras.json``, and below ``mav0`` the images
and the tables of both IMUs. Times are nanoseconds of board time, as integers.
"""

from __future__ import annotations

import io
import json
import operator
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .files import DatasetError, Files, is_below
from .samples import Camera, Imu, Pair


class Dataset(Sequence):
    """An extracted data set: a sequence of :class:`Pair`, in order of time.

    ``path`` is its folder, or a tar file of the folder. A recording with marks has several parts,
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
            if not all(isinstance(part, str) and is_below(part) for part in parts):
                raise ValueError(f"its parts {parts} are not all folders below it")
            if not isinstance(self.report["recording"], str):
                raise ValueError("it does not name its recording")
        except DatasetError:
            raise
        except Exception as error:
            raise DatasetError(
                f"{path} has no readable contents.json or report.json ({error}); expected the output of "
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
        """Returns the times (n, 2) of the pairs whose images both exist."""
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
        """Returns the pairs whose images are at most ``seconds`` apart in time. This excludes those
        from before the trigger was aligned."""
        apart = np.abs(self._rows[:, 1] - self._rows[:, 0])
        return self._with(self._rows[apart <= seconds * 1e9])

    def nearest(self, time_ns: int) -> int:
        """Returns the index of the pair whose phone image is nearest to a board time."""
        if not len(self):
            raise DatasetError(f"{self.path} has no pairs")
        times = self.times_ns
        at = bisect_left(times, time_ns)
        near = [i for i in (at - 1, at) if 0 <= i < len(times)]
        return min(near, key=lambda i: abs(int(times[i]) - time_ns))

    @property
    def name(self) -> str:
        """Name of the recording, with the part if there are several."""
        name = self.report["recording"]
        return name if self.sequence == "." else f"{name}/{self.sequence}"

    @property
    def task(self) -> str | None:
        """Task that the recording shows, if the rig profile names one."""
        return self.report.get("task")

    @property
    def times_ns(self) -> np.ndarray:
        """Board time of each pair's phone image (n)."""
        return self._rows[:, 0]

    @property
    def depth_times_ns(self) -> np.ndarray:
        """Board time of each pair's depth image (n)."""
        return self._rows[:, 1]

    @property
    def sigma_ns(self) -> float | None:
        """Largest 1-sigma of the difference of a pair's times in the recording; None if unknown."""
        sigma = (self.report.get("pairs") or {}).get("sigma_us")
        return None if sigma is None else 1e3 * sigma

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """Cameras by name: ``phone``, ``depth`` (as written, after any registration), and the depth
        camera's ``color``."""
        names = ("phone", "color", "depth")
        try:
            text = self.files.read("cameras.json") if "cameras.json" in self.files else "{}"
            known = json.loads(text)
            return {name: Camera.from_json(known.get(name, {})) for name in names}
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise DatasetError(f"cameras.json in {self.path} is damaged: {error}") from error

    @cached_property
    def board_imu(self) -> Imu:
        """Samples of the board's IMU, whose frame the cameras' poses refer to."""
        return self._imu("imu0")

    @cached_property
    def phone_imu(self) -> Imu:
        """Samples of the phone's IMU."""
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
        """Returns a view for PyTorch: a :class:`smartdepthsync_data.torch.TorchDataset`."""
        try:
            from .torch import TorchDataset
        except ImportError as error:
            fix = "pip install 'smartdepthsync-data[torch]'"
            raise ImportError(f"{error}; for tensors: {fix}") from error
        return TorchDataset(self)


def sequences(path: str | Path) -> list[Dataset]:
    """Opens all parts of a data set: one, unless marks divide the recording."""
    whole = Dataset(path, ".")
    parts = [part["folder"] for part in whole.report["sequences"]]
    return [Dataset(path, part) for part in parts] if len(parts) > 1 else [whole]
