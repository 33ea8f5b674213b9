"""From text to tables: the separators of a file, its headers, and which rows belong together.

A line is a row if most of its fields are numbers or times; what stands above the first row of a
table is its header. Which column is what, is decided in :mod:`twist_sync.tables`.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import IO

import numpy as np

from ._recording import Unreadable
from .tables import MISSING, MOMENT, Table, is_sensor, sensor_of, unit_of

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
_COMMENT = re.compile(r"\s*(#|%|//)+\s*")


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
        if "−" in line:
            line = line.replace("−", "-")
        if self.delimiter is None:
            return line.split()
        if '"' in line:
            return [f.strip() for f in next(csv.reader([line], delimiter=self.delimiter), [])]
        return [field.strip() for field in line.split(self.delimiter)]

    def plain(self, field: str) -> str:
        """Returns a number with a decimal point and without separators of thousands."""
        field = re.sub(r"[\u00a0\u202f']", "", field)
        if _THOUSANDS[self.decimal].fullmatch(field):
            field = field.replace("," if self.decimal == "." else ".", "")
        if self.decimal == ",":
            if "." in field:
                raise ValueError(f"{field[:40]!r} has a decimal point, other numbers have commas")
            field = field.replace(",", ".")
        if "_" in field:
            raise ValueError(f"could not convert {field[:40]!r}")
        return field

    def number(self, field: str) -> float:
        """Returns a number; NaN for one that is missing."""
        if self.decimal == "." and "_" not in field:
            try:
                return float(field)
            except ValueError:
                pass
        if field.lower() in MISSING:
            return np.nan
        plain = self.plain(field)
        try:
            return float(plain)
        except ValueError:
            raise ValueError(f"could not convert {field[:40]!r}") from None

    def is_value(self, field: str) -> bool:
        """Returns True for a number or a time."""
        if ":" in field:
            return MOMENT.fullmatch(field) is not None
        try:
            # NaN differs from itself.
            return (value := self.number(field)) == value
        except ValueError:
            return False

    def is_row(self, fields: list[str]) -> bool:
        """Returns True if most of the fields are numbers or times."""
        values = sum(map(self.is_value, fields))
        texts = sum(field.lower() not in MISSING for field in fields) - values
        return values >= 3 and values >= texts

    @property
    def name(self) -> str:
        between = {None: "white space", "\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars"}
        return f"text with {between[self.delimiter]}" + (
            ", decimal commas" if self.decimal == "," else ""
        )


_DIALECTS = [Dialect(*d) for d in (";.", ";,", "\t.", "\t,", ",.", ",,", "|.")]
_DIALECTS += [Dialect(None, "."), Dialect(None, ",")]


def sniff(lines: list[str]) -> Dialect:
    """Returns the dialect in which the most fields of the lines are numbers and the fewest words.

    Raises:
        Unreadable: No line has three numbers in any.
    """
    best, most = None, 0
    for one in _DIALECTS:
        # Unquoted, commas cannot be both.
        if one == Dialect(",", ",") and not any('","' in line for line in lines):
            continue
        score = 0
        for line in lines:
            fields = one.split(line)
            if one.is_row(fields):
                values = sum(map(one.is_value, fields))
                score += 3 * values - 2 * sum(field.lower() not in MISSING for field in fields)
        if score > most:
            best, most = one, score
    if best is None:
        shown = next((line.strip() for line in lines if line.strip()), "")[:60]
        raise Unreadable(f"no rows of samples: expected time and x, y, z, found {shown!r}")
    return best


@dataclass
class Block:
    """Rows with what stands above them: line numbers, fields and texts."""

    header: list[tuple[int, list[str], str]]
    rows: list[tuple[int, list[str]]]


def blocks(lines: Iterable[tuple[int, str]], dialect: Dialect, notes: list[str]) -> list[Block]:
    """Cuts a file where rows come under another header."""
    out: list[Block] = []
    above: list[tuple[int, list[str], str]] = []
    for number, line in lines:
        text = line.strip()
        if not text:
            continue
        comment = _COMMENT.match(text)
        fields = dialect.split(text[comment.end() :] if comment else line.strip("\r\n"))
        if comment or not dialect.is_row(fields):
            above.append((number, fields, text))
            continue
        width = len(_stripped(fields))
        names = [
            entry
            for entry in above
            if not _COMMENT.match(entry[2])
            and len(_stripped(entry[1])) in (width, width + 1)
            and sum(map(dialect.is_value, entry[1])) * 3 < len(entry[1])
        ]
        if not out or names:
            # Numbers in a header, such as the IDs of bodies.
            if out and len(out[-1].rows) < 3:
                short = out.pop()
                above = [*short.header, *((n, f, "") for n, f in short.rows), *above]
            out.append(Block(above, []))
        elif above:
            notes.append(_left_out(above))
        out[-1].rows.append((number, fields))
        above = []
    if above and out:
        notes.append(CUT if len(above) == 1 else _left_out(above))
    elif out and len(out[-1].rows) > 1:
        # A recorder that was stopped in the middle of its last line.
        (_, usual), (_, last) = out[-1].rows[-2:]
        is_short = len(last) < len(usual) and not above
        if is_short or any(
            dialect.is_value(a) and b.lower() not in MISSING and not dialect.is_value(b)
            for a, b in zip(usual, last, strict=False)
        ):
            out[-1].rows.pop()
            notes.append(CUT)
    return out


def _left_out(lines: list[tuple[int, list[str], str]]) -> str:
    number, _, text = lines[0]
    more = f" and {len(lines) - 1} more" if len(lines) > 1 else ""
    return f"line {number}{more}: {text[:40]!r} is no row: left out"


def _stripped(fields: list[str]) -> list[str]:
    end = len(fields)
    while end and not fields[end - 1]:
        end -= 1
    return fields[:end]


def _header(block: Block, width: int, dialect: Dialect) -> tuple[list[str], list[str], bool]:
    """Returns names and units of the columns, and True if they are those of the file.

    Rows of names above each other are joined, a name that spans columns is repeated, and a row of
    units is recognised by its units."""
    found: list[list[str]] = []
    for at, (_, fields, text) in enumerate(block.header, 1):
        if len(_stripped(fields)) < 2 and (at == len(block.header) or _COMMENT.match(text)):
            # Commas or tabs in the header alone.
            text = _COMMENT.sub("", text, count=1).strip("'\" ")
            fields = min(
                (Dialect(d).split(text) for d in (dialect.delimiter, ",", "\t", ";", None)),
                key=lambda some: abs(len(some) - width),
            )
        cells = [*fields, *[""] * (width - len(fields))]
        filled = [k for k, cell in enumerate(cells) if cell]
        numbers = sum(map(dialect.is_value, cells))
        if (
            len(_stripped(fields)) > width
            or len(filled) < 2
            or filled[-1] * 2 < width
            # The IDs of bodies are numbers; so are values of settings.
            or (numbers and numbers < len(filled) - 1)
        ):
            found.clear()
            continue
        found.append(cells)
    found = found[-LONGEST_HEADER:]
    units = [""] * width
    for row in found[1:]:
        if sum(bool(unit_of(c)) for c in row) * 2 > sum(map(bool, row)):
            units = row
            found.remove(row)
            break
    if not found:
        above = [len(_stripped(fields)) for _, fields, _ in block.header if len(fields) > 2]
        if above and dialect.delimiter == "," and above[-1] * 2 in (width, width + 1):
            raise Unreadable(
                f"line {block.rows[0][0]}: {width} columns, {above[-1]} names: numbers with decimal commas, between "
                "commas? Export them with semicolons or points"
            )
        return [str(k + 1) for k in range(width)], units, False
    for row in found[:-1]:
        for k in range(1, width):
            if not row[k] and row[k - 1] and found[-1][k]:
                row[k] = row[k - 1]
    names = []
    for column in zip(*found, strict=True):
        parts = dict.fromkeys(part for part in column if part)
        names.append(" ".join(parts))
    return names, units, True


def settings(block: Block) -> dict[str, str]:
    """Returns what the lines above a table set: `tscale,0.001`, `// Update Rate: 100.0Hz`, also in
    pairs of one line."""
    out: dict[str, str] = {}
    for k, (_, fields, text) in enumerate(block.header):
        fields = _stripped(fields)
        pairs = re.findall(r"([A-Za-z][\w ()/]*?)\s*[:=]\s*([+-]?[\d.][^\s,;]*)", text)
        if fields and len(fields) > 1:
            pairs += [
                (name.rstrip(": "), value)
                for name, value in zip(fields, fields[1:], strict=False)
                if name and (re.match(r"[+-]?[\d.]", value) or name == "Rotation Type")
            ]
        # A number alone under a word, as Vicon's: the rate.
        before = block.header[k - 1][1] if k else []
        if len(fields) == 1 and re.fullmatch(r"\d{1,5}(\.\d+)?", fields[0]) and len(_stripped(before)) == 1:
            pairs.append(("rate", fields[0]))
        for name, value in pairs:
            out.setdefault(name.strip().lower(), value)
    return out


def _apart(
    block: Block, names: list[str], named: bool
) -> list[tuple[str, list[tuple[int, list[str]]]]]:
    """Cuts rows of several sensors apart, by a column of words such as gyroscope and accelerometer
    or of few numbers under a name such as sensor: the word and its rows."""
    for k, name in enumerate(names):
        words = Counter(fields[k] for _, fields in block.rows if k < len(fields))
        if len(words) > MOST_SENSORS or not words:
            continue
        is_word = all(map(_text, words))
        if not (is_word and any(map(sensor_of, words))) and not (
            len(words) > 1
            and named
            and is_sensor(name)
            and (is_word or all(word.isdecimal() for word in words))
        ):
            continue
        out: dict[str, list[tuple[int, list[str]]]] = {}
        for row in block.rows:
            if k < len(row[1]):
                out.setdefault(row[1][k], []).append(row)
        return list(out.items())
    return [("", block.rows)]


def _text(field: str) -> bool:
    return re.match(r"[A-Za-z_/]", field) is not None and field.lower() not in MISSING


def tables(lines: Iterable[tuple[int, str]], dialect: Dialect, notes: list[str]) -> list[Table]:
    """Returns the tables of a text."""
    out: list[Table] = []
    for block in blocks(lines, dialect, notes):
        usual = Counter(len(f) for _, f in block.rows).most_common(1)[0][0]
        names, units, named = _header(block, usual, dialect)
        for word, rows in _apart(block, names, named):
            width = Counter(len(f) for _, f in rows).most_common(1)[0][0]
            own_names, own_units, is_named = names, units, named
            if own := _of_comment(block, word, width, dialect):
                own_names, own_units, is_named = own, [""] * width, True
            elif width != usual:
                own_names, own_units, is_named = _header(block, width, dialect)
            before = next((t for t in out if (t.name, t.names) == (word, own_names)), None)
            if before and is_named:
                before.restarts.append((len(before.rows), rows[0][0]))
                before.rows += rows
                continue
            table = Table(word, own_names, own_units, is_named, dialect=dialect, rows=rows)
            table.settings = settings(block)
            out.append(table)
    return out


def _of_comment(block: Block, word: str, width: int, dialect: Dialect) -> list[str] | None:
    """Returns the names of one sensor's columns in a comment that begins with its word."""
    for _, _, text in block.header if word else []:
        if found := re.search(rf"(?<![\w]){re.escape(word)}\b\s*{dialect.delimiter or ' '}[^'\"]*", text):
            fields = dialect.split(found[0])
            if len(fields) == width:
                return fields
    return None


