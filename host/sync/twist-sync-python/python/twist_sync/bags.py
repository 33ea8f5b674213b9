"""Bags of ROS 1 and 2 and MCAP: messages sensor_msgs/Imu, else poses, with the stamps of their
headers; in MCAP also messages of JSON or protobuf with such fields."""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from . import containers, orientation
from ._recording import Recording, Unreadable
from .tables import Asked
from .tables import read as read_tables

IMU = ("sensor_msgs/msg/Imu", "sensor_msgs/Imu")
#: Messages with an orientation x, y, z, w after a position, and whether a name precedes that.
POSES = {
    f"{package}/{msg}{name}": has_name
    for package, name, has_name in (
        ("geometry_msgs", "PoseStamped", False),
        ("geometry_msgs", "PoseWithCovarianceStamped", False),
        ("geometry_msgs", "TransformStamped", True),
        ("nav_msgs", "Odometry", True),
    )
    for msg in ("", "msg/")
}
HINT = 'bags and MCAP are read by rosbags and mcap: pip install "twist-sync[bags]"'


def stamp(raw: bytes, ros1: bool) -> tuple[str, int, int] | None:
    """Returns byte order, seconds and nanoseconds of a message that begins with a header. Four
    bytes precede them: in CDR the encoding, in ROS 1 the header's sequence number."""
    if len(raw) < 16:
        return None
    order = "<" if ros1 or raw[1] & 1 else ">"
    seconds, nanos = struct.unpack_from(f"{order}iI", raw, 4)
    return (order, seconds, nanos) if nanos < 10**9 else None


def _of_json(raw: bytes) -> tuple[Any, dict[str, Any], str, str] | None:
    """Returns an object, and within it the one with its stamp, and the names of the stamp's
    parts."""
    try:
        value = json.loads(raw)
        own = value["header"]["stamp"] if "header" in value else value["timestamp"]
        names = [k for k in ("sec", "secs", "nsec", "nsecs", "nanosec") if isinstance(own.get(k), int)]
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
    return (value, own, *names) if len(names) == 2 else None


def stamp_ns(raw: bytes, how: str) -> int | None:
    """Returns the stamp in a message's header, ns; None of encodings without one."""
    if how == "json":
        found = _of_json(raw)
        return found[1][found[2]] * 10**9 + found[1][found[3]] if found else None
    of_ros = stamp(raw, how == "ros1") if how in ("cdr", "ros1") else None
    return of_ros[1] * 10**9 + of_ros[2] if of_ros else None


def stamped(raw: bytes, how: str, ns: int) -> bytes:
    """Returns a message that has a stamp with another one, ns."""
    parts = divmod(ns, 10**9)
    if how == "json" and (found := _of_json(raw)):
        found[1][found[2]], found[1][found[3]] = parts
        return json.dumps(found[0]).encode()
    order = (stamp(raw, how == "ros1") or "<")[0]
    buffer = bytearray(raw)
    struct.pack_into(f"{order}iI", buffer, 4, *parts)
    return bytes(buffer)


def _sample(raw: bytes, ros1: bool, kind: str) -> tuple[float, ...]:
    """Returns time in ns and rates, or the orientation w, x, y, z of a pose."""
    found = stamp(raw, ros1)
    if found is None:
        raise struct.error("no header")
    order, seconds, nanos = found
    at = 16 + struct.unpack_from(f"{order}I", raw, 12)[0]
    if POSES.get(kind):
        at += 0 if ros1 else -at % 4
        at += 4 + struct.unpack_from(f"{order}I", raw, at)[0]
    if not ros1:
        at = 4 + (at - 4 + 7) // 8 * 8
    if kind in POSES:
        x, y, z, w = struct.unpack_from(f"{order}dddd", raw, at + 3 * 8)
        return seconds * 10**9 + nanos, w, x, y, z
    # Orientation with its covariance are 13 numbers.
    return seconds * 10**9 + nanos, *struct.unpack_from(f"{order}ddd", raw, at + 13 * 8)


