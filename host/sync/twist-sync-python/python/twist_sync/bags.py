"""Bags of ROS 1 and 2 and MCAP: messages sensor_msgs/Imu, with the stamps of their headers."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ._recording import Recording, Unreadable

IMU = ("sensor_msgs/msg/Imu", "sensor_msgs/Imu")
HINT = 'bags and MCAP are read by rosbags and mcap: pip install "twist-sync[bags]"'


def stamp(raw: bytes, ros1: bool) -> tuple[str, int, int] | None:
    """Returns byte order, seconds and nanoseconds of a message that begins with a header. Four
    bytes precede them: in CDR the encoding, in ROS 1 the header's sequence number."""
    if len(raw) < 16:
        return None
    order = "<" if ros1 or raw[1] & 1 else ">"
    seconds, nanos = struct.unpack_from(f"{order}iI", raw, 4)
    return (order, seconds, nanos) if nanos < 10**9 else None


def _sample(raw: bytes, ros1: bool) -> tuple[int, float, float, float]:
    found = stamp(raw, ros1)
    if found is None:
        raise struct.error("no header")
    order, seconds, nanos = found
    at = 16 + struct.unpack_from(f"{order}I", raw, 12)[0]
    if not ros1:
        at = 4 + (at - 4 + 7) // 8 * 8
    # Orientation with its covariance are 13 numbers.
    x, y, z = struct.unpack_from(f"{order}ddd", raw, at + 13 * 8)
    return seconds * 10**9 + nanos, x, y, z


class _Topics:
    def __init__(self, wanted: str | None):
        self.wanted = wanted
        self.samples: dict[str, list[tuple[int, float, float, float]]] = {}
        self.others: set[str] = set()
        self.broken = 0

    def add(self, topic: str, kind: str, raw: bytes, ros1: bool) -> None:
        if kind not in IMU:
            self.others.add(topic)
            return
        samples = self.samples.setdefault(topic, [])
        if self.wanted in (None, topic):
            try:
                samples.append(_sample(raw, ros1))
            except struct.error:
                self.broken += 1

    def chosen(self, path: Path, form: str, notes: list[str]) -> Recording:
        if self.wanted is None and len(self.samples) > 1:
            raise Unreadable(
                f"several gyroscopes: {', '.join(self.samples)}: name one, as {path.name}@/TOPIC"
            )
        topic = self.wanted or next(iter(self.samples), "")
        if topic not in self.samples:
            there = ", ".join(sorted({*self.samples, *self.others})) or "none"
            raise Unreadable(
                f"{form} without sensor_msgs/Imu on topic {topic or 'any'}; its topics: {there[:300]}"
            )
        if self.broken:
            notes.append(f"{self.broken} messages cannot be decoded")
        table = self.samples[topic]
        times = np.array([row[0] for row in table], dtype=np.int64)
        rates = np.array([row[1:] for row in table]).reshape(-1, 3)
        if (np.diff(times) < 0).any():
            # A bag is in the order in which messages were received.
            order = np.argsort(times, kind="stable")
            times, rates = times[order], rates[order]
            notes.append("messages are not in the order of their stamps: sorted")
        form = f"{form}: {topic}, times of the messages' headers, rates in rad/s"
        return Recording(path, form, times, rates, notes=notes, topic=topic)


def mcap_messages(path: Path, notes: list[str], topics: list[str] | None = None) -> Iterator[Any]:
    """Yields schema, channel and message, in the order of the file if it has no index."""
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader, SeekingReader

    with path.open("rb") as file:
        reader: Any = SeekingReader(file)
        try:
            summary = reader.get_summary()
        except (McapError, ValueError, struct.error):
            summary = None
        if summary is None or not summary.chunk_indexes:
            notes.append("it has no index: read from its beginning to where it can be read")
            file.seek(0)
            reader = NonSeekingReader(file)
        try:
            yield from reader.iter_messages(topics=topics, log_time_order=False)
        except (McapError, ValueError, struct.error, EOFError) as error:
            notes.append(f"cannot be read to its end: {type(error).__name__} {error}"[:200])


def _mcap(path: Path, topic: str | None) -> Recording:
    from mcap.reader import SeekingReader

    notes: list[str] = []
    found = _Topics(topic)
    wanted = None
    with path.open("rb") as file:
        try:
            summary = SeekingReader(file).get_summary()
        except Exception:  # Read without it.
            summary = None
    if summary is not None:
        kinds = {k: s.name for k, s in summary.schemas.items()}
        for channel in summary.channels.values():
            found.add(channel.topic, kinds.get(channel.schema_id, ""), b"", False)
        found.broken = 0
        wanted = list(found.samples) or None
    for schema, channel, message in mcap_messages(path, notes, wanted):
        kind = schema.name if schema else ""
        if channel.message_encoding in ("cdr", "ros1"):
            found.add(channel.topic, kind, message.data, channel.message_encoding == "ros1")
        else:
            found.others.add(channel.topic)
    return found.chosen(path, "MCAP", notes)


def reader(path: Path) -> Any:
    """Returns a reader of rosbags for a ROS 1 bag or the folder of a ROS 2 bag."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if path.suffix == ".db3":
        if not (path.parent / "metadata.yaml").is_file():
            raise Unreadable(
                "a ROS 2 bag in sqlite3 without its metadata.yaml: run `ros2 bag reindex` on its folder"
            )
        path = path.parent
    is_folder = path.is_dir()
    if not is_folder and path.suffix != ".bag":
        raise Unreadable("a ROS 1 bag whose name does not end in .bag: rename it")
    # For bags that do not describe their messages.
    store = get_typestore(Stores.ROS2_HUMBLE if is_folder else Stores.ROS1_NOETIC)
    return AnyReader([path], default_typestore=store)


def _bag(path: Path, topic: str | None) -> Recording:
    found = _Topics(topic)
    notes: list[str] = []
    with reader(path) as bag:
        for connection in bag.connections:
            found.samples.setdefault(
                connection.topic, []
            ) if connection.msgtype in IMU else found.others.add(connection.topic)
        wanted = [c for c in bag.connections if c.msgtype in IMU and topic in (None, c.topic)]
        if len({c.topic for c in wanted}) == 1:
            try:
                for connection, _, raw in bag.messages(connections=wanted):
                    found.add(connection.topic, connection.msgtype, raw, not bag.is2)
            except Exception as error:  # The library has no common class of its errors.
                if not found.samples:
                    raise
                notes.append(f"cannot be read to its end: {type(error).__name__} {error}"[:200])
        return found.chosen(path, "ROS 2 bag" if bag.is2 else "ROS 1 bag", notes)


def read(path: Path, topic: str | None) -> Recording:
    """Reads a bag or an MCAP file."""
    try:
        is_mcap = path.is_file() and path.open("rb").read(5) == b"\x89MCAP"
        return _mcap(path, topic) if is_mcap else _bag(path, topic)
    except ImportError:
        raise Unreadable(HINT) from None
