"""Contents of a data set: samples of an IMU, cameras, and pairs of images."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from PIL import Image

from .files import DatasetError, Files

MILLIMETRES = 1000.0
#: Most pixels of an image: 8K video has 33 million.
MAX_PIXELS = 40_000_000


@dataclass(frozen=True)
class Imu:
    """Samples of an IMU: board time in ns (n), rates in rad/s and accelerations in m/s² (n, 3)."""

    time_ns: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def __len__(self) -> int:
        return len(self.time_ns)

    def between(self, begin_ns: int, end_ns: int) -> Imu:
        """Returns the samples from ``begin_ns`` (included) to ``end_ns`` (excluded)."""
        first, end = np.searchsorted(self.time_ns, [begin_ns, end_ns])
        return Imu(self.time_ns[first:end], self.gyro[first:end], self.accel[first:end])

    def at(self, times_ns: np.ndarray) -> np.ndarray:
        """Returns rates and accelerations (n, 6) at these times, interpolated linearly."""
        since, wanted = self.time_ns - self.time_ns[0], times_ns - self.time_ns[0]
        values = np.hstack([self.gyro, self.accel])
        return np.stack([np.interp(wanted, since, column) for column in values.T], axis=1)


@dataclass(frozen=True)
class Camera:
    """Known properties of a camera; None where neither profile nor depth camera states one."""

    #: Width and height, pixels.
    size: tuple[int, int] | None = None
    #: 3 x 3; the centre of the first pixel is (0, 0).
    matrix: np.ndarray | None = None
    #: ``none``, ``radtan``, ``rational`` or ``equidistant``, and the coefficients.
    distortion: tuple[str, tuple[float, ...]] | None = None
    #: 4 x 4, metres: from the frame of the board's IMU to that of the camera.
    from_imu: np.ndarray | None = None
    #: Time from one row (or column) to the next in ns, and the direction of the readout.
    rolling_shutter: tuple[int, str] | None = None

    @classmethod
    def from_json(cls, known: dict[str, Any]) -> Camera:
        """Reads a camera of ``cameras.json``."""
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
    """An image of the phone and the depth image nearest to it. Images are read on access."""

    #: Board time of the phone's image: middle of exposure of the middle row.
    time_ns: int
    #: Board time of the depth image: centre of exposure.
    depth_time_ns: int
    #: 1-sigma of the difference of the two, errors of the constants included; None if unknown.
    sigma_ns: float | None
    files: Files
    image_path: str
    depth_path: str

    @cached_property
    def image(self) -> np.ndarray:
        """The phone's image: (height, width, 3), 8 bits, in the order red, green, blue."""
        return _pixels(self.files, self.image_path, "RGB")

    @cached_property
    def depth_mm(self) -> np.ndarray:
        """Depth as stored: (height, width), whole millimetres in 16 bits; 0 is none."""
        return _pixels(self.files, self.depth_path).astype(np.uint16)

    @property
    def depth(self) -> np.ndarray:
        """Depth: (height, width), metres in 32-bit floats; 0 is none."""
        return self.depth_mm.astype(np.float32) / np.float32(MILLIMETRES)


def _pixels(files: Files, name: str, mode: str | None = None) -> np.ndarray:
    """Decodes an image. Its head is read first, so that a small file takes little memory."""
    try:
        image = Image.open(io.BytesIO(files.read(name)))
        width, height = image.size
        if width * height > MAX_PIXELS:
            raise ValueError(f"{width} x {height} pixels are more than any camera here has")
        return np.array(image if mode is None else image.convert(mode))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise DatasetError(f"the image {name} in {files.path} cannot be read: {error}") from error