def open_text(path: Path) -> IO[str]:
    """Opens a text file with arbitrary bytes."""
    with path.open("rb") as file:
        first = file.read(2)
    wide = first in (b"\xff\xfe", b"\xfe\xff")
    if wide:
        return path.open(encoding="utf-16", errors="replace", newline="")
    return path.open(encoding="utf-8-sig", errors="surrogateescape", newline="")


def lines_of(file: IO[str]) -> Iterator[tuple[int, str]]:
    """Yields number and text of each line."""
    for number, line in enumerate(file, 1):
        if len(line) > LONGEST_LINE:
            raise Unreadable(f"line {number} without end; expected lines of text")
        yield number, line


def read_tables(path: Path, notes: list[str]) -> tuple[str, list[Table]]:
    """Returns the form of a text file, and its tables."""
    with open_text(path) as file:
        head = file.read(HEAD)
    if not head.strip():
        raise Unreadable("it is empty")
    if "\0" in head:
        raise Unreadable("no text, and no recording that is known")
    whole = head.splitlines()[:-1] if len(head) == HEAD else head.splitlines()
    if any(len(line) > LONGEST_LINE for line in whole) or not whole:
        raise Unreadable("a line without end; expected lines of text")
    dialect = sniff(whole[:400])
    found = tables(enumerate(whole, 1), dialect, more := [])
    if len(found) == 1 and not more and not found[0].restarts and _read_at_once(path, found[0]):
        return dialect.name, found
    with open_text(path) as file:
        return dialect.name, tables(lines_of(file), dialect, notes)