class _Topics:
    def __init__(self, wanted: str | None):
        self.wanted = wanted
        self.samples: dict[str, list[tuple[float, ...]]] = {}
        self.poses: dict[str, list[tuple[float, ...]]] = {}
        self.others: set[str] = set()
        self.broken = 0

    def add(self, topic: str, kind: str, raw: bytes, ros1: bool) -> None:
        if kind not in IMU and kind not in POSES:
            self.others.add(topic)
            return
        samples = (self.samples if kind in IMU else self.poses).setdefault(topic, [])
        if self.wanted in (None, topic):
            try:
                samples.append(_sample(raw, ros1, kind))
            except struct.error:
                self.broken += 1

    def chosen(self, path: Path, form: str, notes: list[str]) -> Recording:
        if self.wanted in self.poses or not self.samples:
            self.others |= set(self.samples)
            self.samples = self.poses
        if self.wanted is None and len(self.samples) > 1:
            raise Unreadable(
                f"several gyroscopes: {', '.join(self.samples)}: name one, as {path.name}@/TOPIC"
            )
        topic = self.wanted or next(iter(self.samples), "")
        if topic not in self.samples:
            there = ", ".join(sorted({*self.samples, *self.poses, *self.others})) or "none"
            raise Unreadable(
                f"{form} without sensor_msgs/Imu on topic {topic or 'any'}; its topics: {there[:300]}"
            )
        if self.broken:
            notes.append(f"{self.broken} messages cannot be decoded")
        table = self.samples[topic]
        times = np.array([row[0] for row in table], dtype=np.int64)
        rates = np.array([row[1:] for row in table]).reshape(len(table), -1)
        if (np.diff(times) < 0).any():
            # A bag is in the order in which messages were received.
            order = np.argsort(times, kind="stable")
            times, rates = times[order], rates[order]
            notes.append("messages are not in the order of their stamps: sorted")
        form = f"{form}: {topic}, times of the messages' headers, rates "
        if rates.shape[1] == 4:
            good = np.linalg.norm(rates, axis=1) > 0.5
            times, rates, more = orientation.rates(times[good], rates[good])
            notes += more
            form += "of the poses' orientations "
        return Recording(path, form + "in rad/s", times, rates, notes=notes, topic=topic)


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


def decoder(schema: Any, encoding: str) -> Any:
    """Returns a function from bytes to an object of JSON, of messages of JSON or protobuf."""
    if encoding == "json":
        return json.loads
    try:
        from google.protobuf.json_format import MessageToDict
        from mcap_protobuf.decoder import DecoderFactory
    except ImportError:
        raise containers.missing("protobuf", "mcap-protobuf-support", "MCAP of protobuf") from None
    decode = DecoderFactory().decoder_for("protobuf", schema)
    return decode and (
        lambda raw: MessageToDict(
            decode(raw), preserving_proto_field_name=True, always_print_fields_with_no_presence=True
        )
    )


def _mcap(path: Path, asked: Asked) -> Recording:
    from mcap.reader import SeekingReader

    notes: list[str] = []
    found = _Topics(asked.topic)
    wanted = None
    with path.open("rb") as file:
        try:
            summary = SeekingReader(file).get_summary()
        except Exception:  # Read without it.
            summary = None
    if summary is not None:
        kinds = {k: s.name for k, s in summary.schemas.items()}
        for channel in summary.channels.values():
            if channel.message_encoding in ("cdr", "ros1"):
                found.add(channel.topic, kinds.get(channel.schema_id, ""), b"", False)
        found.broken = 0
        wanted = list(found.samples) or None
    records: dict[tuple[str, str], list[dict[str, Any]]] = {}
    decoders: dict[int, Any] = {}
    for schema, channel, message in mcap_messages(path, notes, wanted):
        kind = schema.name if schema else ""
        if channel.message_encoding in ("cdr", "ros1"):
            found.add(channel.topic, kind, message.data, channel.message_encoding == "ros1")
            continue
        found.others.add(channel.topic)
        if channel.message_encoding in ("json", "protobuf"):
            if channel.id not in decoders:
                decoders[channel.id] = decoder(schema, channel.message_encoding)
            if one := decoders[channel.id](message.data):
                one["log time ns"] = message.log_time
                records.setdefault((channel.topic, channel.message_encoding), []).append(one)
    if found.samples or found.poses or not records:
        return found.chosen(path, "MCAP", notes)
    tables = [t for (topic, _), own in records.items() for t in containers.of_records(topic, own)]
    encodings = ", ".join(sorted({encoding for _, encoding in records}))
    try:
        out = read_tables(tables, path, f"MCAP of {encodings}", asked, notes)
    except Unreadable as error:
        topics = ", ".join(topic for topic, _ in records)
        raise Unreadable(f"MCAP of {encodings} on {topics}: {error}") from None
    # Only stamps of JSON can be written.
    topics = [topic for topic, how in records if how == "json" and (out.topic or "").startswith(topic)]
    out.topic, out.layout = (topics or [None])[0], None
    return out


