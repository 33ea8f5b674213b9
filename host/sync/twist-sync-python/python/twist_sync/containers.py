"""Tables of files that are no text: arrays, JSON, spreadsheets, logs of flight controllers, GPMF.

Each function returns the form of its file and the tables in it; :mod:`twist_sync.tables` finds the
gyroscope. Libraries are extras of the package.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ._recording import Unreadable
from .columns import Table, sensor_of, table_of

Read = tuple[str, list[Table]]


def missing(extra: str, package: str, what: str) -> Unreadable:
    """Returns the error of an extra that is not installed."""
    return Unreadable(f'{what} is read by {package}: pip install "twist-sync[{extra}]"')


def arrays(found: dict[str, Any]) -> list[Table]:
    """Returns a table of the arrays of each length."""
    by_length: dict[int, dict[str, Any]] = {}
    for name, array in found.items():
        array = np.asarray(array)
        if array.ndim == 2 and min(array.shape) == 1:
            array = array.ravel()
        if array.ndim == 2 and array.shape[0] < array.shape[1] and array.shape[0] in (3, 4, 9):
            array = array.T
        if array.dtype.names:
            for own in array.dtype.names:
                by_length.setdefault(len(array), {})[own] = array[own]
        elif array.ndim in (1, 2, 3) and len(array) > 1 and array.dtype.kind in "iufM":
            by_length.setdefault(len(array), {})[name] = array
    out = []
    for columns in by_length.values():
        if len(columns) == 1 and (whole := np.asarray(next(iter(columns.values())))).ndim == 2:
            # One matrix: its columns have no names.
            names = [str(k + 1) for k in range(whole.shape[1])]
            out.append(Table("", names, list(whole.T), named=False))
        else:
            out.append(table_of("", columns))
    return out


def of_numpy(path: Path) -> Read:
    """Reads arrays of numpy: one of records, a matrix of columns without names, or several."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        return "npy", arrays({"array": found})
    with found as file:
        return "npz", arrays({name: file[name] for name in file.files})


def mat(path: Path) -> Read:
    """Reads variables of MATLAB up to version 7, also those within structures."""
    with path.open("rb") as file:
        version = file.read(128)[124:126]
    if version in (b"\0\2", b"\2\0"):
        raise Unreadable("a MAT-file of version 7.3, which is HDF5: save it with -v7")
    try:
        from scipy.io import loadmat
    except ImportError:
        raise missing("mat", "scipy", "a MAT-file") from None
    found: dict[str, Any] = {}

    def walk(name: str, value: Any) -> None:
        fields = getattr(value, "_fieldnames", None)
        if fields:
            for own in fields:
                walk(f"{name} {own}", getattr(value, own))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
            found[name] = value

    for name, value in loadmat(path, squeeze_me=True, struct_as_record=False).items():
        if not name.startswith("__"):
            walk(name, value)
    if not found:
        raise Unreadable("a MAT-file without arrays of numbers; tables and timetables: save them with writetimetable, as CSV")
    return "MAT-file", arrays(found)


def xlsx(path: Path) -> Read:
    """Reads the sheets of a spreadsheet, as text with tabs."""
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise missing("xlsx", "openpyxl", "a spreadsheet (or save it as CSV)") from None
    from . import text

    out: list[Table] = []
    book = load_workbook(path, read_only=True, data_only=True)
    for sheet in book.worksheets:
        lines = [
            "\t".join("" if c is None else str(c) for c in row) for row in sheet.iter_rows(values_only=True)
        ]
        try:
            dialect = text.sniff(lines[:400], [text.Dialect("\t"), text.Dialect("\t", ",")])
        except Unreadable:
            continue
        for table in text.tables(enumerate(lines, 1), dialect, []):
            table.name = table.name or sheet.title
            out.append(table)
    book.close()
    return "XLSX", out


def ulg(path: Path) -> Read:
    """Reads topics of PX4's log."""
    try:
        from pyulog import ULog
    except ImportError:
        raise missing("ulg", "pyulog", "a log of PX4") from None
    topics = ULog(str(path)).data_list
    # What others compute from it is not the sensor's.
    names = {topic.name for topic in topics}
    best = next((n for n in ("sensor_combined", "sensor_gyro", "vehicle_angular_velocity") if n in names), "")
    out = []
    for topic in topics:
        if topic.name == best or re.search("attitude|pose|odometry", topic.name):
            name = topic.name + (f" {topic.multi_id}" if topic.multi_id else "")
            columns = {k: v for k, v in topic.data.items() if not k.startswith("accelerometer_timestamp")}
            if topic.name == "sensor_gyro":
                columns = {f"gyro {k}" if k in ("x", "y", "z") else k: v for k, v in columns.items()}
            table = table_of(name, columns)
            table.units = ["us" if "timestamp" in n else "rad/s" if "gyro" in name + n or "xyz" in n else "" for n in table.names]
            out.append(table)
    return "PX4 ULog", out


