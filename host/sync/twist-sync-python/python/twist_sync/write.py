"""Writes recordings again, with their times on the clock of the first one."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sqlite3
import struct
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from . import bags, files, text
from ._recording import Recording, Unreadable
from .network import DeviceClock, Synchronized
from .times import exact, moment, scale_of

#: Distance from the stamps beyond which a log's times are of another clock, ns.
_ANOTHER_CLOCK = 60 * 10**9
#: Distance from the gyroscope's samples within which stamps of other topics are of its clock, ns.
_NEAR = 600 * 10**9


def write(folder: Path, solved: Synchronized) -> list[str]:
    """Writes each recording but the first, and lists of the frames of all, into a folder.

    Returns:
        A line about each file.

    Raises:
        Unreadable: A file cannot be written again.
        OSError: Nor can it be read or written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    said = []
    names = [r.name for r in solved.recordings]
    for number, recording in enumerate(solved.recordings):
        name = recording.name if names.count(recording.name) == 1 else f"{number + 1}_{recording.name}"
        clock, out = solved.clock(number), folder / name
        if out.exists():
            raise Unreadable(f"{out} is there already: nothing is overwritten")
        if number:
            said.append(again(recording, clock, out))
        for track, times in recording.frames.items():
            table = out.with_name(f"{name}_{re.sub(r'[^A-Za-z0-9]+', '_', track)}.csv")
            _list(table, clock, times)
            said.append(f"{table}: times of {len(times)} frames on the first clock")
    return said


def again(recording: Recording, clock: Any, out: Path) -> str:
    """Writes a recording again, and returns a line about it."""
    with tempfile.TemporaryDirectory() as folder:
        source, how, inner = recording.path, files.kind(recording.path), out
        if how in (*files.PACKED, "zip") and recording.member:
            source, _ = files.unpacked(recording.path, how, recording.member, Path(folder) / "from")
            inner, packed, how = Path(folder) / source.name, how, files.kind(source)
            said = _copy(recording, clock, source, how, inner)
            if said:
                _packed(recording, inner, out, packed)
                return f"{out}: {said}"
        elif said := _copy(recording, clock, source, how, out):
            return f"{out}: {said}"
    table = out.with_name(f"{out.name}_gyro.csv")
    _list(table, clock, recording.t, recording.w)
    return f"{table}: {len(recording.t)} samples"


