"""Tables of named columns, and what their names say: unit, kind, axis."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import rules
from ._recording import Unreadable

_KINDS = [(kind, re.compile(rf"(?<![^\W_])(?:{words})(?![^\W_])")) for kind, words in rules.KINDS]
Unit = tuple[str, str]
#: Letters of units, also those of Windows' code page 1252.
_LETTERS = str.maketrans("µμ²⁻¹−\udcb0\udcb5\udcb2", "uu2-1-°u2")


def unit_of(text: str) -> Unit | None:
    """Returns what a unit measures, and the unit, after a factor if it has one."""
    plain = re.sub(r"[\s^*·()\[\]{}_]", "", text.lower()).translate(_LETTERS)
    factor, plain = re.fullmatch(r"(10-\d|\d+(?:\.\d+)?(?:e-?\d+)?|)(.*)", plain).groups()  # type: ignore[union-attr]
    found = next(((what, unit) for what, unit, form in rules.UNITS if re.fullmatch(form, plain)), None)
    return (found[0], f"{factor.replace('10-', '1e-')} {found[1]}") if found and factor else found


def words_of(name: str) -> list[str]:
    """Splits a column's name into lower-case words: `gyroRotationX` is gyro, rotation, x and
    `gyro_rad[0]` is gyro, rad, 0."""
    return re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())


def split_unit(name: str, unit: str = "") -> tuple[list[str], Unit | None]:
    """Returns the words of a column's name without its unit, and the unit: of the row of units, in
    brackets, or the last words of the name, or of time the first one, as in `seconds_elapsed`."""
    found = unit_of(unit) if unit else None
    for inside in re.findall(r"[\[({]([^\[({})\]]*(?:\([^()]*\)[^\[({})\]]*)?)[\])}]", name):
        if (of_name := unit_of(inside)) or len(words_of(inside)) > 1:
            name, found = name.replace(inside, " "), found or of_name
    words = words_of(name)
    for count in (3, 2, 1):
        end = words[-count:]
        of_end = unit_of("/".join(end)) or unit_of("".join(end)) if len(words) > count else None
        # One letter is an axis or a sensor more often than a unit.
        if not found and of_end and of_end[0] in ("rate", "time", "angle") and end != ["d"]:
            return (words[:-count] if of_end[0] != "time" else words), of_end
    of_begin = unit_of(words[0]) if words and len(words[0]) > (4 if len(words) > 1 else 1) else None
    return words, found or (of_begin if of_begin and of_begin[0] == "time" else None)


def kind_of(words: Sequence[str]) -> str | None:
    """Returns what the words say is measured: one of `rules.KINDS`."""
    text = " ".join(words)
    return next((kind for kind, form in _KINDS if form.search(text)), None)


def sensor_of(word: str) -> str | None:
    """Returns what a sensor of this name measures, if a word of it says so."""
    kind = kind_of(words_of(word)) if len(word) > 2 else None
    return kind if kind in ("rate", "acceleration", "magnetic", "orientation") else None


def is_sensor(name: str) -> bool:
    """Returns True for the name of a column that tells sensors apart."""
    return rules.SENSOR.fullmatch(" ".join(words_of(name))) is not None


def axis_of(name: str, words: list[str]) -> tuple[str, list[str]] | None:
    """Returns the axis or element that a name ends with, and its other words."""
    if of_rows := re.search(r"\brot\[([0-8])\]", name.lower()):
        # Column by column, as Qualisys writes them.
        return f"{int(of_rows[1]) % 3}{int(of_rows[1]) // 3}", ["matrix"]
    if of_cells := re.search(r"\b(?:mat\w*|rot\w*|r)\[(\d)\]\[(\d)\]", name.lower()):
        return of_cells[1] + of_cells[2], ["matrix"]
    for at in range(len(words) - 1, -1, -1):
        if found := rules.AXES.fullmatch(words[at]):
            more = [word for word in (found[1], found[3], found[5]) if word]
            if not found[3] or kind_of([*words[:at], *more]) == "rate":
                return found[2] or found[4], [*words[:at], *more, *words[at + 1 :]]
    for at, word in enumerate(words):
        others = words[:at], words[at + 1 :]
        if found := re.fullmatch(rf"({'|'.join(rules.SPOKEN)})(speed|rate)?", word):
            return rules.SPOKEN[found[1]], [*others[0], "rate" if found[2] else "spoken", *others[1]]
        if word in rules.QUATERNION and at and re.fullmatch(r"q|quat\w*", words[at - 1]):
            return rules.QUATERNION[word], words[:at]
        if found := re.fullmatch(r"(?:r|rot|m|mat|t|pose)([0-3])([0-3t])", "".join(words[max(at - 1, 0) : at + 1]) if word.isdecimal() else word):
            return found[1] + found[2], [*others[0], "matrix", *others[1]]
    if words and (found := re.fullmatch(r"(\D*)([0-4])", words[-1])) and (len(words) > 1 or found[1]):
        return found[2], [*words[:-1], *filter(None, [found[1]])]
    return None


@dataclass
class Group:
    """Columns that are one quantity: three axes, w, x, y, z or the nine of a matrix."""

    stem: str
    columns: list[int]
    kind: str | None
    unit: Unit | None = None
    named: bool = True


@dataclass
class Table:
    """Rows of one sensor.

    Attributes:
        name: Of the sensor, topic, sheet or array; empty if the file has but one.
        names: Of the columns.
        columns: Fields of each as they are written, or arrays of numbers or of times.
        units: Of the columns, from a row of units; empty where there is none.
        named: True if the names are those of the file.
        lines: Numbers of the rows' lines in a text.
        restarts: Rows before which the header is repeated.
        settings: What the file says above the table.
        dialect: How numbers of a text are written.
        flaw: A row of another width, in words.
        misnamed: Names that are more or fewer than the columns, in words.
    """

    name: str
    names: list[str]
    columns: list[Any]
    units: list[str] = field(default_factory=list)
    named: bool = True
    lines: Sequence[int] = ()
    restarts: list[int] = field(default_factory=list)
    settings: dict[str, str] = field(default_factory=dict)
    dialect: Any = None
    flaw: str = ""
    misnamed: str = ""

    def __post_init__(self) -> None:
        self.units = self.units or [""] * len(self.names)

    def __len__(self) -> int:
        return max((len(c) for c in self.columns if not self.lines or len(c) == len(self.lines)), default=0)

    def line(self, row: int) -> str:
        """Returns the place of a row in words."""
        return f"line {self.lines[row]}" if self.lines else f"row {row + 1}"

    def is_text(self, column: int) -> bool:
        """Returns True if the column's fields are as they are written."""
        return isinstance(self.columns[column], list)

    def numbers(self, column: int) -> np.ndarray:
        """Returns a column as floats; NaN where there is none."""
        if not self.is_text(column):
            return self.columns[column].astype(float)
        if self.flaw:
            raise Unreadable(self.flaw)
        texts = self.columns[column]
        out = self.dialect.plain_numbers(texts)
        if out is not None:
            return out
        out = np.empty(len(texts))
        for row, text in enumerate(texts):
            try:
                out[row] = self.dialect.number(text)
            except ValueError as error:
                raise Unreadable(f"{self.line(row)}, column {self.names[column]!r}: {error}") from None
        return out

    def is_numeric(self, column: int) -> bool:
        """Returns True if the first fields of a column are numbers, or missing."""
        if not self.is_text(column):
            return self.columns[column].dtype.kind in "iuf"
        try:
            return any(self.dialect.number(text) == self.dialect.number(text) for text in self.columns[column][:50])
        except ValueError:
            return False

    def array(self, group: Group) -> np.ndarray:
        """Returns the columns of a group, shape (n, columns)."""
        return np.column_stack([self.numbers(k) for k in group.columns])

    def named_as(self, columns: Sequence[int]) -> str:
        """Returns the names of columns."""
        return ", ".join(self.names[k] for k in columns)

    def label(self, group: Group) -> str:
        """Returns the name by which a group can be chosen."""
        return " ".join(filter(None, [self.name, group.stem])) or self.named_as(group.columns)