def ardupilot(path: Path) -> Read:
    """Reads the messages IMU, GYR or ATT of ArduPilot's log, binary or text."""
    try:
        from pymavlink.DFReader import DFReader_binary, DFReader_text
    except ImportError:
        raise missing("ardupilot", "pymavlink", "a log of ArduPilot") from None
    with path.open("rb") as file:
        is_binary = file.read(2) == b"\xa3\x95"
    log = (DFReader_binary if is_binary else DFReader_text)(str(path))
    rows: dict[str, list[dict[str, Any]]] = {}
    while (message := log.recv_match(type=["IMU", "IMU2", "IMU3", "GYR"])) is not None:
        one = message.to_dict()
        name = one.pop("mavpackettype")
        rows.setdefault(f"{name} {one.get('I', '')}".strip(), []).append(one)
    if any(name.startswith("IMU") for name in rows):
        rows = {name: own for name, own in rows.items() if name.startswith("IMU")}
    out = []
    for name, own in rows.items():
        table = table_of(name, {k: [row[k] for row in own] for k in own[0] if isinstance(own[0][k], (int, float))})
        table.units = ["us" if n.endswith("US") else "rad/s" if n.startswith("Gyr") else "" for n in table.names]
        out.append(table)
    return "ArduPilot's log", out


