"""Writes recordings again, with their times on the clock of the first one."""

from __future__ import annotations

import csv
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from . import bags, files, text
from ._recording import Recording, Unreadable
from .network import DeviceClock, Synchronized

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
            return f"{out}: {_text(recording, clock, file)} rows"
    how = files.kind(recording.path)
    if how in ("bag", "mcap"):
        return f"{out}: {_bag(recording, clock, out, how)}"
    if how == "npz":
        with np.load(recording.path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        unit = text.TIME_UNITS["ns"] if arrays[recording.topic].dtype.kind == "M" else 1
        arrays[recording.topic] = clock.b_to_a(recording.t).astype(
            "M8[ns]" if unit != 1 else np.int64
        )
        np.savez(out, **arrays)
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
    """Nanoseconds as a decimal number of a unit, exactly."""
    digits = len(str(text.TIME_UNITS[unit])) - 1
    whole, part = divmod(abs(nanos), text.TIME_UNITS[unit])
    return f"{'-' if nanos < 0 else ''}{whole}" + (f".{part:0{digits}}" if digits else "")


def _text(recording: Recording, clock: DeviceClock, out: Any) -> int:
    layout: text.Layout = recording.layout
    times = []
    with text.open_text(recording.path) as file:
        for _, _, fields in text.rows(file, layout):
            if fields:
                try:
                    times.append(text.row_time(fields, layout))
                except ValueError:
                    times.append(0)
    kind = np.int64 if all(isinstance(t, int) for t in times) else np.float64
    moved = iter(
        clock.b_to_a(text.to_nanos(np.array(times, dtype=kind), layout.time_unit or "ns")).tolist()
    )
    table = csv.writer(out, delimiter=layout.delimiter or " ", lineterminator="")
    with text.open_text(recording.path) as file:
        for _, line, fields in text.rows(file, layout):
            if not fields:
                # A cut line has no time.
                out.write(line if fields is None else "")
                continue
            nanos = next(moved)
            column = layout.columns[0]
            if fields[column] and layout.is_iso:
                fields[column] = f"{np.datetime64(nanos, 'ns')}Z"
            elif fields[column] and len(layout.columns) > 4:
                fields[column], fields[layout.columns[4]] = map(str, divmod(nanos, 10**9))
            elif fields[column]:
                time = _decimal(nanos, layout.time_unit or "ns")
                fields[column] = time.replace(".", ",") if layout.decimal_comma else time
            table.writerow(fields)
            out.write("\r\n" if line.endswith("\r\n") else "\n")
    return len(times)


Each = Callable[[], Iterator[tuple[Any, int, bytes, bool, bool]]]


def _bag(recording: Recording, clock: DeviceClock, out: Path, how: str) -> str:
    return _mcap(recording, clock, out) if how == "mcap" else _rosbag(recording, clock, out)


def _moved(
    recording: Recording, clock: DeviceClock, each: Each, put: Callable[[Any, int, bytes], None]
) -> str:
    """Each message (its channel, log time, bytes, whether of ROS 1, whether a header leads) with
    log time and header's stamp on the first clock."""
    no = np.iinfo(np.int64).min
    logs, stamps, own = [], [], []
    for channel, log, raw, ros1, has_header in each():
        found = bags.stamp(raw, ros1) if has_header else None
        logs.append(log)
        stamps.append(found[1] * 10**9 + found[2] if found else no)
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
    for number, (channel, _, raw, ros1, _) in enumerate(each()):
        if near[number]:
            order = (bags.stamp(raw, ros1) or "<")[0]
            buffer = bytearray(raw)
            struct.pack_into(f"{order}iI", buffer, 4, *divmod(int(stamp[number]), 10**9))
            raw = bytes(buffer)
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

    def each() -> Iterator[tuple[Any, int, bytes, bool, bool]]:
        for schema, channel, message in bags.mcap_messages(recording.path, []):
            has_header = schema is not None and _leads_with_header(
                schema.data.decode(errors="replace")
            )
            channel.of_message = (schema, message)
            yield (
                channel,
                message.log_time,
                message.data,
                channel.message_encoding == "ros1",
                has_header,
            )

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


def _rosbag(recording: Recording, clock: DeviceClock, out: Path) -> str:
    from rosbags import rosbag1, rosbag2

    with bags.reader(recording.path) as bag:
        definitions = bag.typestore.fielddefs

        def each() -> Iterator[tuple[Any, int, bytes, bool, bool]]:
            for connection, log, raw in bag.messages():
                parts = definitions.get(connection.msgtype, ([], []))[1]
                has_header = bool(parts) and parts[0][1][1] == "std_msgs/msg/Header"
                yield connection, log, raw, not bag.is2, has_header

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