def _read_at_once(path: Path, table: Table) -> bool:
    """Reads a regular file at once: the columns of numbers of its one table. Returns False for
    others, which are read line by line."""
    dialect: Dialect = table.dialect
    width = len(table.names)
    first = table.rows[0]
    used = [k for k in range(width) if all(k < len(f) and _is_number(dialect, f[k]) for _, f in table.rows[:99])]
    if any(len(fields) != width for _, fields in table.rows):
        return False
    others = [k for k in range(width) if k not in used]
    # Times of day, thousands, cells that are empty at first.
    if table.name or any(dialect.is_value(f[k]) for k in others for _, f in table.rows):
        return False
    form = [
        (f"c{k}", np.int64 if all(f[k].lstrip("+-").isdecimal() for _, f in table.rows) else np.float64)
        for k in used
    ]
    with open_text(path) as file, warnings.catch_warnings():
        # NumPy 1.24 cuts the fraction off where later ones refuse, and warns.
        warnings.simplefilter("error", DeprecationWarning)
        for _ in range(first[0] - 1):
            file.readline()
        lines = (_checked(line, width, dialect) for line in file)
        try:
            data = np.loadtxt(
                lines, np.dtype(form), delimiter=dialect.delimiter, usecols=used, quotechar='"', comments=None, ndmin=1
            )
        except (ValueError, OverflowError, DeprecationWarning, IndexError):
            return False
    if any(not np.isfinite(data[name]).all() for name, _ in form):
        return False
    table.data = {k: data[f"c{k}"] for k in used}
    table.lines_from = first[0]
    table.rows = []
    return True


def _checked(line: str, width: int, dialect: Dialect) -> str:
    """Returns a line as numpy reads it."""
    if "−" in line:
        line = line.replace("−", "-")
    if dialect.decimal == ",":
        if "." in line:
            raise ValueError("a point among commas")
        line = line.replace(",", ".")
    if dialect.delimiter and line.count(dialect.delimiter) != width - 1 and '"' not in line and line.strip():
        raise ValueError("of another width")
    return line


def _is_number(dialect: Dialect, field: str) -> bool:
    try:
        return float(dialect.plain(field)) == float(field.replace(",", ".") if dialect.decimal == "," else field)
    except ValueError:
        return False
