"""From text to tables: the separators of a file, its headers, and which rows belong together.

A line is a row if most of its fields are numbers or times; what stands above the first row of a
table is its header. Which column is what, is decided in :mod:`twist_sync.tables`.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from ._recording import Unreadable
from .columns import Table, is_sensor, sensor_of, unit_of
from .rules import MISSING, MOMENT, RATE_UNITS

#: Characters in which the first rows of samples must lie.
HEAD = 1 << 18
LONGEST_LINE = 1 << 16
CUT = "its last line is cut and left out"
#: Rows of a header's length at most, above the rows of samples.
LONGEST_HEADER = 8
#: Distinct words in a column that tells sensors apart, at most.
MOST_SENSORS = 32

_THOUSANDS = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?"),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?"),
}
_COMMENT = re.compile(r"\s*(#|%|//|[;!](?=\s))+\s*")
_TITLE = re.compile(r"[\[#=\s]*[A-Za-z][A-Za-z ]*[\]:=\s]*")
_LABEL = re.compile(r"([A-Za-z][\w .\[\]()/]*?)\s*[:=]\s*([-+]?\d[\d.]*(?:[eE][-+]?\d+)?)")
Row = tuple[int, list[str]]


@dataclass(frozen=True)
class Dialect:
    """The separators of a text file.

    Attributes:
        delimiter: Between fields; None for any white space.
        decimal: A point or a comma.
    """

    delimiter: str | None = ","
    decimal: str = "."

    def split(self, line: str) -> list[str]:
        """Returns the fields of a line without their quotes."""
        # Stamps of Arduino's monitor; checksums of NMEA.
        line = line.replace("−", "-").replace(" -> ", self.delimiter or " ").strip("\r\n")
        line = re.sub(r"\*[0-9A-F]{2}$", "", line) if line.startswith("$") else line
        # Lists and tuples of Python.
        line = line.strip(" [](),") if line.startswith(("[", "(")) and line.endswith(("]", ")", ",")) else line
        if self.delimiter is None:
            return line.split()
        fields = next(csv.reader([line], delimiter=self.delimiter), []) if '"' in line else line.split(self.delimiter)
        return [field.strip() for field in fields]

    def plain(self, field: str) -> str:
        """Returns a number with a decimal point and without separators of thousands."""
        field = re.sub(r"[\u00a0\u202f']", "", field)
        if _THOUSANDS[self.decimal].fullmatch(field):
            field = field.replace("," if self.decimal == "." else ".", "")
        if self.decimal == "," and "." in field:
            raise ValueError(f"{field[:40]!r} has a decimal point, other numbers have commas")
        if "_" in field:
            raise ValueError(f"could not convert {field[:40]!r}")
        return field.replace(",", ".") if self.decimal == "," else field

    def number(self, field: str) -> float:
        """Returns a number; NaN for one that is missing."""
        if self.decimal == "." and "_" not in field:
            with contextlib.suppress(ValueError):
                return float(field)
        if field.lower() in MISSING:
            return np.nan
        plain = self.plain(field)
        try:
            return float(plain)
        except ValueError:
            raise ValueError(f"could not convert {field[:40]!r}") from None

    def plain_numbers(self, texts: list[str]) -> np.ndarray | None:
        """Returns fields of which each is a plain number, at once; None for others."""
        whole = "".join(texts)
        if "_" in whole or (self.decimal == "," and "." in whole):
            return None
        try:
            return np.array([float(t.replace(",", ".")) for t in texts] if self.decimal == "," else list(map(float, texts)))
        except ValueError:
            return None

    def is_value(self, field: str) -> bool:
        """Returns True for a number or a time."""
        if ":" in field:
            return MOMENT.fullmatch(field) is not None
        try:
            # NaN differs from itself.
            return (value := self.number(field)) == value
        except ValueError:
            return False

    def score(self, fields: list[str]) -> int | None:
        """Returns by how much the numbers and times of a row are more than its words, each of which
        counts twice; None if most are words."""
        values = sum(map(self.is_value, fields))
        words = sum(field.lower() not in MISSING for field in fields) - values
        return values - 2 * words if values >= max(3, words) else None

    def is_row(self, fields: list[str]) -> bool:
        """Returns True if most of the fields are numbers or times."""
        return self.score(fields) is not None

    @property
    def name(self) -> str:
        between = {None: "white space", "\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars"}
        return f"text with {between[self.delimiter]}{', decimal commas' if self.decimal == ',' else ''}"


_DIALECTS = [Dialect(*d) for d in (";.", ";,", "\t.", "\t,", ",.", ",,", "|.")] + [Dialect(None, "."), Dialect(None, ",")]


def sniff(lines: list[str], among: Sequence[Dialect] = _DIALECTS) -> Dialect:
    """Returns the dialect in which the most fields of the lines are numbers and the fewest words.

    Raises:
        Unreadable: No line has three numbers in any.
    """

    def score(one: Dialect) -> float:
        # Unquoted, commas cannot be both.
        if one == Dialect(",", ",") and not any('","' in line for line in lines):
            return -math.inf
        rows = (one.split(line) for line in lines if one.delimiter is None or one.delimiter in line)
        found = [one.score(row) for row in rows if len(row) > 2]
        return sum(own or 0 for own in found) if any(own is not None for own in found) else -math.inf

    scores = [score(one) for one in among]
    if max(scores) == -math.inf:
        # The one with the most digits is a row, if any is.
        shown = max(lines, key=lambda line: sum(map(str.isdigit, line[:200])), default="").strip()[:60]
        raise Unreadable(f"no rows of samples: expected time and x, y, z, found {shown!r}")
    return among[int(np.argmax(scores))]


@dataclass
class Block:
    """Rows with what stands above them: line numbers, fields and texts."""

    header: list[tuple[int, list[str], str]]
    rows: list[Row] = field(default_factory=list)
    #: Width of the first row, and its columns of numbers, by which others are known quickly.
    width: int = 0
    sure: list[int] = field(default_factory=list)

    def takes(self, fields: list[str], dialect: Dialect) -> bool:
        """Returns True for a row like the first one, without a look at each field."""
        if len(fields) != self.width:
            return False
        try:
            for k in self.sure:
                float(fields[k].replace(",", ".") if dialect.decimal == "," else fields[k])
        except ValueError:
            return False
        return True


def blocks(lines: Iterable[tuple[int, str]], dialect: Dialect, notes: list[str]) -> list[Block]:
    """Cuts a file where rows come under another header."""
    out: list[Block] = []
    above: list[tuple[int, list[str], str]] = []
    for number, line in lines:
        text = line.strip()
        # Lines that are empty, or rules of a table.
        if not text.strip("-+=|: \t"):
            continue
        comment = _COMMENT.match(text)
        fields = dialect.split(text[comment.end() :] if comment else line)
        if out and not above and not comment and out[-1].takes(fields, dialect):
            out[-1].rows.append((number, fields))
            continue
        if comment or not dialect.is_row(fields):
            above.append((number, fields, text))
            continue
        width = len(_stripped(fields))
        if not out or any(_are_names(entry, width, dialect, len(out[-1].rows) > 9) for entry in above):
            # Numbers in a header, such as the IDs of bodies.
            if out and len(out[-1].rows) < 3:
                short = out.pop()
                above = [*short.header, *((n, f, "") for n, f in short.rows), *above]
            out.append(Block(above))
        elif above:
            notes.append(_left_out(above))
        if not out[-1].rows:
            out[-1].width = len(fields)
            numbers = (k for k, f in enumerate(fields) if ":" not in f and dialect.is_value(f))
            out[-1].sure = list(itertools.islice(numbers, 4))
        out[-1].rows.append((number, fields))
        above = []
    if above and out:
        notes.append(CUT if len(above) == 1 else _left_out(above))
    elif out and len(out[-1].rows) > 1:
        # A recorder that was stopped in the middle of its last line.
        (_, usual), (_, last) = out[-1].rows[-2:]
        if len(last) < len(usual) or any(
            dialect.is_value(a) and b.lower() not in MISSING and not dialect.is_value(b)
            for a, b in zip(usual, last, strict=False)
        ):
            out[-1].rows.pop()
            notes.append(CUT)
    return out


def _are_names(entry: tuple[int, list[str], str], width: int, dialect: Dialect, is_within: bool) -> bool:
    """Returns True for a line that names as many columns as a row has; within rows, the names
    differ and none is a value."""
    _, fields, text = entry
    is_wide = len(_stripped(fields)) in (width, width + 1) and not _COMMENT.match(text)
    values = sum(map(dialect.is_value, fields))
    return is_wide and values * 3 < len(fields) and not (is_within and (values or len(set(fields)) * 2 <= width))


def _left_out(lines: list[tuple[int, list[str], str]]) -> str:
    number, _, text = lines[0]
    more = f" and {len(lines) - 1} more" if len(lines) > 1 else ""
    return f"line {number}{more}: {text[:40]!r} is no row: left out"


def _stripped(fields: list[str]) -> list[str]:
    return fields[: max((k for k, field in enumerate(fields, 1) if field), default=0)]


def _header(block: Block, width: int, dialect: Dialect) -> dict[str, Any]:
    """Returns names and units of the columns, and if they are those of the file, as of a `Table`.

    Rows of names above each other are joined, a name that spans columns is repeated, and a row of
    units is recognised by its units."""
    found: list[list[str]] = []
    for at, (_, fields, text) in enumerate(block.header, 1):
        if len(_stripped(fields)) < 2 and (at == len(block.header) or _COMMENT.match(text)):
            # Commas or tabs in the header alone.
            text = _COMMENT.sub("", text, count=1).strip("'\" ")
            splits = [Dialect(d).split(text) for d in (dialect.delimiter, ",", "\t", ";", None)]
            fields = min(splits, key=lambda some: abs(len(some) - width))
        cells = [*fields, *[""] * (width - len(fields))]
        filled = [k for k, cell in enumerate(cells) if cell]
        numbers = sum(map(dialect.is_value, cells))
        # The IDs of bodies are numbers; so are values of settings.
        is_setting = numbers and numbers < len(filled) - 1
        if filled and not cells[0] and len(filled) == 1:
            # A title of cells that are empty.
            continue
        if filled and (filled[-1] >= width or len(filled) < 2 or filled[-1] * 2 < width or is_setting) or not filled:
            found.clear()
        else:
            found.append(cells[:width])
    found = found[-LONGEST_HEADER:]
    units = next((row for row in found[1:] if sum(bool(unit_of(c)) for c in row) * 2 > sum(map(bool, row))), None)
    if units:
        found.remove(units)
    units = units or [""] * width
    if not found:
        above = [len(_stripped(f)) for _, f, text in block.header[-1:] if len(f) > 3 and not _COMMENT.match(text)]
        wrong = ""
        if above and above[-1] != width and not any(map(dialect.is_value, block.header[-1][1])):
            wrong = f"line {block.rows[0][0]}: {width} columns, {above[-1]} names"
            if dialect.delimiter == "," and above[-1] * 2 in (width, width + 1):
                wrong += ": numbers with decimal commas, between commas? Export them with semicolons or points"
        return {"names": [str(k + 1) for k in range(width)], "units": units, "named": False, "misnamed": wrong}
    for row in found[:-1]:
        for k in range(1, width):
            if not row[k] and found[-1][k]:
                row[k] = row[k - 1]
    names = [" ".join(dict.fromkeys(filter(None, column))) for column in zip(*found, strict=True)]
    return {"names": names, "units": units, "named": True}


def settings(block: Block) -> dict[str, str]:
    """Returns what the lines above a table set: `tscale,0.001`, `// Update Rate: 100.0Hz`, also in
    pairs of one line."""
    out: dict[str, str] = {}
    before: list[str] = []
    above = {unit_of(inside) for _, _, text in block.header for inside in re.findall(r"[\[(]([^\[\]()]+)[\])]", text)}
    # A number before it is the range.
    if len(turning := [unit[1] for unit in above if unit and unit[1] in RATE_UNITS]) == 1:
        out["turning in"] = turning[0]
    for _, fields, text in block.header:
        fields = _stripped(fields)
        pairs = re.findall(r"([A-Za-z][\w ()/]*?)\s*[:=]\s*([+-]?[\d.][^\s,;]*)", text)
        pairs += [(a.rstrip(": "), b) for a, b in itertools.pairwise(fields) if re.match(r"[+-]?[\d.]", b) or a == "Rotation Type"]
        # A number alone under a word, as Vicon's: the rate.
        if len(fields) == len(before) == 1 and re.fullmatch(r"\d{1,5}(\.\d+)?", fields[0]):
            pairs.append(("rate", fields[0]))
        before = fields
        for name, value in pairs:
            out.setdefault(name.strip().lower(), value)
    return out


def _apart(block: Block, names: list[str], named: bool) -> dict[str, list[Row]]:
    """Cuts rows of several sensors apart, by a column of words such as gyroscope and accelerometer
    or of few numbers under a name such as sensor: the word and its rows."""
    for k, name in enumerate(names):
        words = {fields[k] for _, fields in block.rows[:1000] if k < len(fields)}
        if len(words) <= MOST_SENSORS:
            words = {fields[k] for _, fields in block.rows if k < len(fields)}
        is_word = all(re.match(r"[A-Za-z_/]", word) and word.lower() not in MISSING for word in words)
        is_tag = len(words) > 1 and (is_sensor(name) and (is_word or all(map(str.isdecimal, words))) if named else k < 2 and is_word)
        if 0 < len(words) <= MOST_SENSORS and (is_tag or (is_word and any(map(sensor_of, words)))):
            out: dict[str, list[Row]] = {}
            for row in block.rows:
                if k < len(row[1]):
                    out.setdefault(row[1][k], []).append(row)
            return out
    return {"": block.rows}


def _of_comment(block: Block, word: str, width: int, dialect: Dialect) -> list[str] | None:
    """Returns the names of one sensor's columns in a comment that begins with its word."""
    for _, _, text in block.header if word else []:
        if found := re.search(rf"(?<![\w]){re.escape(word)}\b\s*{dialect.delimiter or ' '}[^'\"]*", text):
            fields = dialect.split(found[0])
            if len(fields) == width:
                return fields
    return None