def reader(path: Path) -> Any:
    """Returns a reader of rosbags for a ROS 1 bag or the folder of a ROS 2 bag."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if path.suffix == ".db3":
        path = path.parent
    is_folder = path.is_dir()
    if not is_folder and path.suffix != ".bag":
        raise Unreadable("a ROS 1 bag whose name does not end in .bag: rename it")
    # For bags that do not describe their messages.
    store = get_typestore(Stores.ROS2_HUMBLE if is_folder else Stores.ROS1_NOETIC)
    return AnyReader([path], default_typestore=store)


def db3(path: Path) -> sqlite3.Connection:
    """Opens the storage of a ROS 2 bag without its metadata."""
    return sqlite3.connect(f"file:{path.absolute().as_posix()}?mode=ro", uri=True)


def _db3(path: Path, topic: str | None) -> Recording:
    found = _Topics(topic)
    notes = ["without its metadata.yaml"]
    query = "SELECT t.name, t.type, m.data FROM messages m JOIN topics t ON m.topic_id = t.id ORDER BY m.id"
    try:
        for name, kind, raw in db3(path).execute(query):
            found.add(name, kind, raw, False)
    except sqlite3.Error as error:
        if not found.samples:
            raise Unreadable(f"no bag of ROS 2 in sqlite3: {error}") from None
        notes.append(f"cannot be read to its end: {error}")
    return found.chosen(path, "ROS 2 bag", notes)


def is_bare(path: Path) -> bool:
    """Returns True for the storage of a ROS 2 bag whose metadata.yaml is missing."""
    return path.suffix == ".db3" and not (path.parent / "metadata.yaml").is_file()


def _bag(path: Path, topic: str | None) -> Recording:
    if is_bare(path):
        return _db3(path, topic)
    found = _Topics(topic)
    notes: list[str] = []
    with reader(path) as bag:
        for connection in bag.connections:
            found.add(connection.topic, connection.msgtype, b"", False)
        found.broken = 0
        kinds = IMU if found.samples and topic not in found.poses else tuple(POSES)
        wanted = [c for c in bag.connections if c.msgtype in kinds and topic in (None, c.topic)]
        if len({c.topic for c in wanted}) == 1:
            try:
                for connection, _, raw in bag.messages(connections=wanted):
                    found.add(connection.topic, connection.msgtype, raw, not bag.is2)
            except Exception as error:  # The library has no common class of its errors.
                if not found.samples:
                    raise
                notes.append(f"cannot be read to its end: {type(error).__name__} {error}"[:200])
        return found.chosen(path, "ROS 2 bag" if bag.is2 else "ROS 1 bag", notes)


def read(path: Path, asked: Asked) -> Recording:
    """Reads a bag or an MCAP file."""
    try:
        is_mcap = path.is_file() and path.open("rb").read(5) == b"\x89MCAP"
        return _mcap(path, asked) if is_mcap else _bag(path, asked.topic)
    except ImportError:
        raise Unreadable(HINT) from None