def table_of(name: str, columns: dict[str, Any], **more: Any) -> Table:
    """Returns a table of arrays; those with rows of several numbers become columns x, y, z, or
    rotation matrices."""
    out: dict[str, np.ndarray] = {}
    for own, values in columns.items():
        array = np.asarray(values)
        ends = [str(k + 1) for k in range(array.shape[1])] if array.ndim == 2 else [""]
        if array.ndim == 3 and array.shape[1:] in ((3, 3), (4, 4)):
            ends = [f"m{r}{c}" for r in range(3) for c in range(3)]
            array = array[:, :3, :3]
        elif array.ndim == 2 and array.shape[1] == 3:
            ends = list("xyz")
        array = array.reshape(len(array), -1)
        out |= {f"{own} {end}".strip(): array[:, k] for k, end in enumerate(ends)}
    return Table(name, list(out), list(out.values()), **more)


def groups(table: Table) -> list[Group]:
    """Returns the groups of a table's columns."""
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(table.names):
        words, unit = split_unit(name, table.units[column])
        axis = axis_of(name, words) if not unit or unit[0] != "time" else None
        if axis:
            stem, more = " ".join(axis[1]), 1
            # A second sensor of the same names.
            while axis[0] in found.get(stem, {}):
                more += 1
                stem = f"{' '.join(axis[1])} {more}"
            found.setdefault(stem, {})[axis[0]] = column
    out = []
    for stem, axes in found.items():
        first = int("matrix" in stem and not any("0" in axis for axis in axes))
        forms = [[f"{r + first}{c + first}" for r in range(3) for c in range(3)], "wxyz", "xyz"]
        form = next((form for form in forms if all(axis in axes for axis in form)), None)
        # Numbers instead of axes, of what a word names.
        kind = "rate" if stem == "xyz" else kind_of([*words_of(table.name), *stem.split()])
        numbered = {"rate": ("012", "123"), "orientation": ("0123",)}.get(kind or "", ())
        form = form or next((form for form in numbered if sorted(axes) == list(form)), None)
        if form:
            out.append(_group(table, stem, [axes[axis] for axis in form]))
    # Three columns of rates whose names have no axis, such as p, q, r.
    units = [split_unit(name, unit) for name, unit in zip(table.names, table.units, strict=True)]
    rest = [k for k, (words, unit) in enumerate(units) if unit and unit[0] == "rate" and kind_of(words) != "other"]
    if len(rest) == 3 and not any(set(group.columns) & set(rest) for group in out):
        out.append(_group(table, "", rest))
    return out or ([] if table.named or table.misnamed else _unnamed(table))


