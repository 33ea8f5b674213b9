"""Gyroscopes in CSV and other text: columns and units by the header, else by plausibility.

Formats of which names were taken: OpenCamera-Sensors, Sensor Logger, phyphox, AndroSensor,
Physics Toolbox, SensorLog (iOS), EuRoC, `rostopic echo -p`, bagpy, ulog2csv (PX4),
blackbox_decode (Betaflight), mission logs of ArduPilot, Arduino sketches (`millis`, `micros`).
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from ._recording import Recording, Unreadable

#: rad/s in one of each.
RATE_UNITS = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": np.pi / 180,
    "mdps": np.pi / 180e3,
    "rpm": np.pi / 30,
}
#: Nanoseconds in one of each.
TIME_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}

#: A gyroscope's samples are not farther apart, s.
LONGEST_STEP_S = 0.2
#: Nine of ten samples of a moved body turn slower than this, rad/s (20 rad/s are 3 turns a second).
FASTEST = 20.0
#: Bytes in which the first row of samples must lie.
HEAD = 1 << 18
LONGEST_LINE = 1 << 16

_GYRO = {
    "gyro",
    "gyr",
    "gyroscope",
    "angular",
    "rotation",
    "rot",
    "omega",
    "w",
    "g",
    "av",
    "angvel",
}
_OTHER = set(
    "acc accel acceleration accelerometer mag magn magnetometer magnetic gravity linear user euler"
    " orientation quaternion attitude a m gf temp position pos pose covariance integral setpoint"
    " heading location bias torque unfilt".split()
)
_TIME = {
    "time": 1, "timestamp": 0, "timestamps": 0, "stamp": 0, "t": 2, "ts": 1, "sec": 3, "secs": 3, "seconds": 3, "ns": 3,
    "nanoseconds": 3, "nanos": 3, "us": 3, "micros": 3, "microseconds": 3, "ms": 3, "millis": 3,
    "milliseconds": 3, "s": 4, "elapsed": 4, "timeus": 1, "timems": 1, "loggingtime": 2,
}  # fmt: skip
_TIME_WORDS = {
    "ns": "ns nanos nanosec nsec nsecs nanoseconds timens",
    "us": "us µs μs micros usec microseconds timeus",
    "ms": "ms millis msec milliseconds timems",
    "s": "s sec secs seconds",
}
_RATE_WORDS = {
    "mdps": r"mdps|mdeg|millideg",
    "deg/s": r"dps|deg|°",
    "mrad/s": r"mrad",
    "rpm": r"rpm",
    "rad/s": r"rad",
}


@dataclass
class Layout:
    """Where the samples stand in a text file."""

    delimiter: str | None
    """None: any white space."""
    columns: list[int]
    """Of time, x, y, z; with a fifth for nanoseconds beside seconds."""
    names: list[str]
    first_row: int
    """Lines before the first row."""
    decimal_comma: bool = False
    time_unit: str | None = None
    rate_unit: str | None = None
    is_iso: bool = False


def _words(name: str) -> list[str]:
    """Splits a column's name into lower-case words without units in brackets: `gyro_rad[0]` is
    gyro, rad, x."""
    name = re.sub(r"\[([012])\]", lambda m: f" {'xyz'[int(m[1])]} ", name)
    name = re.sub(r"[\[(].*", "", name)
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return re.findall(r"[^\W_]+", name.lower())


def _axis(words: list[str]) -> tuple[str, str] | None:
    """Returns the axis of a column and the rest of its name: x and `w`, `gyro` of `wx`,
    `gyro_x`."""
    for at in range(len(words) - 1, -1, -1):
        found = re.fullmatch(r"(w|g|gf|gyro|gyr|omega|rot|av|a|m|acc|mag|)([xyz])", words[at])
        if found:
            rest = [*words[:at], *filter(None, [found[1]]), *words[at + 1 :]]
            return found[2], " ".join(word for word in rest if word not in ("rad", "deg", "dps"))
    return None


def _gyroscopes(names: list[str]) -> dict[str, list[int]]:
    """Columns x, y, z of each gyroscope by what their names share."""
    groups: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names):
        if found := _axis(_words(name)):
            groups.setdefault(found[1], {}).setdefault(found[0], column)
    triples = {s: [g[k] for k in "xyz"] for s, g in groups.items() if len(g) == 3}
    plain = {s: t for s, t in triples.items() if not _OTHER & set(s.split())}
    named = {s: t for s, t in plain.items() if _GYRO & set(s.split()) or "gyr" in s}
    return named or plain


def _is_time(name: str) -> int | None:
    """Rank of a column's name as one of times; lower is better."""
    words = _words(name)
    if _axis(words):
        return None
    ranks = [_TIME[w] for w in words if w in _TIME]
    return min(ranks) - 2 * ("stamp" in words and "header" in words) if ranks else None