def _copy(recording: Recording, clock: Any, source: Path, how: str, out: Path) -> str:
    """Writes a file of a kind again; returns what was written, or nothing for other kinds."""
    if how == "text" and recording.layout is not None:
        with out.open("x", encoding="utf-8", errors="surrogateescape", newline="") as file:
            return _text(recording, clock, source, file)
    if how == "bag" or (how == "mcap" and recording.topic):
        return _bag(recording, clock, source, out)
    if how == "npz" and recording.topic:
        with np.load(source, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        times = arrays.get(recording.topic)
        if times is not None and len(times) == len(recording.t):
            kind = "M8[ns]" if times.dtype.kind == "M" else np.int64
            arrays[recording.topic] = clock.b_to_a(recording.t).astype(kind)
            # Not by numpy.savez: an array may have the name of one of its arguments.
            with zipfile.ZipFile(out, "x") as archive:
                for name, array in arrays.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                        np.lib.format.write_array(member, array, allow_pickle=False)
            return f"times of {recording.topic!r} in ns"
    return ""


def _packed(recording: Recording, inner: Path, out: Path, how: str) -> None:
    """Packs a file as it was, in an archive with all others that it held."""
    if how in files.PACKED:
        with inner.open("rb") as source, files.PACKED[how](out, "xb") as file:
            shutil.copyfileobj(source, file)
        return
    with zipfile.ZipFile(recording.path) as source, zipfile.ZipFile(out, "x", zipfile.ZIP_DEFLATED) as file:
        for one in source.infolist():
            file.writestr(one, inner.read_bytes() if one.filename == recording.member else source.read(one))


def _list(path: Path, clock: DeviceClock, times: np.ndarray, rates: np.ndarray | None = None) -> None:
    first = clock.b_to_a(times)
    sigma = np.round(clock.offset(first)[1] * 1e9).astype(np.int64)
    values = [] if rates is None else list(rates.T)
    with path.open("x", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_ns", "own_ns", "sigma_ns", *(f"gyro_{k}_rad_s" for k in "xyz"[: len(values)])])
        table.writerows(zip(*(column.tolist() for column in (first, times, sigma, *values)), strict=True))


def _decimal(nanos: int, unit: str) -> str:
    """Returns nanoseconds as a decimal number of a unit, exactly where it is a power of ten."""
    value = f"{Decimal(nanos) / scale_of(unit):f}"
    return value.rstrip("0").rstrip(".") if "." in value else value


def _text(recording: Recording, clock: DeviceClock, source: Path, out: Any) -> str:
    """Writes each line with its time exchanged; those of other clocks as they are."""
    layout = recording.layout
    columns, unit, dialect = layout["columns"], layout["unit"], text.Dialect(*layout["dialect"])

    def own_ns(number: int, line: str) -> int | None:
        fields = dialect.split(line)
        if number < layout["first"] or len(fields) <= max(columns) or not dialect.is_row(fields):
            return None
        units = zip(columns, [unit] if len(columns) < 2 else ["s", unit], strict=True)
        try:
            one = [moment(fields[k]) if layout["moment"] else exact(fields[k], dialect, scale_of(u)) for k, u in units]
        except ValueError:
            return None
        time = sum(one) + sum(more for first, more in layout["added"] if number >= first)
        return time if recording.t[0] - _NEAR < time < recording.t[-1] + _NEAR else None

    with text.open_text(source) as file:
        found = {number: own_ns(number, line) for number, line in enumerate(file, 1)}
    times = {number: time for number, time in found.items() if time is not None}
    moved = dict(zip(times, clock.b_to_a(np.array([*times.values()], dtype=np.int64)).tolist(), strict=True))
    table = csv.writer(out, delimiter=dialect.delimiter or " ", lineterminator="")
    with text.open_text(source) as file:
        for number, line in enumerate(file, 1):
            if (nanos := moved.get(number)) is None:
                out.write(line)
                continue
            fields = dialect.split(line)
            if layout["moment"]:
                fields[columns[0]] = f"{np.datetime64(nanos, 'ns')}Z"
            elif len(columns) > 1:
                whole, part = divmod(nanos, 10**9)
                fields[columns[0]], fields[columns[1]] = str(whole), _decimal(part, unit)
            else:
                fields[columns[0]] = _decimal(nanos, unit).replace(".", dialect.decimal)
            table.writerow(fields)
            out.write("\r\n" if line.endswith("\r\n") else "\n")
    return f"{len(moved)} rows"


# --- Bags --------------------------------------------------------------------------------------


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


def _stamp(channel: bags.Channel, raw: bytes) -> int | None:
    """Returns the stamp in a message's header, ns; None without one."""
    if channel.how == "json":
        found = _of_json(raw)
        return found[1][found[2]] * 10**9 + found[1][found[3]] if found else None
    if not channel.leads or len(raw) < 16:
        return None
    # Four bytes precede it: in CDR the encoding, in ROS 1 the header's sequence number.
    seconds, nanos = struct.unpack_from(f"{_order(channel, raw)}iI", raw, 4)
    return seconds * 10**9 + nanos if nanos < 10**9 else None


def _order(channel: bags.Channel, raw: bytes) -> str:
    return "<" if channel.how == "ros1" or raw[1] & 1 else ">"


def _stamped(channel: bags.Channel, raw: bytes, ns: int) -> bytes:
    """Returns a message that has a stamp with another one, ns."""
    if channel.how == "json" and (found := _of_json(raw)):
        found[1][found[2]], found[1][found[3]] = divmod(ns, 10**9)
        return json.dumps(found[0]).encode()
    buffer = bytearray(raw)
    struct.pack_into(f"{_order(channel, raw)}iI", buffer, 4, *divmod(ns, 10**9))
    return bytes(buffer)


def _bag(recording: Recording, clock: DeviceClock, source: Path, out: Path) -> str:
    """Writes each message with log time and header's stamp on the first clock."""
    no = np.iinfo(np.int64).min
    logs, stamps, own = [], [], []
    for channel, log, raw in bags.Bag(source).messages():
        found = _stamp(channel, raw)
        logs.append(log)
        stamps.append(no if found is None else found)
        own.append(channel.topic == recording.topic)
    log, stamp, of_gyro = np.array(logs), np.array(stamps), np.array(own)
    if not (of_gyro & (stamp != no)).any():
        return ""
    apart = int(np.median((log - stamp)[of_gyro & (stamp != no)]))
    shift = apart if abs(apart) > _ANOTHER_CLOCK else 0
    log = clock.b_to_a(log - shift)
    near = (stamp > recording.t.min() - _NEAR) & (stamp < recording.t.max() + _NEAR)
    kept = int(((stamp != no) & ~near).sum())
    stamp = np.where(near, clock.b_to_a(np.where(near, stamp, recording.t[0])), no)
    if log.min() < 0 or stamp[near].min(initial=0) < 0:
        raise Unreadable(f"{recording.path}: times before the first clock's zero cannot be in a bag; put it first")
    bag = bags.Bag(source)
    sink = _mcap if bag.is_mcap else _bare if bag.is_bare else _rosbag
    with sink(bag, out) as put:
        for number, (channel, _, raw) in enumerate(bag.messages()):
            put(channel, int(log[number]), _stamped(channel, raw, int(stamp[number])) if near[number] else raw)
    said = f"{len(log)} messages, {near.sum()} stamps of headers"
    if shift:
        said += f", log times first moved by {-shift * 1e-9:.6f} s onto the gyroscope's clock"
    return said + (f"; {kept} stamps of another clock are left as they are" if kept else "")


@contextmanager
def _mcap(bag: bags.Bag, out: Path) -> Iterator[Any]:
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with out.open("xb") as file, bag.path.open("rb") as source:
        writer, reader = Writer(file), make_reader(source)
        writer.start(profile=reader.get_header().profile, library="twist-sync")
        ids: dict[int, int] = {}
        schemas: dict[int, int] = {0: 0}

        def put(channel: bags.Channel, log: int, raw: bytes) -> None:
            schema, own, message = channel.own
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if own.id not in ids:
                of_schema = schemas[own.schema_id]
                ids[own.id] = writer.register_channel(own.topic, own.message_encoding, of_schema, own.metadata)
            writer.add_message(ids[own.id], log, raw, log, message.sequence)

        yield put
        try:
            for one in reader.iter_attachments():
                writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
            for data in reader.iter_metadata():
                writer.add_metadata(data.name, data.metadata)
        except Exception:  # A file without an index has none that could be found.
            pass
        writer.finish()


@contextmanager
def _bare(bag: bags.Bag, out: Path) -> Iterator[Any]:
    """Copies the storage of a ROS 2 bag and changes its messages."""
    shutil.copyfile(bag.path, out)
    change = "UPDATE messages SET timestamp = ?, data = ? WHERE id = ?"
    with sqlite3.connect(out) as copy:
        yield lambda channel, log, raw: copy.execute(change, (log, raw, channel.own))


@contextmanager
def _rosbag(bag: bags.Bag, out: Path) -> Iterator[Any]:
    from rosbags import rosbag1, rosbag2

    if bag.form == "ROS 1 bag":
        writer: Any = rosbag1.Writer(out)
    else:
        is_mcap = any(bag.path.glob("*.mcap"))
        storage = rosbag2.StoragePlugin.MCAP if is_mcap else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(out, version=9, storage_plugin=storage)
    added: dict[bags.Channel, Any] = {}
    with writer:

        def put(channel: bags.Channel, log: int, raw: bytes) -> None:
            if channel not in added:
                _, store = channel.own
                added[channel] = writer.add_connection(channel.topic, channel.kind, typestore=store)
            writer.write(added[channel], log, raw)

        yield put
