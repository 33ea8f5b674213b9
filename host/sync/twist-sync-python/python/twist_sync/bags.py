"""Bags of ROS 1 and 2 and MCAP: messages with a stamp and an angular velocity or an orientation.

Messages of ROS are decoded by the library rosbags, those of JSON and protobuf as such; which fields
are what is decided in :mod:`twist_sync.tables`, as for columns of a text.
"""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from . import containers, files
from ._recording import Recording, Unreadable
from .columns import Table, groups
from .tables import Asked
from .tables import read as read_tables

HINT = 'bags and MCAP are read by rosbags and mcap: pip install "twist-sync[bags]"'


@dataclass(eq=False)
class Channel:
    """A topic of a bag.

    Attributes:
        topic: Its name.
        kind: The type of its messages.
        how: Their encoding: cdr, ros1, json, protobuf or another.
        own: What the file's library knows of it, and of its latest message.
        leads: True if messages begin with a header that holds their stamp.
        names: Fields of the messages of ROS that are numbers.
        decode: Returns the values of these, or an object of JSON; None for messages that hold no
            motion.
    """

    topic: str
    kind: str
    how: str
    own: Any = None
    leads: bool = False
    names: tuple[str, ...] = ()
    decode: Callable[[bytes], Any] | None = None


Message = tuple[Channel, int, bytes]


def _of_ros(channel: Channel, store: Any) -> Channel:
    """Adds what the definition of a message of ROS says."""

    def leaves(kind: str, path: str = "") -> Iterator[str]:
        for name, (node, inner) in store.fielddefs.get(kind, ([], []))[1]:
            if node.name == "NAME":
                yield from leaves(inner, f"{path}{name}.")
            elif node.name == "BASE" and inner[0] != "string":
                yield path + name

    kind = channel.kind if "/msg/" in channel.kind else channel.kind.replace("/", "/msg/")
    fields = store.fielddefs.get(kind, ([], []))[1]
    channel.leads = bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"
    channel.names = tuple(leaves(kind)) if channel.leads else ()
    motions = groups(Table("", list(channel.names), []))
    if any((g.kind == "rate" or len(g.columns) > 3) and g.kind != "other" for g in motions):
        values = attrgetter(*channel.names)
        parse = store.deserialize_ros1 if channel.how == "ros1" else store.deserialize_cdr
        channel.decode = lambda raw: values(parse(raw, kind))
    return channel