def _time_unit(name: str) -> str | None:
    inside = re.findall(r"[\[(]([^\])]*)[\])]", name)
    words = [w for part in inside for w in re.findall(r"[^\W_]+", part.lower())] or _words(name)
    for unit, spellings in _TIME_WORDS.items():
        if words and words[-1] in spellings.split():
            return unit
    return None


def _rate_unit(name: str) -> str | None:
    low = name.lower()
    return next((unit for unit, word in _RATE_WORDS.items() if re.search(word, low)), None)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _is_iso(text: str) -> bool:
    return re.match(r"\s*\"?\d{4}-\d\d-\d\d[T ]\d\d:\d\d", text) is not None


def split(line: str, delimiter: str | None) -> list[str]:
    """The fields of a line without their quotes."""
    if delimiter is None:
        return line.split()
    if '"' in line:
        return [field.strip() for field in next(csv.reader([line], delimiter=delimiter), [])]
    return [field.strip() for field in line.split(delimiter)]


def _delimiter(rows: list[str]) -> str | None:
    """The separator that gives the most columns, the same number in each row."""
    best, most = None, 1
    for one in (";", "\t", ",", None):
        counts = {len(split(row, one)) for row in rows}
        if len(counts) == 1 and max(counts) > most:
            best, most = one, max(counts)
    return best


def _layout(head: str, columns: list[str] | None, topic: str | None) -> Layout:
    lines = head.splitlines()[:200]
    if len(head) == HEAD:
        lines = lines[:-1] or lines
    if any(len(line) > LONGEST_LINE for line in lines):
        raise Unreadable("a line without end; expected lines of text")

    def is_row(line: str) -> bool:
        fields = re.split(r"[;\t, ]+", line.strip())
        numbers = sum(_number(f.strip('"')) is not None or _is_iso(f) for f in fields)
        return numbers >= 4 or (_is_iso(line) and numbers >= 3)

    rows = [k for k, line in enumerate(lines) if is_row(line) and line.strip()[0] not in "#%/"]
    if not rows:
        shown = next((line for line in lines if line.strip()), "")[:60]
        raise Unreadable(f"no rows of samples: expected time and x, y, z, found {shown!r}")
    first = rows[0]
    data = [lines[k] for k in rows]
    delimiter = _delimiter(data)
    width = len(split(data[0], delimiter))
    header = next(
        (
            names
            for line in reversed(lines[:first])
            if len(names := split(re.sub(r"^\s*(#|%|//)+\s*", "", line), delimiter)) == width
        ),
        None,
    )
    decimal_comma = delimiter in (";", "\t", None) and bool(re.search(r"\d,\d", data[0]))
    names = header or [str(k + 1) for k in range(width)]
    layout = Layout(delimiter, [], names, first, decimal_comma)
    if columns:
        layout.columns = [_column(name, names) for name in columns]
    elif header:
        layout.columns = _by_name(header, topic)
    else:
        layout.columns = _by_values(data, layout)
    layout.is_iso = _is_iso(split(data[0], delimiter)[layout.columns[0]])
    time, axis = names[layout.columns[0]], layout.columns[1:4]
    if header:
        layout.time_unit = _time_unit(time)
        if "%time" in lines[first - 1] or time.endswith("header.stamp"):
            layout.time_unit = "ns"
        units = {_rate_unit(names[k]) for k in axis}
        if len(units) > 1:
            raise Unreadable(f"the columns {[names[k] for k in axis]} are not of one unit")
        layout.rate_unit = units.pop()
    return layout


def _column(name: str, names: list[str]) -> int:
    if name in names:
        return names.index(name)
    if name.isdecimal() and 1 <= int(name) <= len(names):
        return int(name) - 1
    raise Unreadable(f"no column {name!r}; there are {', '.join(names)}, or 1 to {len(names)}")


def _by_name(names: list[str], topic: str | None) -> list[int]:
    found = _gyroscopes(names)
    hint = "name the columns with --columns TIME,X,Y,Z"
    if topic is not None and topic in found:
        found = {topic: found[topic]}
    if not found:
        raise Unreadable(f"no columns of a gyroscope among {', '.join(names)[:200]}; {hint}")
    if len(found) > 1:
        of_each = "; ".join(f"@{s} ({', '.join(names[k] for k in t)})" for s, t in found.items())
        raise Unreadable(f"several gyroscopes: {of_each}: name one after the file, or {hint}")
    stem, axes = next(iter(found.items()))
    times = [(rank, k) for k, name in enumerate(names) if (rank := _is_time(name)) is not None]
    if not times:
        raise Unreadable(f"no column of times among {', '.join(names)[:200]}; {hint}")

    def order(one: tuple[int, int]) -> tuple[bool, int, int]:
        # Of several, the one that shares a word with the rates.
        shares = set(stem.split()) & set(_words(names[one[1]])) - {"x"}
        return not shares, one[0], one[1]

    time = min(times, key=order)[1]
    # Seconds and nanoseconds of a stamp in two columns.
    words = [_words(name) for name in names]
    seconds = [k for k, w in enumerate(words) if w[-2:] in (["stamp", "sec"], ["stamp", "secs"])]
    more = [k for k, w in enumerate(words) if w[-1:] and w[-1] in ("nanosec", "nsec", "nsecs")]
    if seconds and more:
        return [seconds[0], *axes, more[0]]
    return [time, *axes]