def table(name: str, names: list[str], rows: list[Row], **more: Any) -> Table:
    """Returns a table of rows; one of another width is its flaw."""
    width, flaw = len(names), ""
    for k, (number, fields) in enumerate(rows):
        if len(fields) != width:
            if len(fields) < width or any(fields[width:]):
                flaw = flaw or f"line {number}: expected {width} columns, found {len(fields)}: {' '.join(fields)[:60]}"
            rows[k] = number, [*fields, *[""] * width][:width]
    columns = [list(column) for column in zip(*(fields for _, fields in rows), strict=True)]
    return Table(name, names, columns, lines=[number for number, _ in rows], flaw=flaw, **more)


def tables(lines: Iterable[tuple[int, str]], dialect: Dialect, notes: list[str]) -> list[Table]:
    """Returns the tables of a text."""
    parts: dict[tuple[str, ...], tuple[str, list[Row], dict[str, Any]]] = {}
    for block in (found := blocks(lines, dialect, notes)):
        usual = Counter(len(f) for _, f in block.rows).most_common(1)[0][0]
        # Of several tables, the line above that names the sensor.
        titles = [text.strip("[]#:= ") for _, _, text in block.header if _TITLE.fullmatch(text) and sensor_of(text) and found[1:]]
        header = _header(block, usual, dialect)
        for word, rows in _apart(block, header["names"], header["named"]).items():
            width = Counter(len(f) for _, f in rows).most_common(1)[0][0]
            own = header if width == usual else _header(block, width, dialect)
            if names := _of_comment(block, word, width, dialect):
                own = {"names": names, "named": True}
            word = word or (titles[-1] if titles and own["named"] else "")
            key = (word, *own["names"], "" if own["named"] else str(len(parts)))
            if key in parts:
                parts[key][2]["restarts"].append(len(parts[key][1]))
                parts[key][1].extend(rows)
            else:
                parts[key] = word, rows, {**own, "settings": settings(block), "restarts": []}
    return [
        table(word or (f"line {rows[0][0]}" if len(parts) > 1 else ""), rows=rows, dialect=dialect, **more)
        for word, rows, more in parts.values()
    ]


