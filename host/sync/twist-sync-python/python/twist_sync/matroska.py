"""Recordings of the Azure Kinect: the gyroscope in the track S_K4A/IMU of Matroska, and frames.

Elements of <https://www.rfc-editor.org/rfc/rfc9559>; the track by `libk4arecord`, see the vendor's
<https://microsoft.github.io/Azure-Kinect-Sensor-SDK/master/record_format.html>.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from ._recording import Recording, Unreadable

#: Elements that are entered: Segment, Cluster, BlockGroup, Info, Tracks, TrackEntry, Tags, Tag,
#: SimpleTag. One after the other in the file, so that unknown sizes do no harm.
_ENTERED = {0x18538067, 0x1F43B675, 0xA0, 0x1549A966, 0x1654AE6B, 0xAE, 0x1254C367, 0x7373, 0x67C8}
_BLOCKS = {0xA1, 0xA3}
_SAMPLE = np.dtype([("acc_ns", "<u8"), ("acc", "<f4", 3), ("gyro_ns", "<u8"), ("gyro", "<f4", 3)])
#: Longest size of other elements that are read, bytes.
_LONGEST = 4096


def _number(file: BinaryIO, is_id: bool) -> int | None:
    """Reads a number of variable length, with its marker if it is an ID. None at the end of the
    file; -1 for an unknown size."""
    first = file.read(1)
    if not first or not first[0]:
        return None
    length = 9 - first[0].bit_length()
    rest = file.read(length - 1)
    value = int.from_bytes(first + rest, "big")
    mask = (1 << 7 * length) - 1
    if is_id:
        return value
    return -1 if value & mask == mask else value & mask


def _laced(block: bytes, at: int, lacing: int) -> bytes:
    """Returns the frames of a block, which are adjacent and of equal size."""
    if not lacing:
        return block[at:]
    count = block[at]
    at += 1
    for _ in range(count if lacing != 2 else 0):
        if lacing == 1:
            while block[at] == 255:
                at += 1
            at += 1
        else:
            at += 9 - block[at].bit_length()
    return block[at:]


def read(path: Path) -> Recording:
    """Reads the recording, without the pictures."""
    names: dict[int, str] = {}
    number, cluster, scale, tag, start_ns = 0, 0, 1_000_000, b"", 0
    imu = bytearray()
    frames: dict[int, list[int]] = {}
    notes: list[str] = []
    with path.open("rb") as file:
        size = path.stat().st_size
        while (kind := _number(file, True)) is not None and (
            length := _number(file, False)
        ) is not None:
            if kind in _ENTERED:
                continue
            end = file.tell() + length
            if length < 0 or end > size:
                notes.append(f"it ends within an element at byte {file.tell()}")
                break
            if kind in _BLOCKS:
                head = file.read(min(length, 12))
                step = 9 - (head[0].bit_length() or 1)
                track = int.from_bytes(head[:step], "big") & ((1 << 7 * step) - 1)
                time = int.from_bytes(head[step : step + 2], "big", signed=True)
                if names.get(track) == "IMU":
                    block = head + file.read(length - len(head))
                    imu += _laced(block, step + 3, block[step + 2] >> 1 & 3)
                else:
                    frames.setdefault(track, []).append((cluster + time) * scale)
            elif length <= _LONGEST:
                value = file.read(length)
                if kind == 0xD7:
                    number = int.from_bytes(value, "big")
                elif kind == 0x536E:
                    names.setdefault(number, value.decode(errors="replace").strip("\0"))
                elif kind == 0x86 and value == b"S_K4A/IMU":
                    names[number] = "IMU"
                elif kind == 0xE7:
                    cluster = int.from_bytes(value, "big")
                elif kind == 0x2AD7B1:
                    scale = int.from_bytes(value, "big")
                elif kind == 0x45A3:
                    tag = value
                elif kind == 0x4487 and tag == b"K4A_START_OFFSET_NS":
                    start_ns = int(value)
            file.seek(end)
    if not imu:
        raise Unreadable("Matroska without the IMU track of an Azure Kinect (record with --imu ON)")
    table = np.frombuffer(bytes(imu[: len(imu) // _SAMPLE.itemsize * _SAMPLE.itemsize]), _SAMPLE)
    return Recording(
        path,
        "Azure Kinect: its IMU track, device time, rates in rad/s",
        table["gyro_ns"].astype(np.int64),
        table["gyro"].astype(float),
        {names.get(k, str(k)): np.array(v, dtype=np.int64) + start_ns for k, v in frames.items()},
        notes,
    )