def _by_values(rows: list[str], layout: Layout) -> list[int]:
    """Columns of a file without names: `t x y z` or `x y z t`."""
    fields = [split(row, layout.delimiter) for row in rows]
    if _is_iso(fields[0][0]):
        fields = [[str(k), *row[1:]] for k, row in enumerate(fields)]
    table = np.array([[_number(_dot(f, layout)) for f in row] for row in fields], dtype=float)
    width = table.shape[1]
    rising = [k for k in (0, 3) if width == 4 and np.all(np.diff(table[:, k]) >= 0)]
    rising = [k for k in rising if np.ptp(table[:, k]) and np.all(table[:, k] >= 0)]
    if len(rows) == 1 and width == 4:
        rising = [int(np.argmax(np.abs(table[0])))]
    # Of a slow motion the rates may rise too, but not by even steps.
    ends = sorted(rising, key=lambda k: np.std(np.diff(table[:, k])) / np.ptp(table[:, k]))[:1]
    if ends:
        return [ends[0], *(k for k in range(4) if k != ends[0])]
    raise Unreadable(
        f"{width} columns without names: say with --columns TIME,X,Y,Z (numbers from 1) which is which"
    )


def _dot(field: str, layout: Layout) -> str:
    return field.replace(",", ".") if layout.decimal_comma else field


def iso_nanos(text: str) -> int:
    """Nanoseconds since 1970 of an ISO time; without a zone, of UTC."""
    found = re.fullmatch(
        r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d+))?\s*(Z|[+-]\d\d:?\d\d)?",
        text.strip(),
    )
    if not found:
        raise ValueError(f"could not read {text[:40]!r} as a time")
    whole = int(np.datetime64(f"{found[1]}T{found[2]}", "s").astype(np.int64))
    zone = found[4] or "Z"
    if zone != "Z":
        whole -= (1 if zone[0] == "+" else -1) * (int(zone[1:3]) * 3600 + int(zone[-2:]) * 60)
    return whole * 10**9 + int((found[3] or "0")[:9].ljust(9, "0"))


def rows(file: IO[str], layout: Layout) -> Iterator[tuple[int, str, list[str] | None]]:
    """Yields number and text of each line, and its fields if it has samples and is complete."""
    width = len(layout.names)
    for number, line in enumerate(file, 1):
        text = line.strip("\r\n\ufeff")
        if number <= layout.first_row or not text.strip() or text.lstrip()[0] in "#%":
            yield number, line, None
            continue
        fields = split(text, layout.delimiter)
        if len(fields) != width:
            # A recorder that was stopped in the middle of its last line.
            if not file.readline() and len(fields) <= width:
                yield number, line, []
                return
            raise Unreadable(
                f"line {number}: expected {width} columns, found {len(fields)}: {text[:60]}"
            )
        yield number, line, fields


def row_time(fields: list[str], layout: Layout) -> int | float:
    """The time of a row: exact in nanoseconds of an ISO time and where seconds and nanoseconds
    stand apart, else in the unit of the column."""
    time = fields[layout.columns[0]]
    if layout.is_iso:
        return iso_nanos(time)
    if len(layout.columns) > 4:
        return int(time) * 10**9 + int(fields[layout.columns[4]])
    try:
        return int(time)
    except ValueError:
        return float(_dot(time, layout))