def open_text(path: Path) -> IO[str]:
    """Opens a text file with arbitrary bytes."""
    with path.open("rb") as file:
        is_wide = file.read(2) in (b"\xff\xfe", b"\xfe\xff")
    if is_wide:
        return path.open(encoding="utf-16", errors="replace", newline="")
    return path.open(encoding="utf-8-sig", errors="surrogateescape", newline="")


def lines_of(file: IO[str]) -> Iterator[tuple[int, str]]:
    """Yields number and text of each line."""
    for number, line in enumerate(file, 1):
        # Cards are filled with zeros.
        line = line.strip("\0")
        if len(line) > LONGEST_LINE:
            raise Unreadable(f"line {number} without end; expected lines of text")
        yield number, line


def _labelled(lines: Iterable[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Yields lines such as `t:5 gx:0.1 gy:0.2 gz:0.3` as rows, under their labels."""
    names: list[str] = []
    for number, line in lines:
        pairs = [("time", before[0])] if (before := re.match(r"[\d.]+(?=[\s,;|])", line.strip())) else []
        pairs += _LABEL.findall(line)
        if len(pairs) > 2 and names != (names := [name.strip() for name, _ in pairs]):
            yield number, ",".join(names)
        yield number, ",".join(value for _, value in pairs)


def read_tables(path: Path, notes: list[str]) -> tuple[str, list[Table]]:
    """Returns the form of a text file, and its tables."""
    with open_text(path) as file:
        head = (whole_head := file.read(HEAD)).rstrip("\0")
        if not head.strip():
            raise Unreadable("it is empty")
        if "\0" in head:
            raise Unreadable("no text, and no recording that is known")
        whole = head.splitlines()[:-1] if len(whole_head) == HEAD else head.splitlines()
        if any(len(line) > LONGEST_LINE for line in whole) or not whole:
            raise Unreadable("a line without end; expected lines of text")
        if sum(len(_LABEL.findall(line)) > 2 for line in whole[:50]) > min(len(whole), 50) / 2:
            file.seek(0)
            found = tables(_labelled(lines_of(file)), Dialect(), notes)
            for table in found:
                # Its rows cannot be written again.
                table.lines = ()
            return "text with labels", found
        dialect = sniff(whole[:400])
        file.seek(0)
        if len(whole_head) == HEAD:
            first = tables(enumerate(whole, 1), dialect, more := [])
            if not more and len(first) == 1 and _at_once(file, first[0]):
                return dialect.name, first
            file.seek(0)
        return dialect.name, tables(lines_of(file), dialect, notes)


def _at_once(file: IO[str], one: Table) -> bool:
    """Reads the columns of numbers of a long and regular file into its table. Returns False for
    others, which are read line by line."""
    dialect, numbers = one.dialect, {k: one.dialect.plain_numbers(texts) for k, texts in enumerate(one.columns)}
    # Times of day, thousands, cells that are empty at first.
    is_odd = any(v is None and any(map(dialect.is_value, one.columns[k])) for k, v in numbers.items())
    if dialect.decimal == "," or one.name or one.flaw or one.restarts or is_odd:
        return False
    used = [k for k, values in numbers.items() if values is not None]
    whole = {k: all(text.lstrip("+-").isdecimal() for text in one.columns[k]) for k in used}
    form = [(str(k), np.int64 if whole[k] else np.float64) for k in used]
    rows = list(itertools.islice(file, one.lines[0] - 1, None))
    count = {line.count(dialect.delimiter) for line in rows} if dialect.delimiter else {0}
    if max(map(len, rows)) > LONGEST_LINE:
        return False
    try:
        data = np.loadtxt(rows, np.dtype(form), delimiter=dialect.delimiter, usecols=used, comments=None, ndmin=1)
    except (ValueError, OverflowError, IndexError):
        return False
    if len(count) > 1 or len(data) != len(rows) or not all(np.isfinite(data[str(k)]).all() for k in used):
        return False
    for k in used:
        one.columns[k] = data[str(k)]
    one.lines = range(one.lines[0], one.lines[0] + len(rows))
    return True