def _group(table: Table, stem: str, columns: list[int]) -> Group:
    units = {split_unit(table.names[k], table.units[k])[1] for k in columns}
    words = [*words_of(table.name), *stem.split()]
    kind = kind_of(words)
    if "spoken" in words and kind != "rate":
        kind = "angles"
    if len(columns) > 3:
        return Group(stem, columns, "orientation" if kind != "other" else kind, None, table.named)
    if len(units) > 1 and kind in ("rate", None):
        raise Unreadable(f"the columns {table.named_as(columns)} are not of one unit")
    unit = units.pop() if len(units) == 1 else None
    what = unit[0] if unit else ""
    if unit and what == "angle" and kind == "rate":
        unit = ("rate", {"deg": "deg/s", "rad": "rad/s"}[unit[1]])
    elif what in ("acceleration", "other"):
        kind = kind if kind in ("acceleration", "magnetic", "position") else "other"
    elif what == "rate":
        kind = kind if kind in ("other", "acceleration", "magnetic") else "rate"
    elif what == "angle" or kind == "orientation":
        kind = "angles"
    return Group(stem, columns, kind, unit, table.named)


def _unnamed(table: Table) -> list[Group]:
    """Returns what the values of columns without names say: three that remain beside the times,
    or of more than three those that gravity's size does not give away."""
    times = unnamed_times(table)
    rest = [k for k in range(len(table.names)) if k not in times and table.is_numeric(k)]
    if len(rest) == 3:
        return [Group("", rest, kind_of(words_of(table.name)), None, False)]
    if len(rest) not in (6, 9) or not times:
        return []
    triples = [Group(f"columns {rest[k] + 1}", rest[k : k + 3], None, None, False) for k in range(0, len(rest), 3)]
    free = [g for g in triples if not not_rates(table.array(g))]
    return free if len(free) == 1 else []


def rising(table: Table) -> list[int]:
    """Returns columns that rise as times do, the most even first."""
    found = []
    for k in range(len(table.names)):
        if table.is_text(k) and rules.MOMENT.fullmatch(table.columns[k][0]):
            found.append((-1.0, k))
        elif table.is_numeric(k):
            steps = np.diff(table.numbers(k))
            if not len(steps):
                return [int(np.argmax([abs(table.numbers(c)[0]) for c in range(len(table.names))]))]
            usual = float(np.median(steps))
            # A counter may wrap; rates of a slow motion may rise too, but not by even steps.
            if np.mean(steps >= 0) > 0.99 and np.mean(steps > 0) > 0.5 and usual > 0:
                found.append((float(np.median(np.abs(steps - usual)) / usual), k))
    return [k for _, k in sorted(found)]


def gravity(w: np.ndarray) -> str | None:
    """Returns in words that three columns are as large as gravity, if they are."""
    size = np.linalg.norm(w[np.isfinite(w).all(axis=1)], axis=1)
    low, usual, high = np.quantile(size, (0.1, 0.5, 0.9)) if len(size) > 7 else (0.0, 0.0, 0.0)
    for one, unit in ((9.81, "m/s²"), (1.0, "g"), (1000.0, "mg")):
        if abs(usual / one - 1) < 0.1 and high - low < 0.8 * usual:
            return f"their size is that of gravity, {usual:.3g} {unit}"
    return None


def unnamed_times(table: Table) -> list[int]:
    """Returns columns of times without names, the best first: a clock of the sensor, a date, which
    a logger adds, a count of the rows."""
    found = rising(table)
    dates = [k for k in found if not table.is_numeric(k)]
    counts = [k for k in found if k not in dates and set(np.diff(table.numbers(k))) == {1.0}]
    return [*[k for k in found if k not in (*dates, *counts)][:1], *dates, *counts]


def not_rates(w: np.ndarray) -> str | None:
    """Returns why three columns that nothing names are not those of a moved gyroscope, if so."""
    w = w[np.isfinite(w).all(axis=1)]
    if len(w) < 8:
        return None
    if reason := gravity(w):
        return reason
    low, usual, high = np.quantile(np.linalg.norm(w, axis=1), (0.1, 0.5, 0.9))
    if usual and high - low < 0.2 * usual:
        return f"their size hardly changes ({usual:.3g})"
    middle = np.median(w, axis=0)
    moving = float(np.sqrt(np.mean(np.sum((w - middle) ** 2, axis=1))))
    if np.linalg.norm(middle) > 1.5 * moving > 0:
        return "they have a constant part that is larger than what changes, as positions and accelerations have"
    return None