def _slow(path: Path, layout: Layout) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Times, rates, and which rows were left out, line by line."""
    times: list[int | float] = []
    rates: list[list[float]] = []
    empty, notes = 0, []
    cut = "its last line is cut and left out"
    with open_text(path) as file:
        for number, _, fields in rows(file, layout):
            if fields is None:
                continue
            if not fields:
                notes.append(cut)
                break
            taken = [fields[k] for k in layout.columns]
            if any(value.lower() in ("", "nan", "null", "none", "na") for value in taken):
                empty += 1
                continue
            try:
                time = row_time(fields, layout)
                rates.append([float(_dot(value, layout)) for value in taken[1:4]])
                times.append(time)
            except ValueError as error:
                if file.readline():
                    raise Unreadable(f"line {number}: {error}") from None
                notes.append(cut)
                break
    if empty:
        notes.append(f"{empty} rows without numbers are left out")
    kind = np.int64 if all(isinstance(t, int) for t in times) else np.float64
    try:
        return np.array(times, dtype=kind), np.array(rates).reshape(-1, 3), notes
    except OverflowError:
        raise Unreadable("times of more than 19 digits") from None


def _fast(path: Path, layout: Layout) -> tuple[np.ndarray, np.ndarray, list[str]] | None:
    """Returns the result of :func:`_slow` for regular files, else None."""
    if layout.is_iso or layout.decimal_comma or len(layout.columns) > 4:
        return None
    for kind in (np.int64, np.float64):
        form = np.dtype([("t", kind), ("x", "f8"), ("y", "f8"), ("z", "f8")])
        try:
            with open_text(path) as file, warnings.catch_warnings():
                # NumPy 1.24 cuts the fraction off where later ones refuse, and warns.
                warnings.simplefilter("error", DeprecationWarning)
                table = np.loadtxt(
                    file,
                    form,
                    delimiter=layout.delimiter,
                    skiprows=layout.first_row,
                    usecols=layout.columns,
                    quotechar='"',
                    comments="#",
                    ndmin=1,
                )
        except (ValueError, OverflowError, DeprecationWarning):
            continue
        rates = np.column_stack([table[k] for k in "xyz"])
        if np.isfinite(rates).all():
            return table["t"], rates, []
    return None


def open_text(path: Path) -> IO[str]:
    """Opens a text file with arbitrary bytes."""
    return path.open(encoding="utf-8-sig", errors="surrogateescape", newline="")


def plausible_time(times: np.ndarray) -> str:
    """Returns the unit in which the samples are as far apart as those of a gyroscope."""
    step = abs(float(times[-1]) - float(times[0])) / max(len(times) - 1, 1)
    return next(
        (unit for unit in ("s", "ms", "us") if step * TIME_UNITS[unit] <= LONGEST_STEP_S * 1e9),
        "ns",
    )


def to_nanos(times: np.ndarray, unit: str) -> np.ndarray:
    """Integer nanoseconds."""
    scale = TIME_UNITS[unit]
    largest = float(np.abs(times.astype(float)).max())
    if not np.isfinite(largest) or largest * scale > 9.2e18:
        raise Unreadable(f"times up to {largest:g} {unit} are none: give --time-unit")
    if times.dtype.kind in "iu":
        return times.astype(np.int64) * scale
    # Whole units apart, so that no digits are lost.
    whole = np.floor(times)
    return whole.astype(np.int64) * scale + np.round((times - whole) * scale).astype(np.int64)


def typical_rate(rates: np.ndarray) -> float:
    """Returns a large rate of the motion that outliers do not affect: nine of ten are slower."""
    return float(np.quantile(np.linalg.norm(rates, axis=1), 0.9))


def plausible_rate(rates: np.ndarray) -> str:
    typical = typical_rate(rates)
    return next((u for u in ("rad/s", "deg/s") if typical * RATE_UNITS[u] <= FASTEST), "mdps")


def read(
    path: Path,
    topic: str | None,
    columns: list[str] | None,
    unit: str | None,
    time_unit: str | None,
) -> Recording:
    """Reads a text file; arguments that are None are found by names, else by plausibility."""
    with open_text(path) as file:
        head = file.read(HEAD)
    if not head.strip():
        raise Unreadable("it is empty")
    if "\0" in head:
        raise Unreadable("no text, and no recording that is known")
    layout = _layout(head, columns, topic)
    times, rates, notes = _fast(path, layout) or _slow(path, layout)
    if not len(times):
        raise Unreadable("no rows of samples")
    exact = layout.is_iso or len(layout.columns) > 4
    by = (
        "ISO"
        if layout.is_iso
        else "given"
        if time_unit
        else "named"
        if layout.time_unit
        else "by their distance"
    )
    layout.time_unit = "ns" if exact else time_unit or layout.time_unit or plausible_time(times)
    nanos = to_nanos(times, layout.time_unit)
    of_rate = "given" if unit else "named" if layout.rate_unit else "by their size"
    layout.rate_unit = unit or layout.rate_unit or plausible_rate(rates)
    name = [layout.names[k] for k in layout.columns]
    separator = {None: "white space", "\t": "tabs", ";": "semicolons", ",": "commas"}[
        layout.delimiter
    ]
    form = (
        f"text with {separator}: times of {name[0]!r} in {layout.time_unit} ({by}), rates of "
        f"{', '.join(map(repr, name[1:4]))} in {layout.rate_unit} ({of_rate})"
    )
    return Recording(
        path,
        form,
        nanos,
        rates * RATE_UNITS[layout.rate_unit],
        notes=notes,
        unit_is_guess=of_rate == "by their size",
        layout=layout,
    )