def _store(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


class Bag:
    """A file or folder of messages: its form, what could not be read of it, and its messages in
    the order in which they were received, of all channels or of those with a motion."""

    def __init__(self, path: Path):
        self.path, self.notes = path, []
        self.channels: dict[Any, Channel] = {}
        self.is_mcap = files.kind(path) == "mcap"
        self.is_bare = path.suffix == ".db3" and not (path.parent / "metadata.yaml").is_file()
        if self.is_mcap:
            self.form, self._messages = "MCAP", self._of_mcap
        elif self.is_bare:
            self.form, self._messages = "ROS 2 bag", self._of_db3
            self.notes.append("without its metadata.yaml")
        else:
            if path.is_file() and path.suffix not in (".bag", ".db3"):
                raise Unreadable("a bag of ROS 1 whose name does not end in .bag, or of ROS 2 not in .db3: rename it; or another database")
            self.form = "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag"
            self._messages = self._of_rosbags

    def messages(self, moving: bool = False) -> Iterator[Message]:
        """Yields channel, log time in ns and bytes."""
        count = 0
        try:
            for one in self._messages(moving):
                count += 1
                yield one
        except Unreadable:
            raise
        except Exception as error:  # The libraries have no common class of their errors.
            if not count:
                raise
            self.notes.append(f"cannot be read to its end: {type(error).__name__} {error}"[:200])

    def _of_mcap(self, moving: bool) -> Iterator[Message]:
        from mcap.exceptions import McapError
        from mcap.reader import NonSeekingReader, SeekingReader

        stores: dict[bool, Any] = {}

        def known(schema: Any, channel: Any) -> Channel:
            if channel.id not in self.channels:
                how = channel.message_encoding
                out = Channel(channel.topic, schema.name if schema else "", how)
                if how in ("cdr", "ros1"):
                    is_first = how == "ros1"
                    stores.setdefault(is_first, _store(is_first))
                    _described(stores[is_first], out.kind, schema)
                    _of_ros(out, stores[is_first])
                elif how in ("json", "protobuf"):
                    out.decode = _decoder(schema, how)
                    out.leads = how == "json"
                self.channels[channel.id] = out
            return self.channels[channel.id]

        with self.path.open("rb") as file:
            reader: Any = SeekingReader(file)
            try:
                summary = reader.get_summary()
            except (McapError, ValueError, struct.error):
                summary = None
            topics = None
            if summary is None or not summary.chunk_indexes:
                self.notes.append("it has no index: read from its beginning to where it can be read")
                file.seek(0)
                reader = NonSeekingReader(file)
            elif moving:
                each = [known(summary.schemas.get(c.schema_id), c) for c in summary.channels.values()]
                topics = [channel.topic for channel in each if channel.decode] or None
            for schema, channel, message in reader.iter_messages(topics=topics, log_time_order=False):
                out = known(schema, channel)
                out.own = (schema, channel, message)
                yield out, message.log_time, message.data

    def _of_db3(self, moving: bool) -> Iterator[Message]:
        query = "SELECT t.name, t.type, m.timestamp, m.data, m.id FROM messages m JOIN topics t ON m.topic_id = t.id ORDER BY m.id"
        store = _store(False)
        storage = sqlite3.connect(f"file:{self.path.absolute().as_posix()}?mode=ro", uri=True)
        for name, kind, log, raw, number in storage.execute(query):
            if name not in self.channels:
                self.channels[name] = _of_ros(Channel(name, kind, "cdr"), store)
            self.channels[name].own = number
            yield self.channels[name], log, raw

    def _of_rosbags(self, moving: bool) -> Iterator[Message]:
        from rosbags.highlevel import AnyReader

        path = self.path.parent if self.path.suffix == ".db3" else self.path
        # The types are for bags that do not describe their messages.
        with AnyReader([path], default_typestore=_store(path.suffix == ".bag")) as bag:
            for own in bag.connections:
                channel = Channel(own.topic, own.msgtype, "cdr" if bag.is2 else "ros1", (own, bag.typestore))
                self.channels[own.id, own.topic] = _of_ros(channel, bag.typestore)
            wanted = [c for c in bag.connections if not moving or self.channels[c.id, c.topic].decode]
            for own, log, raw in bag.messages(connections=wanted) if wanted else ():
                yield self.channels[own.id, own.topic], log, raw


def _described(store: Any, kind: str, schema: Any) -> None:
    """Adds a type that the file describes and the library does not know."""
    from rosbags.typesys import get_types_from_msg

    name = kind if "/msg/" in kind else kind.replace("/", "/msg/")
    if schema is not None and name not in store.fielddefs:
        try:
            found = get_types_from_msg(schema.data.decode(errors="replace"), name)
            store.register({k: v for k, v in found.items() if k not in store.fielddefs})
        except Exception:  # Its messages are passed over.
            return


def _decoder(schema: Any, encoding: str) -> Any:
    """Returns a function from bytes to an object of JSON, of messages of JSON or protobuf."""
    if encoding == "json":
        return json.loads
    try:
        from google.protobuf.json_format import MessageToDict
        from mcap_protobuf.decoder import DecoderFactory
    except ImportError:
        raise containers.missing("protobuf", "mcap-protobuf-support", "MCAP of protobuf") from None
    decode = DecoderFactory().decoder_for("protobuf", schema)
    more = {"preserving_proto_field_name": True, "always_print_fields_with_no_presence": True}
    return decode and (lambda raw: MessageToDict(decode(raw), **more))


def _table(channel: Channel, rows: list[Any], notes: list[str]) -> Iterable[Table]:
    """Returns the tables of a channel's decoded messages."""
    if not channel.names:
        return containers.of_records(channel.topic, rows)
    table = np.array(rows, dtype=float)
    stamp = table[:, channel.names.index("header.stamp.sec")] + table[:, channel.names.index("header.stamp.nanosec")] * 1e-9
    if (np.diff(stamp) < 0).any():
        # A bag is in the order in which messages were received.
        table = table[np.argsort(stamp, kind="stable")]
        notes.append("messages are not in the order of their stamps: sorted")
    return [Table(channel.topic, list(channel.names), list(table.T))]


def read(path: Path, asked: Asked) -> Recording:
    """Reads a bag or an MCAP file."""
    try:
        bag = Bag(path)
        rows: dict[str, tuple[Channel, list[Any]]] = {}
        broken = 0
        for channel, log, raw in bag.messages(moving=True):
            if channel.decode is None:
                continue
            try:
                one = channel.decode(raw)
            except Exception:  # Of bytes that no reader expects.
                broken += 1
                continue
            if isinstance(one, dict):
                one["log time ns"] = log
            rows.setdefault(channel.topic, (channel, []))[1].append(one)
    except ImportError:
        raise Unreadable(HINT) from None
    except sqlite3.Error as error:
        raise Unreadable(f"no bag of ROS 2 in sqlite3: {error}") from None
    if broken:
        bag.notes.append(f"{broken} messages cannot be decoded")
    encodings = sorted({channel.how for channel, _ in rows.values() if not channel.names})
    form = f"{bag.form} of {', '.join(encodings)}" if encodings else bag.form
    topics = ", ".join(sorted({f"{channel.topic} ({channel.kind})" for channel in bag.channels.values()}))
    if not rows:
        raise Unreadable(f"{form} without sensor_msgs/Imu or a pose; its topics: {topics[:300] or 'none'}")
    try:
        tables = [table for channel, own in rows.values() for table in _table(channel, own, bag.notes)]
        out = read_tables(tables, path, form, asked, bag.notes)
    except Unreadable as error:
        raise Unreadable(f"{form}: {error}; its topics: {topics[:300]}") from None
    out.topic = next((topic for topic in rows if (out.topic or "").startswith(topic)), None)
    out.layout = None
    return out
