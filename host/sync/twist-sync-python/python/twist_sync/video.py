"""Videos of action cameras, by the package telemetry-parser of the authors of Gyroflow,
<https://github.com/AdrianEddy/telemetry-parser>, and the times of their frames.

Rates are in degrees a second, by the package's README, axes those of the camera. Times count from
the first frame, as far as the package knows.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from . import orientation
from ._recording import Recording, Unreadable

HINT = (
    'videos are read by telemetry-parser: pip install "twist-sync[video]" '
    "(its wheels end with Python 3.12)"
)
_LARGEST_INDEX = 1 << 28


def _orientations(parser: Any) -> Iterator[tuple[float, dict[str, float]]]:
    for sample in parser.telemetry():
        for data in sample.get("Quaternion", {}).get("Data", []):
            yield data["t"], data["v"]


def read(path: Path) -> Recording:
    """Reads the gyroscope, or the orientation, and the times of the frames."""
    try:
        from telemetry_parser import Parser
    except ImportError:
        raise Unreadable(HINT) from None
    parser = Parser(str(path))
    form = f"{parser.camera} ({parser.model or 'no model'}) by telemetry-parser"
    rows = [(s["timestamp_ms"], *s["gyro"]) for s in parser.normalized_imu() if s["gyro"]]
    is_oriented = not rows
    if is_oriented:
        # Videos of DJI have no gyroscope, <https://github.com/gyroflow/gyroflow/issues/1139>.
        form += ", rates of its orientation"
        rows = [(t, *(q[k] for k in "wxyz")) for t, q in _orientations(parser)]
    if not rows:
        raise Unreadable(f"{form}: neither a gyroscope nor an orientation in it")
    table = np.array(rows, dtype=float)
    times, rates, notes = np.round(table[:, 0] * 1e6).astype(np.int64), table[:, 1:], []
    if is_oriented:
        times, rates, notes = orientation.rates(times, rates)
    with path.open("rb") as file:
        frames = mp4_frames(file)
    return Recording(
        path,
        f"{form}, times from the first frame in ms, rates in {'rad/s' if is_oriented else 'deg/s'}",
        times,
        rates if is_oriented else np.radians(rates),
        {"frames": frames} if len(frames) else {},
        notes,
    )


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        if size < 8 or at + size > len(data):
            return
        yield data[at + 4 : at + 8], data[at + 8 : at + size]
        at += size


def _inside(data: bytes, *names: bytes) -> bytes:
    for name in names:
        data = next((body for kind, body in _boxes(data) if kind == name), b"")
    return data


def mp4_frames(file: BinaryIO) -> np.ndarray:
    """Returns the display times of the frames of the first video track, ns from the beginning of
    the video, in order, from the tables of ISO/IEC 14496-12; empty without those."""
    none = np.zeros(0, dtype=np.int64)
    while head := file.read(8):
        size, kind = int.from_bytes(head[:4], "big"), head[4:]
        if size == 1:
            size = int.from_bytes(file.read(8), "big") - 8
        if kind == b"moov" or size < 8:
            break
        file.seek(size - 8, 1)
    else:
        return none
    if kind != b"moov" or size > _LARGEST_INDEX:
        return none
    for kind, track in _boxes(file.read(size - 8)):
        if kind != b"trak" or _inside(track, b"mdia", b"hdlr")[8:12] != b"vide":
            continue
        header = _inside(track, b"mdia", b"mdhd")
        at = 20 if header[:1] == b"\1" else 12
        scale = int.from_bytes(header[at : at + 4], "big")
        table = _inside(track, b"mdia", b"minf", b"stbl")
        steps = _pairs(_inside(table, b"stts"))
        later = _pairs(_inside(table, b"ctts")).astype(np.int32)
        edits = _inside(track, b"edts", b"elst")
        first = int.from_bytes(edits[12:16], "big", signed=True) if edits[:1] == b"\0" else 0
        ends = np.cumsum(np.repeat(steps[:, 1].astype(np.int64), steps[:, 0]))
        times = np.concatenate([[0], ends[:-1]]) if len(ends) else none
        if len(later) and later[:, 0].sum() == len(times):
            times = times + np.repeat(later[:, 1], later[:, 0])
        return np.sort(times - max(first, 0)) * 10**9 // max(scale, 1)
    return none


def _pairs(table: bytes) -> np.ndarray:
    words = (
        np.frombuffer(table[8 : 8 + (len(table) - 8) // 8 * 8], ">u4") if len(table) >= 8 else []
    )
    return np.array(words, dtype=np.uint32).reshape(-1, 2)
