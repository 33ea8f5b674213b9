"""Writes recordings again, with their times on the clock of the first one."""

from __future__ import annotations

import csv
import re
import shutil
import sqlite3
import zipfile
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from . import bags, files, text
from ._recording import Recording, Unreadable
from .network import DeviceClock, Synchronized
from .tables import exact, moment, scale_of

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
        name = (
            recording.name if names.count(recording.name) == 1 else f"{number + 1}_{recording.name}"
        )
        clock = solved.clock(number)
        out = folder / name
        if out.exists():
            raise Unreadable(f"{out} is there already: nothing is overwritten")
        if number and (note := _again(recording, clock, out)):
            said.append(note)
        for track, times in recording.frames.items():
            table = out.with_name(f"{name}_{re.sub(r'[^A-Za-z0-9]+', '_', track)}.csv")
            _list(table, clock, times)
            said.append(f"{table}: times of {len(times)} frames on the first clock")
    return said


def _again(recording: Recording, clock: DeviceClock, out: Path) -> str:
    if recording.layout is not None:
        with out.open("x", encoding="utf-8", errors="surrogateescape", newline="") as file:
            return f"{out}: {_text(recording, clock, file)}"
    how = files.kind(recording.path)
    if how == "bag" or (how == "mcap" and recording.topic):
        return f"{out}: {_bag(recording, clock, out, how)}"
    if how == "npz":
        with np.load(recording.path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        times = arrays[recording.topic]
        if len(times) == len(recording.t):
            kind = "M8[ns]" if times.dtype.kind == "M" else np.int64
            arrays[recording.topic] = clock.b_to_a(recording.t).astype(kind)
            # Not by numpy.savez: an array may have the name of one of its arguments.
            with zipfile.ZipFile(out, "x") as archive:
                for name, array in arrays.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                        np.lib.format.write_array(file, array, allow_pickle=False)
            return f"{out}: times of {recording.topic!r} in ns"
    table = out.with_name(f"{out.name}_gyro.csv")
    _list(table, clock, recording.t, recording.w)
    return f"{table}: {len(recording.t)} samples"


def _list(
    path: Path, clock: DeviceClock, times: np.ndarray, rates: np.ndarray | None = None
) -> None:
    first = clock.b_to_a(times)
    sigma = np.round(clock.offset(first)[1] * 1e9).astype(np.int64)
    with path.open("x", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["time_ns", "own_ns", "sigma_ns", *(["x", "y", "z"] if rates is not None else [])]
        )
        columns = [first, times, sigma, *(rates.T if rates is not None else [])]
        table.writerows(zip(*(column.tolist() for column in columns), strict=True))


def _decimal(nanos: int, unit: str) -> str:
    """Returns nanoseconds as a decimal number of a unit, exactly where it is a power of ten."""
    value = f"{Decimal(nanos) / scale_of(unit):f}"
    return value.rstrip("0").rstrip(".") if "." in value else value


def _text(recording: Recording, clock: DeviceClock, out: Any) -> str:
    """Writes each line with its time exchanged; those of other clocks as they are."""
    layout = recording.layout
    columns, unit, dialect = layout["columns"], layout["unit"], text.Dialect(*layout["dialect"])
    numbers, times = [], []
    with text.open_text(recording.path) as file:
        for number, line in enumerate(file, 1):
            fields = dialect.split(line.strip("\r\n"))
            if number < layout["first"] or len(fields) <= max(columns) or not dialect.is_row(fields):
                continue
            try:
                time = sum(
                    moment(fields[k]) if layout["moment"] else exact(fields[k], dialect, scale_of(u))
                    for k, u in zip(columns, [unit] if len(columns) < 2 else ["s", unit], strict=True)
                )
            except ValueError:
                continue
            time += sum(more for line_number, more in layout["added"] if number >= line_number)
            if recording.t[0] - _NEAR < time < recording.t[-1] + _NEAR:
                numbers.append(number)
                times.append(time)
    moved = dict(zip(numbers, clock.b_to_a(np.array(times, dtype=np.int64)).tolist(), strict=True))
    table = csv.writer(out, delimiter=dialect.delimiter or " ", lineterminator="")
    with text.open_text(recording.path) as file:
        for number, line in enumerate(file, 1):
            nanos = moved.get(number)
            if nanos is None:
                out.write(line)
                continue
            fields = dialect.split(line.strip("\r\n"))
            if layout["moment"]:
                fields[columns[0]] = f"{np.datetime64(nanos, 'ns')}Z"
            elif len(columns) > 1:
                whole, part = divmod(nanos, 10**9)
                fields[columns[0]], fields[columns[1]] = str(whole), _decimal(part, unit)
            else:
                time = _decimal(nanos, unit)
                fields[columns[0]] = time.replace(".", dialect.decimal)
            table.writerow(fields)
            out.write("\r\n" if line.endswith("\r\n") else "\n")
    return f"{len(moved)} rows"


Each = Callable[[], Iterator[tuple[Any, int, bytes, str]]]


def _bag(recording: Recording, clock: DeviceClock, out: Path, how: str) -> str:
    if how == "mcap":
        return _mcap(recording, clock, out)
    return (_bare if bags.is_bare(recording.path) else _rosbag)(recording, clock, out)


def _moved(
    recording: Recording, clock: DeviceClock, each: Each, put: Callable[[Any, int, bytes], None]
) -> str:
    """Puts each message (its channel, log time, bytes, encoding if a header leads) with log time
    and header's stamp on the first clock."""
    no = np.iinfo(np.int64).min
    logs, stamps, own = [], [], []
    for channel, log, raw, how in each():
        found = bags.stamp_ns(raw, how)
        logs.append(log)
        stamps.append(no if found is None else found)
        own.append(channel.topic == recording.topic)
    log, stamp, of_gyro = np.array(logs), np.array(stamps), np.array(own)
    apart = int(np.median((log - stamp)[of_gyro & (stamp != no)]))
    shift = apart if abs(apart) > _ANOTHER_CLOCK else 0
    log = clock.b_to_a(log - shift)
    near = (stamp > recording.t.min() - _NEAR) & (stamp < recording.t.max() + _NEAR)
    stamp = np.where(near, clock.b_to_a(np.where(near, stamp, recording.t[0])), no)
    if log.min() < 0 or stamp[near].min(initial=0) < 0:
        raise Unreadable(
            f"{recording.path}: times before the first clock's zero cannot be in a bag; put it first"
        )
    for number, (channel, _, raw, how) in enumerate(each()):
        if near[number]:
            raw = bags.stamped(raw, how, int(stamp[number]))
        put(channel, int(log[number]), raw)
    kept = int(((np.array(stamps) != no) & ~near).sum())
    return (
        f"{len(log)} messages, {near.sum()} stamps of headers"
        + (
            f", log times first moved by {-shift * 1e-9:.6f} s onto the gyroscope's clock"
            if shift
            else ""
        )
        + (f"; {kept} stamps of another clock are left as they are" if kept else "")
    )


def _leads_with_header(definition: str) -> bool:
    lines = (line.split("#")[0].strip() for line in definition.splitlines())
    first = next((line for line in lines if line and "=" not in line), "")
    return re.match(r"(std_msgs/)?(msg/)?Header\s", first) is not None


def _mcap(recording: Recording, clock: DeviceClock, out: Path) -> str:
    from mcap.reader import make_reader
    from mcap.writer import Writer

    def each() -> Iterator[tuple[Any, int, bytes, str]]:
        for schema, channel, message in bags.mcap_messages(recording.path, []):
            how = channel.message_encoding
            if how in ("cdr", "ros1") and not (
                schema is not None and _leads_with_header(schema.data.decode(errors="replace"))
            ):
                how = ""
            channel.of_message = (schema, message)
            yield channel, message.log_time, message.data, how

    with out.open("xb") as file, recording.path.open("rb") as source:
        writer = Writer(file)
        reader = make_reader(source)
        writer.start(profile=reader.get_header().profile, library=f"twist-sync")
        ids: dict[int, int] = {}
        schemas: dict[int, int] = {0: 0}

        def put(channel: Any, log: int, raw: bytes) -> None:
            schema, message = channel.of_message
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in ids:
                ids[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[channel.schema_id],
                    channel.metadata,
                )
            writer.add_message(ids[channel.id], log, raw, log, message.sequence)

        said = _moved(recording, clock, each, put)
        try:
            for one in reader.iter_attachments():
                writer.add_attachment(
                    one.create_time, one.log_time, one.name, one.media_type, one.data
                )
            for data in reader.iter_metadata():
                writer.add_metadata(data.name, data.metadata)
        except Exception as error:  # Of a file without an index.
            said += f"; without what it has attached ({type(error).__name__})"
        writer.finish()
    return said


def _has_header(definitions: Any, kind: str) -> bool:
    parts = definitions.get(kind, ([], []))[1]
    return bool(parts) and parts[0][1][1] == "std_msgs/msg/Header"


def _bare(recording: Recording, clock: DeviceClock, out: Path) -> str:
    """Copies the storage of a ROS 2 bag and changes its messages."""
    from rosbags.typesys import Stores, get_typestore

    definitions = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    query = "SELECT t.name, t.type, m.timestamp, m.data, m.id FROM messages m JOIN topics t ON m.topic_id = t.id"

    def each() -> Iterator[tuple[Any, int, bytes, str]]:
        for name, kind, log, raw, number in bags.db3(recording.path).execute(query):
            channel = SimpleNamespace(topic=name, number=number)
            yield channel, log, raw, "cdr" if _has_header(definitions, kind) else ""

    shutil.copyfile(recording.path, out)
    with sqlite3.connect(out) as copy:
        change = "UPDATE messages SET timestamp = ?, data = ? WHERE id = ?"
        return _moved(recording, clock, each, lambda c, log, raw: copy.execute(change, (log, raw, c.number)))


def _rosbag(recording: Recording, clock: DeviceClock, out: Path) -> str:
    from rosbags import rosbag1, rosbag2

    with bags.reader(recording.path) as bag:
        definitions = bag.typestore.fielddefs

        def each() -> Iterator[tuple[Any, int, bytes, str]]:
            for connection, log, raw in bag.messages():
                leads = _has_header(definitions, connection.msgtype)
                yield connection, log, raw, ("cdr" if bag.is2 else "ros1") if leads else ""

        if bag.is2:
            is_mcap = any(recording.path.glob("*.mcap"))
            storage = rosbag2.StoragePlugin.MCAP if is_mcap else rosbag2.StoragePlugin.SQLITE3
            writer: Any = rosbag2.Writer(out, version=9, storage_plugin=storage)
        else:
            writer = rosbag1.Writer(out)
        with writer:
            added: dict[int, Any] = {}

            def put(connection: Any, log: int, raw: bytes) -> None:
                if connection.id not in added:
                    added[connection.id] = writer.add_connection(
                        connection.topic, connection.msgtype, typestore=bag.typestore
                    )
                writer.write(added[connection.id], log, raw)

            return _moved(recording, clock, each, put)