def flattened(value: Any, order: str, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the numbers and words within objects and short lists of JSON, with their paths; lists
    of three are axes in an order such as "zxy"."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield from flattened(one, order, f"{path}.{key}".strip("."))
    elif isinstance(value, list) and len(value) <= 9:
        ends = order if len(value) == 3 else [str(k + 1) for k in range(len(value))]
        for end, one in zip(ends, value, strict=True):
            yield from flattened(one, order, f"{path}.{end}".strip("."))
    elif isinstance(value, (int, float, str)) or value is None:
        yield path, value


def axes_of(name: str) -> str:
    """Returns the order of the axes at the end of a name such as `Gyroscope (z,x,y)`."""
    letters = "".join(c for c in name.rpartition("(")[2].lower() if c in "xyz")
    return letters if "(" in name and sorted(letters) == ["x", "y", "z"] else "xyz"


def of_records(name: str, records: list[dict[str, Any]], units: str = "") -> Iterator[Table]:
    """Yields tables of objects: one for each sensor that a word in them names."""
    from . import text

    by_form: dict[tuple[str, tuple[str, ...]], list[list[Any]]] = {}
    dialect = text.Dialect()
    for record in records:
        flat = dict(flattened(record, axes_of(name)))
        word = next((v for v in flat.values() if isinstance(v, str) and sensor_of(v)), "")
        flat = {k: v for k, v in flat.items() if v is None or not isinstance(v, str) or v != word and dialect.is_value(v)}
        by_form.setdefault((word, tuple(flat)), []).append(list(flat.values()))
    for (word, names), rows in by_form.items():
        if len(rows) > 1 and len(names) > 2:
            own = " ".join(filter(None, [name, word]))
            # As text, so that no digits of whole numbers are lost.
            fields = [["" if v is None else repr(v) if isinstance(v, float) else str(v) for v in column] for column in zip(*rows, strict=True)]
            yield Table(own, list(names), fields, [units if "value" in n else "" for n in names], dialect=dialect)


def of_json(name: str, value: Any, units: str = "") -> Iterator[Table]:
    """Yields the tables anywhere in a value of JSON: lists of objects or of rows of numbers, and
    objects of lists of one length."""
    if isinstance(value, list) and len(value) > 1:
        if all(isinstance(one, dict) for one in value[:9]):
            yield from of_records(name, [one for one in value if isinstance(one, dict)], units)
        elif all(isinstance(one, list) and len(one) > 2 for one in value[:9]):
            try:
                for table in arrays({name: np.array(value, dtype=float)}):
                    table.name = name
                    yield table
            except ValueError:
                pass
    if isinstance(value, list) and len(value) <= 99:
        for one in value:
            if isinstance(one, (dict, list)):
                yield from of_json(name, one)
    if isinstance(value, dict):
        units = value.get("units", "") if isinstance(value.get("units"), str) else ""
        title = value.get("name") if isinstance(value.get("name"), str) else ""
        value = _named_rows(value)
        stated = {k.lower().replace("_", " "): str(v) for k, v in value.items() if isinstance(v, (int, float))}
        lists = {k: v for k, v in value.items() if isinstance(v, list) and len(v) > 1 and isinstance(v[0], (int, float, list))}
        for length in {len(v) for v in lists.values()}:
            same = {k: v for k, v in lists.items() if len(v) == length}
            # Lists of rows need one of times beside them.
            if len({isinstance(v[0], list) for v in same.values()}) > 1 or (len(same) > 2 and not isinstance([*same.values()][0][0], list)):
                try:
                    columns = {k: np.array([np.nan if x is None else x for x in v], dtype=float) for k, v in same.items()}
                    yield table_of(name, columns, settings=stated)
                except ValueError:
                    continue
                value = {k: v for k, v in value.items() if k not in same}
        for key, one in value.items():
            yield from of_json(f"{name} {title or key}".strip(), one, units)


def _named_rows(value: dict[str, Any]) -> dict[str, Any]:
    """Returns an object whose lists of rows are columns, if another list names these."""
    for names in value.values():
        if isinstance(names, list) and names and all(isinstance(one, str) or isinstance(one, dict) and "name" in one for one in names):
            found = [one if isinstance(one, str) else f"{one['name']} [{one.get('units', '')}]" for one in names]
            for key, rows in value.items():
                if isinstance(rows, list) and len(rows) > 1 and all(isinstance(row, list) and len(row) == len(found) for row in rows):
                    return {k: v for k, v in value.items() if k != key} | dict(zip(found, map(list, zip(*rows)), strict=True))
    return value


def yaml(path: Path) -> Read:
    """Reads the documents that `rostopic echo` and `ros2 topic echo` print."""
    records = []
    for document in re.split(r"(?m)^---\s*$", path.read_text(encoding="utf-8", errors="replace")):
        names: list[str] = []
        records.append({})
        for indent, name, value in re.findall(r"(?m)^( *)(\w+): *(.*?)\s*$", document):
            names = [*names[: len(indent) // 2], name]
            records[-1][".".join(names)] = value
    return "text of rostopic echo", list(of_records("", records))


def of_text(path: Path) -> Read:
    """Reads JSON, and lines of JSON."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        content = file.read()
    try:
        return "JSON", list(of_json("", json.loads(content)))
    except ValueError as error:
        records = []
        lines = content.splitlines()
        for number, line in enumerate(lines, 1):
            try:
                records += [json.loads(line)] if line.strip() else []
            except ValueError:
                if number == len(lines) and len(records) > 1:
                    break
                raise Unreadable(f"neither JSON ({error}) nor lines of it (line {number})") from None
        return "JSON lines", list(of_json("", records))


def _klv(data: bytes) -> Iterator[tuple[bytes, str, int, bytes]]:
    """Yields key, type, size of a sample and content of the elements of GPMF."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, repeat = struct.unpack_from(">4scBH", data, at)
        length = size * repeat
        yield key, kind.decode("latin-1"), size, data[at + 8 : at + 8 + length]
        at += 8 + (length + 3) // 4 * 4


def gpmf(path: Path) -> Read:
    """Reads GoPro's metadata without its video, <https://github.com/gopro/gpmf-parser>: the
    samples of a payload lie evenly between its time and that of the next."""
    formats = {"s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8", "J": ">u8"}
    starts: list[int] = []
    payloads: list[np.ndarray] = []
    order = "xyz"
    for device, _, _, content in _klv(path.read_bytes()):
        streams = [c for key, _, _, c in _klv(content) if key == b"STRM"] if device == b"DEVC" else []
        for stream in streams:
            parts = {key: (kind, body) for key, kind, _, body in _klv(stream)}
            if b"GYRO" not in parts:
                continue
            kind, body = parts[b"GYRO"]
            values = np.frombuffer(body[: len(body) // 2 * 2], formats[kind])
            scale = np.frombuffer(parts[b"SCAL"][1], formats[parts[b"SCAL"][0]])[0] if b"SCAL" in parts else 1
            payloads.append(values[: len(values) // 3 * 3].reshape(-1, 3) / float(scale))
            if b"STMP" in parts:
                starts.append(int.from_bytes(parts[b"STMP"][1][:8], "big"))
            said = parts.get(b"ORIN", ("", b""))[1].decode("latin-1") or parts.get(b"STNM", ("", b""))[1].decode("latin-1")
            order = axes_of(said if "(" in said else f"({said}")
    if not payloads:
        raise Unreadable("GPMF without a gyroscope (GYRO)")
    w = np.concatenate(payloads)
    form = f"GPMF without its video: stream GYRO ({','.join(order)})"
    units = [""] + ["rad/s"] * 3
    names = ["time", *(f"gyro {axis}" for axis in order)]
    if len(starts) != len(payloads) or len(starts) < 2:
        # Of cameras up to HERO5.
        return form + ", without times of its own", [Table("", names[1:], list(w.T), units[1:])]
    counts = np.array([len(p) for p in payloads])
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    ends = [*starts, starts[-1] + (starts[-1] - starts[-2]) * counts[-1] / counts[-2]]
    t = np.interp(np.arange(counts.sum()), [*first, counts.sum()], np.array(ends) - starts[0]) + starts[0]
    units[0] = "us"
    return form, [Table("", names, [t, *w.T], units)]


#: Readers by kind of file.
READERS: dict[str, Callable[[Path], Read]] = {
    "npy": of_numpy,
    "npz": of_numpy,
    "mat": mat,
    "xlsx": xlsx,
    "ulg": ulg,
    "ardupilot": ardupilot,
    "json": of_text,
    "yaml": yaml,
    "gpmf": gpmf,
}
