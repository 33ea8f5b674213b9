"""From tables of columns to a recording: which column is what, and what its times are.

Each reader makes tables of named columns; this page decides by rules, in this order:

1. ``KINDS`` and ``UNITS``: what a column measures, by the words of its name and by its unit.
2. Columns of one name but for the axis are a group: three axes, a quaternion, a matrix.
3. A group is rates by its name or unit; without either by its size; else orientations are turned
   into rates.
4. ``TIMES``: of several columns of times the sensor's own precedes that of its arrival.
5. Counters that wrap go on, a clock that starts again is refused with its line.

A layout that is not read yet: add its words to one of these, or its columns to ``UNNAMED`` if it
has no names, and a row to ``tests/layouts.py``.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from . import orientation
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
#: The same of units that files name and no option does.
_MORE_TIME = {**TIME_UNITS, "0.1 ms": 10**5, "min": 60 * 10**9, "h": 3600 * 10**9, "days": 86400 * 10**9}

#: Quantity and name of a unit, and its spelling without spaces, signs of powers and
#: products.
UNITS = (
    ("rate", "rad/s", r"rad(ian)?s?(/s|s-1|ps|persec)(ec|econds?)?"),
    ("rate", "mrad/s", r"mrad(/s|s-1)(ec)?"),
    ("rate", "deg/s", r"(deg|degrees?|°|º|d)(/s|s-1|ps|s|persec)(ec|econds?)?"),
    ("rate", "mdps", r"m(illi)?d(eg)?(/s|ps)"),
    ("rate", "rpm", r"rpm|rev/min"),
    ("time", "s", r"s|secs?|seconds?"),
    ("time", "ms", r"ms|msecs?|millis(ec(ond)?s?)?|milliseconds?"),
    ("time", "us", r"us|usecs?|micros(ec(ond)?s?)?|microseconds?"),
    ("time", "ns", r"ns|nsecs?|nanos(ec(ond)?s?)?|nanoseconds?"),
    ("time", "min", r"min|minutes"),
    ("time", "h", r"h|hours"),
    ("time", "days", r"days"),
    ("angle", "rad", r"rad(ian)?s?"),
    ("angle", "deg", r"deg|degrees?|°|º"),
    ("acceleration", "", r"m/?/?s(ec)?-?2|m/s/s|m?g|mss|gs"),
    ("other", "", r"[umn]?t(esla)?|m?gauss|ga|m|mm|cm|met(er|re)s?|°?c|degc|h?pa|k|v|m?v|hz|m/s|a\.?u\.?|lx|%"),
)  # fmt: skip

#: Quantity of a group of columns, by words of its name and of its table's; the first wins.
KINDS = (
    (
        "other",
        r"bias|cov(ariance)?|variance|std|setpoint|desired|target|integral|delta|error|residual|noise|temp"
        r"|unfilt|offset|velocity increment|angular (accel\w*|position|displacement)|b w|dq|dv|mean|max|min",
    ),
    (
        "rate",
        r"\w*gyr\w*|giros?c\w*|angular ?(vel\w*|rates?)|angularvel\w*|ang ?vel\w*|vel ang|omega|rotation ?rates?|rot ?rate"
        r"|rates?|w|av|alpha|rollspeed|pitchspeed|yawspeed|as|(body )?rates?|turn ?rates?|g",
    ),
    ("orientation", r"\w*quat\w*|q|orient\w*|rotation|rot|pose|attitude|rotmat|matrix|r|game rotation vector"),
    ("acceleration", r"\w*acc\w*|beschl\w*|gravity|linear|user|specific force|gf|g ?f|a|lin|baro|lowg|highg"),
    ("magnetic", r"\w*mag\w*|compass|m|b|\w*field"),
    ("angles", r"euler|roll|pitch|yaw|angles?|heading"),
    ("position", r"pos\w*|translation|p|t|location|velocity|vel|v|speed|gps|lat|lon|marker"),
)  # fmt: skip
_KINDS = [(kind, re.compile(rf"(?<![^\W_])(?:{words})(?![^\W_])")) for kind, words in KINDS]

#: Rank of a column of times by words of its name: the clock that stamped the sample first.
TIMES = (
    (9, r"phone|host|arriv\w*|received?|rx|pc|app|logging|log time|publish|saved|system|computer|date|week"),
    (0, r"header ?stamp|sensor|hw|hardware|device|sample|cts|since ?reboot|boot"),
    (1, r"time ?stamps?|stamp|time|timens|timeus|timems|gpst|tow|zeit|temps|tiempo|tempo|ticks?|clock|t"),
    (2, r"ts|elapsed|epoch|unix|utc|uptime|nanos\w*|micros|millis|ns|us|ms|nsec|usec|msec"),
    (3, r"secs?|seconds?|s|since"),
)  # fmt: skip
_TIMES = [(rank, re.compile(rf"(?<![^\W_])(?:{words})(?![^\W_])")) for rank, words in TIMES]
#: Durations, which are times of no clock.
_DURATION = re.compile(r"\b(dt|duration|exposure|latency|interval|period|offset|delay|gps accuracy)\b")
_COUNTER = re.compile(r"\b(packet ?counter|counter|count|sample ?(no|number|count\w*)?|index|frame|seq|f|row|n)\b")
#: A column that tells sensors or bodies apart.
_SENSOR = re.compile(r"(sensor|device|dev|node|imu|unit|instance|type|name|topic|id|i|addr\w*|mac|body|source|location)"
                     r"( ?(id|no|nr|num|number|index|instance|type|name))?")  # fmt: skip

#: Columns of files without names, by their number; "" is a column of words. Orientations are
#: taken if their size is that of one, and rates by what remains.
UNNAMED = {
    # rosidl_runtime_py message_to_csv of sensor_msgs/Imu.
    40: "sec nanosec frame orientation.x orientation.y orientation.z orientation.w".split()
    + [f"orientation_covariance {k}" for k in range(9)]
    + [f"angular_velocity.{k} (rad/s)" for k in "xyz"]
    + [f"angular_velocity_covariance {k}" for k in range(9)]
    + [f"linear_acceleration.{k}" for k in "xyz"]
    + [f"linear_acceleration_covariance {k}" for k in range(9)],
    # TUM's trajectories: <https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats>.
    8: "timestamp tx ty tz qx qy qz qw".split(),
    # ARKit Data Logger: <https://github.com/PyojinKim/ARKit-Data-Logger>.
    13: ["timestamp", *(f"r{r}{c}" for r in range(3) for c in "012t")],
    # Poses of KITTI's odometry: rows of a matrix (3, 4).
    12: [f"r{r}{c}" for r in range(3) for c in "012t"],
}

#: Units of makers that write none: columns, what is set above them, unit of the rates.
MAKERS = (
    ("MT Manager", {"packetcounter", "gyr_x"}, {"update rate"}, "rad/s"),
    ("Xsens DOT", {"sampletimefine", "gyr_x"}, set(), "deg/s"),
    ("Sensor Logger", {"seconds_elapsed", "x", "y", "z"}, set(), "rad/s"),
    ("Physics Toolbox", {"time", "wx", "wy", "wz"}, set(), "rad/s"),
    ("Stray Scanner", {"timestamp", "alpha_x", "alpha_y", "alpha_z"}, set(), "rad/s"),
    ("ArduPilot", {"timeus", "gyrx", "gyry", "gyrz"}, set(), "rad/s"),
    ("Betaflight", {"loopiteration", "gyroadc[0]"}, set(), "deg/s"),
    ("RealSense", {"hw timestamp (ms)", "3dof_x"}, set(), "rad/s"),
    ("ROS", {"field.angular_velocity.x"}, set(), "rad/s"),
    ("ROS", {"angular_velocity.x", "header.stamp.secs"}, set(), "rad/s"),
    ("ROS", {"angular_velocity.x", "header.stamp.sec"}, set(), "rad/s"),
)

#: Longest distance of a gyroscope's samples by which a unit is found, and the shortest, s.
LONGEST_STEP_S, SHORTEST_STEP_S = 0.2, 1e-4
#: Nine of ten samples of a moved body turn slower than this, rad/s (20 rad/s are 3 turns a second).
FASTEST = 20.0
#: A body that is swung turns by less before it turns back, rad.
LONGEST_SWING = 2 * np.pi
#: Share of samples that may have the time of the one before.
MOST_REPEATED = 0.2
#: Samples in a row that one step of a counter may have skipped.
MOST_SKIPPED = 200
#: Where counters of 16, 24, 32 bits wrap, also of µs given in ms or s, and times of a day or week.
MODULI = [2.0**bits / part for bits in (16, 24, 32) for part in (1, 1e3, 1e6, 32768)] + [
    period * unit for period in (3600, 86400, 604800) for unit in (1, 1e3, 1e6, 1e9)
]

_EPOCH = datetime.date(1970, 1, 1)
MOMENT = re.compile(
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)|(?P<a>\d\d?)[-/.](?P<b>\d\d?)[-/.](?P<y2>\d{4}))?[T ,_]*"
    r"(?P<clock>\d{1,3}(?::\d\d){1,2})(?:[.,:](?P<f>\d{1,12}))?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?"
)


def moment(text: str) -> int:
    """Returns nanoseconds of a date and time since 1970, of UTC unless a zone is given, or of a
    time alone, which may be minutes and seconds, since its zero."""
    found = MOMENT.fullmatch(text.strip())
    if not found:
        raise ValueError(f"could not read {text[:40]!r} as a time")
    one = found.groupdict()
    parts = [int(part) for part in one["clock"].split(":")]
    dated = one["y"] or one["y2"]
    if len(parts) == 2:
        parts = [*parts, 0] if dated else [0, *parts]
    if one["half"]:
        parts[0] = parts[0] % 12 + 12 * (one["half"][0] in "pP")
    whole = parts[0] * 3600 + parts[1] * 60 + parts[2]
    if dated:
        month, day = (one["m"], one["d"]) if one["y"] else (one["b"], one["a"])
        if int(month) > 12:
            month, day = day, month
        days = datetime.date(int(dated), int(month), int(day)).toordinal() - _EPOCH.toordinal()
        whole += days * 86400
    if one["zone"] and one["zone"][0] in "+-":
        away = int(one["zone"][1:3]) * 3600 + int(one["zone"][-2:]) * 60
        whole -= away if one["zone"][0] == "+" else -away
    return whole * 10**9 + int((one["f"] or "0")[:9].ljust(9, "0"))


def unit_of(text: str) -> tuple[str, str] | None:
    """Returns what a unit measures, and the unit."""
    plain = re.sub(r"[\s^*·()\[\]{}_]|(?<=s)\*\*", "", text.strip().lower())
    plain = plain.replace("µ", "u").replace("μ", "u").replace("²", "2").replace("⁻", "-")
    plain = plain.replace("¹", "1").replace("−", "-")
    return next(((what, unit) for what, unit, form in UNITS if re.fullmatch(form, plain)), None)


def is_unit(text: str) -> bool:
    """Returns True for what ``--unit`` takes."""
    rates = "|".join(RATE_UNITS)
    number = r"(\d+(\.\d*)?(e-?\d+)?)?"
    return re.fullmatch(rf"{number} *({rates})|(deg|rad):[XYZxyz]{{3}}|world-to-body", text) is not None


def words_of(name: str) -> list[str]:
    """Splits a column's name into lower-case words: `gyroRotationX` is gyro, rotation, x and
    `gyro_rad[0]` is gyro, rad, x."""
    name = re.sub(r"\[([012])\]", lambda m: f" {'xyz'[int(m[1])]} ", name)
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return re.findall(r"[^\W_]+", name.lower())


def split_unit(name: str, unit: str) -> tuple[list[str], tuple[str, str] | None]:
    """Returns the words of a column's name without its unit, and the unit: of the row of units, in
    brackets, or the last words of the name."""
    found = unit_of(unit) if unit else None
    for inside in re.findall(r"[\[({]([^\[({})\]]*(?:\([^()]*\)[^\[({})\]]*)?)[\])}]", name):
        if (of_name := unit_of(inside)) or len(words_of(inside)) > 1:
            name = name.replace(inside, " ")
            found = found or of_name
    words = words_of(name)
    for count in (3, 2, 1):
        end = words[-count:]
        of_end = unit_of("/".join(end)) or unit_of("".join(end)) if len(words) > count else None
        # One letter is an axis or a sensor more often than a unit.
        if not found and of_end and (of_end[0] in ("rate", "time", "angle")) and end != ["d"]:
            return (words[:-count] if of_end[0] != "time" else words), of_end
    return words, found


def kind_of(words: Sequence[str]) -> str | None:
    """Returns what the words say is measured: one of `KINDS`."""
    text = " ".join(words)
    return next((kind for kind, form in _KINDS if form.search(text)), None)


def sensor_of(word: str) -> str | None:
    """Returns what a sensor of this name measures, if a word of it says so."""
    kind = kind_of(words_of(word))
    is_clear = len(word) > 2 and kind in ("rate", "acceleration", "magnetic", "orientation")
    return kind if is_clear else None


def is_sensor(name: str) -> bool:
    """Returns True for the name of a column that tells sensors apart."""
    return _SENSOR.fullmatch(" ".join(words_of(name))) is not None


_AXIS = re.compile(
    r"(w|g|gf|gyro|gyr|omega|om|rot|rate|angvel|av|as|a|f|m|acc|accel|mag|ang|angle|q|quat|r|p|t|v|b|d|e|)([xyzw])"
    r"|([xyz])(gyro|gyr|acc|accel|mag|angvel|rate)"
)
_SPOKEN = {"roll": "x", "pitch": "y", "yaw": "z", "beta": "x", "gamma": "y", "alpha": "z"}


def _axis(words: list[str]) -> tuple[str, list[str]] | None:
    """Returns the axis that a name ends with, and its other words."""
    for at in range(len(words) - 1, -1, -1):
        if found := _AXIS.fullmatch(words[at]):
            before = found[1] if found[2] else found[4]
            return found[2] or found[3], [*words[:at], *filter(None, [before]), *words[at + 1 :]]
    for at, word in enumerate(words):
        spoken = re.fullmatch(r"(roll|pitch|yaw|alpha|beta|gamma)(speed|rate)?", word)
        if spoken:
            rest = ["rate"] if spoken[2] else ["spoken"]
            return _SPOKEN[spoken[1]], [*words[:at], *rest, *words[at + 1 :]]
        if found := re.fullmatch(r"(q|quat|quaternion)([0-3])", word):
            return "wxyz"[int(found[2])], [*words[:at], "quat", *words[at + 1 :]]
        if found := re.fullmatch(r"(?:r|rot|m|mat)([0-3])([0-3t])", word):
            return found[1] + found[2], [*words[:at], "matrix", *words[at + 1 :]]
    return None


@dataclass
class Group:
    """Columns that are one quantity: three axes, w, x, y, z or the nine of a matrix."""

    stem: str
    columns: list[int]
    kind: str | None
    unit: tuple[str, str] | None
    named: bool


@dataclass
class Table:
    """Rows of one sensor.

    Attributes:
        name: Of the sensor, topic, sheet or array; empty if the file has but one.
        names: Of the columns.
        units: Of the columns, from a row of units; empty where there is none.
        named: True if the names are those of the file.
        data: Columns as arrays, of those that are not in `rows`.
        rows: Line numbers and fields of a text.
        restarts: Rows before which the header is repeated, with the line of that row.
        settings: What the file says above the table.
    """

    name: str
    names: list[str]
    units: list[str]
    named: bool = True
    data: dict[int, np.ndarray] = field(default_factory=dict)
    rows: list[tuple[int, list[str]]] = field(default_factory=list)
    restarts: list[tuple[int, int]] = field(default_factory=list)
    settings: dict[str, str] = field(default_factory=dict)
    dialect: Any = None
    lines_from: int = 0

    def __len__(self) -> int:
        return len(self.rows) or max((len(a) for a in self.data.values()), default=0)

    def line(self, row: int) -> str:
        """Returns the place of a row in words."""
        return f"line {self.number(row)}" if self.rows or self.lines_from else f"row {row + 1}"

    def number(self, row: int) -> int:
        """Returns the line of a row."""
        return self.rows[row][0] if self.rows else row + self.lines_from

    def texts(self, column: int) -> list[str]:
        """Returns the fields of a column of a text."""
        out = []
        for number, fields in self.rows:
            if column >= len(fields) or any(fields[len(self.names) :]):
                shown = " ".join(fields)[:60]
                raise Unreadable(
                    f"line {number}: expected {len(self.names)} columns, found {len(fields)}: {shown}"
                )
            out.append(fields[column])
        return out

    def numbers(self, column: int) -> np.ndarray:
        """Returns a column as floats; NaN where there is none."""
        if column not in self.data:
            texts = self.texts(column)
            out = np.empty(len(texts))
            for row, text in enumerate(texts):
                try:
                    out[row] = self.dialect.number(text)
                except ValueError as error:
                    where = f"{self.line(row)}, column {self.names[column]!r}"
                    raise Unreadable(f"{where}: {error}") from None
            return out
        return self.data[column].astype(float)

    def array(self, group: Group) -> np.ndarray:
        """Returns the columns of a group, shape (n, columns)."""
        return np.column_stack([self.numbers(k) for k in group.columns])

    def label(self, group: Group) -> str:
        """Returns the name by which a group can be chosen."""
        return " ".join(filter(None, [self.name, group.stem])) or ", ".join(
            self.names[k] for k in group.columns
        )


def groups(table: Table) -> list[Group]:
    """Returns the groups of a table's columns."""
    names = table.names
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names):
        words, unit = split_unit(name, table.units[column])
        if unit and unit[0] == "time":
            continue
        if of_rows := re.search(r"\brot\[([0-8])\]", name.lower()):
            # Column by column, as Qualisys writes them.
            number = int(of_rows[1])
            one: Any = f"{number % 3}{number // 3}", ["matrix"]
        else:
            one = _axis(words)
        if one:
            stem = " ".join(one[1])
            # A second sensor of the same names.
            more = 1
            while one[0] in found.get(stem, {}):
                more += 1
                stem = f"{' '.join(one[1])} {more}"
            found.setdefault(stem, {})[one[0]] = column
    out = []
    for stem, axes in found.items():
        first = int("matrix" in stem and not any("0" in axis for axis in axes))
        matrix = [axes.get(f"{r + first}{c + first}") for r in range(3) for c in range(3)]
        if None not in matrix:
            form: list[Any] = matrix
        elif all(axis in axes for axis in "wxyz"):
            form = [axes[axis] for axis in "wxyz"]
        elif all(axis in axes for axis in "xyz"):
            form = [axes[axis] for axis in "xyz"]
        else:
            continue
        units = {split_unit(names[k], table.units[k])[1] for k in form}
        words = [*words_of(table.name), *stem.split()]
        kind = kind_of(words)
        if "spoken" in words and kind != "rate":
            kind = "angles"
        unit = units.pop() if len(units) == 1 else None
        if units and kind in ("rate", None) and len(form) == 3:
            shown = ", ".join(names[k] for k in form)
            raise Unreadable(f"the columns {shown} are not of one unit")
        if unit and len(form) == 3:
            if unit[0] == "rate" and kind not in ("other", "acceleration", "magnetic"):
                kind = "rate"
            elif unit[0] == "angle" and kind != "rate":
                kind = "angles"
            elif unit[0] in ("acceleration", "other"):
                kind = kind if kind in ("acceleration", "magnetic", "position") else "other"
            if unit[0] == "angle" and kind == "rate":
                unit = ("rate", {"deg": "deg/s", "rad": "rad/s"}[unit[1]])
        if kind == "orientation" and len(form) == 3:
            kind = "angles"
        if len(form) > 3:
            kind = "orientation" if kind != "other" else kind
        out.append(Group(stem, form, kind, unit, table.named))
    if not table.named and not out:
        out += _unnamed(table)
    return out


def _unnamed(table: Table) -> list[Group]:
    """Returns what the values of columns without names say: three that remain beside the times,
    or of more than three those that gravity's size does not give away."""
    times = {k for _, k in time_columns(table)}
    rest = [k for k in range(len(table.names)) if k not in times and _is_numeric(table, k)]
    if len(rest) == 3:
        return [Group("", rest, None, None, False)]
    if len(rest) not in (6, 9) or not times:
        return []
    triples = [Group(f"columns {rest[k] + 1}", rest[k : k + 3], None, None, False) for k in range(0, len(rest), 3)]
    free = [g for g in triples if not not_rates(table.array(g))]
    return free if len(free) == 1 else []


def _is_numeric(table: Table, column: int) -> bool:
    if column in table.data:
        return table.data[column].dtype.kind in "iuf"
    sample = [fields[column] for _, fields in table.rows[:50] if column < len(fields)]
    try:
        return any(not np.isnan(table.dialect.number(text)) for text in sample)
    except ValueError:
        return False


def not_rates(w: np.ndarray) -> str | None:
    """Returns why three columns that nothing names are not those of a moved gyroscope, if so."""
    w = w[np.isfinite(w).all(axis=1)]
    if len(w) < 8:
        return None
    size = np.linalg.norm(w, axis=1)
    usual = float(np.median(size))
    spread = float(np.quantile(size, 0.9) - np.quantile(size, 0.1)) / max(usual, 1e-12)
    for one, unit in ((9.81, "m/s²"), (1.0, "g"), (1000.0, "mg")):
        if abs(usual / one - 1) < 0.1 and spread < 0.8:
            return f"their size is that of gravity, {usual:.3g} {unit}"
    if usual and spread < 0.2:
        return f"their size hardly changes ({usual:.3g})"
    middle = np.median(w, axis=0)
    moving = float(np.sqrt(np.mean(np.sum((w - middle) ** 2, axis=1))))
    if np.linalg.norm(middle) > 1.5 * moving > 0:
        return "they have a constant part that is larger than what changes, as positions and accelerations have"
    return None


# --- Times -------------------------------------------------------------------------------------


def time_columns(table: Table) -> list[tuple[int, int]]:
    """Returns rank and number of each column of times."""
    if not table.named:
        return [(0, k) for k in _rising(table)][:1]
    out = []
    for column, name in enumerate(table.names):
        words, unit = split_unit(name, table.units[column])
        text = " ".join(words_of(name))
        is_unit = unit is not None and unit[0] == "time"
        if _DURATION.search(text) or (not is_unit and (_axis(words) or (unit and unit[0] != "time"))):
            continue
        rank = next((r for r, form in _TIMES if form.search(text)), 4 if is_unit else None)
        if rank is not None:
            out.append((rank, column))
    return out


def _rising(table: Table) -> list[int]:
    """Returns columns that rise as times do, the most even first."""
    found = []
    for k in range(len(table.names)):
        if k not in table.data and table.rows and MOMENT.fullmatch(table.rows[0][1][k]):
            found.append((-1.0, k))
            continue
        if not _is_numeric(table, k):
            continue
        steps = np.diff(table.numbers(k))
        if not len(steps):
            return [int(np.argmax([abs(table.numbers(c)[0]) for c in range(len(table.names))]))]
        # A counter may wrap; rates of a slow motion may rise too, but not by even steps.
        if np.mean(steps >= 0) > 0.99 and np.mean(steps > 0) > 0.5 and np.median(steps) > 0:
            found.append((float(np.median(np.abs(steps - np.median(steps))) / np.median(steps)), k))
    return [k for _, k in sorted(found)]


@dataclass
class Times:
    """Times of the rows in ns, and what they are in words."""

    ns: np.ndarray
    form: str
    notes: list[str]
    columns: list[int]
    unit: str
    is_moment: bool = False


def scale_of(unit: str) -> Decimal:
    """Returns the nanoseconds in one of a unit, also of one such as `1e-6 s`."""
    return Decimal(_MORE_TIME[unit]) if unit in _MORE_TIME else Decimal(unit.split()[0]) * 10**9


def exact(text: str, dialect: Any, scale: Decimal) -> int:
    """Returns a number of a text in nanoseconds."""
    plain = dialect.plain(text)
    try:
        return int(plain) * int(scale) if scale == int(scale) else round(int(plain) * scale)
    except ValueError:
        pass
    try:
        return round(Decimal(plain) * scale)
    except ArithmeticError:
        raise ValueError(f"could not convert {text[:40]!r}") from None


def nanos(table: Table, column: int, unit: str, rows: np.ndarray) -> np.ndarray:
    """Returns a column of numbers of a unit in ns, exactly, at some of the rows."""
    scale = scale_of(unit)
    if column in table.data:
        return to_nanos(table.data[column][rows], scale, unit)
    texts = table.texts(column)
    try:
        return np.array([exact(texts[row], table.dialect, scale) for row in rows], dtype=np.int64)
    except OverflowError:
        raise Unreadable(f"times of {table.names[column]!r} of more than 19 digits of ns: give --time-unit") from None


def to_nanos(times: np.ndarray, scale: Decimal, unit: str) -> np.ndarray:
    """Returns times in units of `scale` ns as integer nanoseconds."""
    largest = float(np.abs(times.astype(float)).max(initial=0))
    if not np.isfinite(largest) or largest * float(scale) > 9.2e18:
        raise Unreadable(f"times up to {largest:g} {unit} are none: give --time-unit")
    if times.dtype.kind in "iu" and scale == int(scale):
        return times.astype(np.int64) * int(scale)
    # Whole units apart, so that no digits are lost.
    whole = np.floor(times)
    begin = whole.astype(np.int64) * int(scale) if scale == int(scale) else np.round(whole * float(scale)).astype(np.int64)
    return begin + np.round((times - whole) * float(scale)).astype(np.int64)


def plausible_unit(step: float, rate: float | None) -> str:
    """Returns the unit in which the samples are as far apart as those of a gyroscope, or as the
    file's own rate says."""
    if rate:
        near = {unit: abs(np.log(step * scale * 1e-9 * rate)) for unit, scale in _MORE_TIME.items()}
        best = min(near, key=lambda unit: near[unit])
        if near[best] < 0.2:
            return best
    for unit in ("s", "ms", "us", "ns"):
        if SHORTEST_STEP_S <= step * TIME_UNITS[unit] * 1e-9 <= LONGEST_STEP_S:
            return unit
    return "days" if SHORTEST_STEP_S <= step * 86400 <= LONGEST_STEP_S else "ns"


def rate_of(settings: dict[str, str]) -> float | None:
    """Returns the rate that a file states above its rows, Hz."""
    for name in sorted(settings, key=lambda name: "capture" in name):
        if re.search(r"\b(rate|frequency|freq|fs|odr|sampling|sps)\b", name.replace("_", " ")):
            found = re.match(r"([\d.,]+)\s*(k?hz)?", settings[name].lower())
            try:
                value = float(found[1].replace(",", ".")) if found else 0.0
            except ValueError:
                continue
            if 1 <= value <= 20000:
                return value
    return None


class Clock:
    """The times of a group's rows."""

    def __init__(self, table: Table, group: Group, rows: np.ndarray, rate: float | None, unit: str | None, part: int):
        self.table, self.group, self.rows = table, group, rows
        self.rate, self.unit, self.part = rate, unit, part
        self.notes: list[str] = []
        self.added: list[tuple[int, int]] = []

    def find(self, given: list[int] | None) -> Times:
        """Returns the times by the columns that are given, else by those that are found."""
        table = self.table
        if given is not None and given:
            return self._pair(*given) if len(given) == 2 else self._of(given[0])
        if self.rate:
            return self._counted(self.rate, "given")
        why = []
        order = self._ordered()
        for column in order:
            pair = next((p for p in self._seconds_with_more() if column in p), None)
            try:
                return self._pair(*pair) if pair else self._of(column)
            except _Empty as error:
                why.append(str(error))
        stated = rate_of(table.settings)
        if stated:
            return self._counted(stated, "stated in the file")
        shown = "; ".join(why) or f"no column of times among {', '.join(table.names)[:200]}"
        counter = self._counter()
        what = f"of the counter {table.names[counter]!r}" if counter is not None else "of the rows"
        raise Unreadable(f"{shown}; give --rate HZ {what}, or name the columns with --columns TIME,X,Y,Z")

    def _ordered(self) -> list[int]:
        table = self.table
        found = time_columns(table)
        # A column of times for each channel, of one name: the one beside it.
        first = self.group.columns[0]
        names = [table.names[k] for _, k in found]
        left = [k for _, k in found if k < first]
        found = [
            (rank, k)
            for rank, k in found
            if names.count(table.names[k]) == 1 or (left and k == left[-1]) or (not left and k == found[0][1])
        ]
        if len(found) < 2:
            return [k for _, k in found]
        own = set(self.group.stem.split()) - {"x", "axis", "1", "time"}

        def order(one: tuple[int, int]) -> tuple[Any, ...]:
            rank, k = one
            try:
                raw, _ = self._raw(k)
                steps = np.diff(raw)
                usual = np.median(steps)
                repeated = float(np.mean(steps == 0)) > MOST_REPEATED
                uneven = float(np.mean(np.minimum(np.abs(steps - usual) / usual, 1))) if usual > 0 else 9.0
            except (_Empty, Unreadable):
                return (True, True, 9, True, 9.0)
            shares = bool(own & set(words_of(table.names[k])))
            return (rank > 8 and not shares, repeated, not shares, rank, round(uneven, 2))

        return [k for _, k in sorted(found, key=order)]

    def _raw(self, column: int) -> tuple[np.ndarray, bool]:
        """Returns values of a column at the rows, and True if they are dates or times of day in
        ns."""
        table = self.table
        name = table.names[column]
        if column in table.data:
            data = table.data[column]
            if data.dtype.kind == "M":
                return data[self.rows].astype("M8[ns]").astype(np.int64), True
            raw = data[self.rows]
        else:
            texts = table.texts(column) or [""] * len(table)
            some = next((texts[row] for row in self.rows if texts[row].lower() not in MISSING), None)
            if some is None:
                raise _Empty(f"the column of times {name!r} is empty")
            if MOMENT.fullmatch(some):
                try:
                    return np.array([moment(texts[row]) for row in self.rows], dtype=np.int64), True
                except ValueError as error:
                    raise Unreadable(f"column {name!r}: {error}") from None
            raw = table.numbers(column)[self.rows]
        if not np.isfinite(raw.astype(float)).any() or not np.ptp(raw.astype(float)[np.isfinite(raw.astype(float))]):
            raise _Empty(f"the column of times {name!r} is empty" if len(raw) > 1 else "one row")
        return raw.astype(float), False

    def _seconds_with_more(self) -> list[tuple[int, int]]:
        """Returns columns of whole seconds with that of the nanoseconds or microseconds."""
        words = [words_of(name) for name in self.table.names]
        out = []
        for k, one in enumerate(words):
            if not one or one[-1] not in ("sec", "secs", "seconds", "s"):
                continue
            for m, other in enumerate(words):
                is_part = other and re.fullmatch(r"n(ano)?s(ec(ond)?s?)?|u(s|sec)|micro(s|sec|seconds)", other[-1])
                if is_part and other[:-1] == one[:-1] and m != k:
                    out.append((k, m))
        return out

    def _pair(self, seconds: int, more: int) -> Times:
        table = self.table
        name = table.names[more]
        part = table.numbers(more)[self.rows]
        unit = (split_unit(name, "")[1] or ("", ""))[1]
        if unit not in ("us", "ns"):
            unit = "ns" if part.max(initial=0) >= 1e6 else "us"
        if part.min(initial=0) < 0 or part.max(initial=0) * TIME_UNITS[unit] >= 10**9:
            raise Unreadable(f"{name!r} is no part of a second in {unit}: up to {part.max():g}")
        ns = nanos(table, seconds, "s", self.rows) + nanos(table, more, unit, self.rows)
        names = f"{table.names[seconds]!r} in s and {name!r} in {unit}"
        return self._checked(ns, ns.astype(float), names, [seconds, more], unit)

    def _of(self, column: int) -> Times:
        table, name = self.table, self.table.names[column]
        raw, is_moment = self._raw(column)
        keep = np.isfinite(raw)
        if not keep.all():
            self.rows, raw = self.rows[keep], raw[keep]
        if is_moment:
            return self._checked(raw, raw.astype(float), f"{name!r}, dates or times of day", [column], "ns", True)
        steps = np.diff(raw)
        rising = steps[steps > 0]
        if not len(rising):
            raise Unreadable(f"the times of {name!r} do not rise")
        step = float(np.median(rising))
        named = (split_unit(name, table.units[column])[1] or ("", None))[1] if not self.unit else None
        named = named if named in _MORE_TIME else None
        scale = table.settings.get("tscale")
        if scale and not self.unit:
            unit, by = f"{Decimal(scale)} s", "scale in the header"
        elif self.unit or named:
            unit, by = self.unit or named or "", "given" if self.unit else "named"
        else:
            is_count = step == 1 and np.mean(steps == 1) > 0.9
            if is_count and (stated := rate_of(table.settings)):
                return self._counted(stated, "stated in the file", column)
            if is_count:
                raise Unreadable(
                    f"{name!r} rises by 1 a row, as counters do: give --rate HZ, or --time-unit if it is a time"
                )
            unit, by = plausible_unit(step, rate_of(table.settings)), "by their distance"
        factor = float(scale_of(unit))
        if not 1e-5 <= step * factor * 1e-9 <= LONGEST_STEP_S:
            raise Unreadable(
                f"times of {name!r} in {unit} ({by}) would be {step * factor * 1e-9:.3g} s apart, which no "
                "gyroscope's are: give --time-unit, or --rate HZ if it is a counter"
            )
        ns = nanos(table, column, unit, self.rows)
        return self._checked(ns, raw, f"{name!r} in {unit} ({by})", [column], unit)

    def _counter(self) -> int | None:
        for k, name in enumerate(self.table.names):
            if _COUNTER.search(" ".join(words_of(name))) and k not in self.group.columns:
                try:
                    steps = np.diff(self.table.numbers(k)[self.rows])
                except Unreadable:
                    continue
                if len(steps) and np.mean(steps == np.median(steps)) > 0.9 and np.median(steps) > 0:
                    return k
        return None

    def _counted(self, rate: float, by: str, column: int | None = None) -> Times:
        table = self.table
        column = self._counter() if column is None else column
        if column is None:
            counts, name = self.rows.astype(float), "the rows' numbers"
        else:
            counts, name = table.numbers(column)[self.rows], repr(table.names[column])
        usual = float(np.median(np.diff(counts))) if len(counts) > 1 else 1.0
        counts, _ = self._unwrapped(counts, name)
        ns = np.round((counts - counts[0]) / usual * 1e9 / rate).astype(np.int64)
        form = f"times by {name} at {rate:g} Hz ({by})"
        return Times(ns, form, self.notes, [], "ns")

    def _unwrapped(self, raw: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Returns values that go on where a counter wraps, and what was added."""
        added = np.zeros(len(raw))
        steps = np.diff(raw)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        cuts = []
        for k in np.flatnonzero(steps < -max(20 * step, 0)):
            # One bad stamp among good ones.
            if (k + 2 < len(raw) and raw[k + 2] > raw[k] - 20 * step) or (
                k and raw[k + 1] > raw[k - 1] - 20 * step
            ):
                continue
            rise = [(m, raw[k + 1] + m - raw[k]) for m in MODULI]
            fits = [m for m, r in rise if 0 < r <= MOST_SKIPPED * step and _ends(raw[k], raw[k + 1], m, step)]
            # Ten rows that share one time leave the step unknown.
            if fits:
                added[k + 1 :] += fits[0]
                where = self.table.line(int(self.rows[k + 1]))
                self.notes.append(f"{where}: {name} wraps at {fits[0]:.10g}; it goes on there")
            else:
                cuts.append(k + 1)
        if cuts:
            ends = [0, *cuts, len(raw)]
            if not self.part:
                k = cuts[0]
                repeated = " under a repeated header" if any(
                    abs(row - self.rows[k]) <= 1 for row, _ in self.table.restarts
                ) else ""
                raise Unreadable(
                    f"{self.table.line(int(self.rows[k]))}: {name} falls from {raw[k - 1]:.10g} to {raw[k]:.10g}{repeated}: "
                    f"a clock that started again. Each part is a recording: FILE@part 1 to FILE@part {len(ends) - 1}"
                )
            if self.part >= len(ends):
                raise Unreadable(f"there are {len(ends) - 1} parts, and none is number {self.part}")
            kept = slice(ends[self.part - 1], ends[self.part])
            self.rows, raw, added = self.rows[kept], raw[kept], added[kept]
            self.notes.append(f"part {self.part} of {len(ends) - 1}, from {self.table.line(int(self.rows[0]))}")
        return raw + added, added

    def _checked(
        self, ns: np.ndarray, raw: np.ndarray, form: str, columns: list[int], unit: str, is_moment: bool = False
    ) -> Times:
        name = self.table.names[columns[0]]
        scale = 1.0 if is_moment or len(columns) == 2 else float(scale_of(unit))
        repeated = np.diff(raw) == 0
        share = float(repeated.mean()) if len(repeated) else 0.0
        if share > MOST_REPEATED:
            runs = round(1 / max(1 - share, 1e-9))
            rising = np.diff(raw)[np.diff(raw) > 0]
            steps = np.median(rising) if len(rising) else 0
            hint = "; a spreadsheet that saves minutes and seconds does this: export it again without" if is_moment else ""
            raise Unreadable(
                f"times of {name!r} have steps of {steps * scale * 1e-9:.3g} s, which some {runs} rows share{hint}; "
                "or give --rate HZ of the rows"
            )
        rows = self.rows
        before = len(rows)
        values, added = self._unwrapped(raw, repr(name))
        if len(self.rows) != before:
            # One part of several.
            start = int(np.searchsorted(rows, self.rows[0]))
            ns = ns[start : start + len(self.rows)]
        if added.any():
            more = np.array([round(a * scale) for a in added.tolist()], dtype=np.int64)
            ns = ns + more
            self.added = [
                (self.table.number(int(self.rows[k + 1])), int(more[k + 1] - more[k]))
                for k in np.flatnonzero(np.diff(more)).tolist()
            ]
        return Times(ns, f"times of {form}", self.notes, columns, unit, is_moment)


def _ends(before: float, after: float, modulus: float, step: float) -> bool:
    """Returns True if a counter of this size, with a sign or without, wraps between these."""
    near = MOST_SKIPPED * step
    return (modulus - near <= before <= modulus + step and -step <= after <= near) or (
        modulus / 2 - near <= before <= modulus / 2 and -modulus / 2 <= after <= -modulus / 2 + near
    )


class _Empty(Exception):
    """A column of times without any."""


MISSING = frozenset(("", "nan", "null", "none", "na", "n/a", "-", "--", "nil", "#n/a", "(null)"))


# --- Rates -------------------------------------------------------------------------------------


def typical_rate(rates: np.ndarray) -> float:
    """Returns a large rate of the motion that outliers do not affect: nine of ten are slower."""
    return float(np.quantile(np.linalg.norm(rates, axis=1), 0.9)) if len(rates) else 0.0


def plausible_rate(rates: np.ndarray, t: np.ndarray | None = None) -> str:
    """Returns the unit in which a body turns as fast as a hand or a vehicle turns it, and swings
    no farther than it can."""
    typical = typical_rate(rates)
    unit = next((u for u in ("rad/s", "deg/s") if typical * RATE_UNITS[u] <= FASTEST), "mdps")
    if unit == "rad/s" and t is not None and typical > 1:
        axis = rates[:, int(np.argmax(rates.std(axis=0)))]
        turned = np.concatenate([[0], np.cumsum(axis[1:] * np.diff(t) * 1e-9)])
        turns = np.flatnonzero(np.diff(np.signbit(axis)))
        swings = np.abs(np.diff(turned[turns]))
        if len(swings) > 4 and np.quantile(swings, 0.75) > LONGEST_SWING:
            return "deg/s"
    return unit


def _by_gravity(t: np.ndarray, w: np.ndarray, acc: np.ndarray) -> str | None:
    """Returns the unit in which rates turn the gravity that the accelerometer beside them sees:
    its direction g changes by -w x g."""
    size = np.linalg.norm(acc, axis=1)
    step = float(np.median(np.diff(t))) * 1e-9
    wide = max(int(0.2 / max(step, 1e-6)), 1)
    if len(t) < 8 * wide or not np.median(size) or not np.isfinite(acc).all() or step <= 0:
        return None
    box = np.ones(wide) / wide
    g, v = (np.column_stack([np.convolve(c, box, "valid") for c in a.T]) for a in (acc, w))
    g /= np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)
    change, turn = np.gradient(g, step, axis=0), np.cross(g, v)
    both = float((change * turn).sum())
    size2 = float((turn**2).sum()), float((change**2).sum())
    if not min(size2) or both / (size2[0] * size2[1]) ** 0.5 < 0.5:
        return None
    factor = both / size2[0]
    unit = min(RATE_UNITS, key=lambda u: abs(np.log(factor / RATE_UNITS[u])))
    return unit if abs(np.log(factor / RATE_UNITS[unit])) < 0.7 else None


@dataclass
class Asked:
    """Settings for a file: names or numbers of columns, units, rate in Hz, sensor."""

    topic: str | None = None
    columns: list[str] | None = None
    unit: str | None = None
    time_unit: str | None = None
    rate: float | None = None


def _asked_columns(tables: list[Table], asked: Asked) -> tuple[Table, Group, list[int]]:
    """Returns table, group and columns of times that ``--columns`` names."""
    given = asked.columns or []
    time = [] if given[0] in ("", "-") else given[0].split("+")
    if given[0] in (name for table in tables for name in table.names):
        time = given[:1]
    wanted = [*time, *given[1:]]
    sizes = {3: "rate", 4: "orientation", 9: "orientation"}
    if len(given) - 1 not in sizes or not 0 <= len(time) <= 2:
        raise Unreadable(
            f"--columns {','.join(given)}: expected time and x, y, z; or time and w, x, y, z; or time and nine of a "
            "matrix; time may be SECONDS+NANOSECONDS, or - with --rate"
        )
    missing = ""
    for table in tables:
        found = []
        for name in wanted:
            if name in table.names:
                found.append(table.names.index(name))
            elif name.isdecimal() and 1 <= int(name) <= len(table.names):
                found.append(int(name) - 1)
            else:
                missing = name
                break
        else:
            columns = found[len(time) :]
            units = {split_unit(table.names[k], table.units[k])[1] for k in columns}
            unit = units.pop() if len(units) == 1 else None
            kind = sizes[len(given) - 1]
            if asked.unit and ":" in asked.unit:
                kind = "angles"
            if kind == "rate" and unit and unit[0] == "angle":
                unit = ("rate", {"deg": "deg/s", "rad": "rad/s"}[unit[1]])
            return table, Group("", columns, kind, unit, True), found[: len(time)]
    there = ", ".join(tables[0].names)
    raise Unreadable(f"no column {missing!r}; there are {there[:300]}, or 1 to {len(tables[0].names)}")


def _is_orientation(table: Table, group: Group) -> bool:
    if len(group.columns) == 3:
        return group.kind == "angles"
    values = table.array(group)
    return orientation.is_matrix(values) if len(group.columns) == 9 else orientation.is_quaternion(values)


def _plain(text: str) -> str:
    return " ".join(re.findall(r"[^\W_]+", text.lower()))


def choose(tables: list[Table], path: Path, topic: str | None) -> tuple[Table, Group]:
    """Returns the group that is the gyroscope, or the orientation, of a file.

    Raises:
        Unreadable: There is none, or there are several.
    """
    hint = "name the columns with --columns TIME,X,Y,Z"
    of_file = sensor_of(path.name.removesuffix(path.suffix)) if len(tables) == 1 else None
    found: list[tuple[int, Table, Group]] = []
    why: list[str] = []
    for table in tables:
        own = groups(table)
        quaternions = any(len(g.columns) == 4 for g in own)
        for group in own:
            names = ", ".join(table.names[k] for k in group.columns)
            kind = group.kind or of_file
            if kind == "rate" and len(group.columns) == 3:
                gyr = "gyr" in f"{table.name} {group.stem}".lower()
                raw = re.search(r"uncal|raw", f"{table.name} {group.stem}".lower())
                found.append((0 if gyr and not raw else 1, table, group))
            elif kind is None and len(group.columns) == 3 and not (quaternions or topic):
                try:
                    reason = not_rates(table.array(group))
                except Unreadable:
                    if len(tables) == 1:
                        raise
                    continue
                if reason:
                    why.append(f"nothing says that {names} are rates, and {reason}")
                else:
                    found.append((2, table, group))
            elif kind in ("orientation", "angles") and len(group.columns) in (3, 4, 9):
                if len(group.columns) > 3 or kind == "angles":
                    found.append(({4: 3, 9: 4}.get(len(group.columns), 5), table, group))
            elif kind and len(group.columns) == 3:
                why.append(f"{names} measure {kind if kind != 'other' else 'something else'}")
                if topic:
                    found.append((6, table, group))
    if topic is not None:
        asked = _plain(topic)
        exact = [f for f in found if asked in (_plain(f[1].label(f[2])), _plain(f[1].name), _plain(f[2].stem))]
        part = [f for f in found if asked in _plain(f[1].label(f[2]))]
        if not (exact or part):
            there = "; ".join(f"@{t.label(g)}" for _, t, g in found[:12]) or "none"
            raise Unreadable(f"no gyroscope named {topic!r}; there are {there}")
        found = exact or part
    # Orientations only where there are no rates; and not those of a robot that has none.
    for rank in sorted({f[0] for f in found}):
        best = [f for f in found if f[0] == rank]
        if rank in (3, 4, 5):
            best = [f for f in best if _is_orientation(f[1], f[2])]
        if len(best) > 1:
            best = [f for f in best if np.nan_to_num(f[1].array(f[2])).any()] or best
        if len(best) == 1:
            return best[0][1], best[0][2]
        if best:
            of_each = "; ".join(
                f"@{t.label(g)} ({', '.join(t.names[k] for k in g.columns)})" for _, t, g in best[:12]
            )
            raise Unreadable(f"several gyroscopes: {of_each}: name one after the file, as {path.name}@NAME, or {hint}")
    table = max(tables, key=lambda one: len(one.names))
    if not table.named:
        raise Unreadable(
            f"{len(table.names)} columns without names: say with --columns TIME,X,Y,Z (numbers from 1) which is which"
        )
    names = ", ".join(table.names)[:200]
    raise Unreadable("; ".join([f"no columns of a gyroscope among {names}", *dict.fromkeys(why)][:5]) + f"; {hint}")


def _as_rates(
    table: Table, group: Group, values: np.ndarray, times: Times, asked: Asked, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, str, bool, list[str]]:
    """Returns times, ns, and rates, rad/s; what they are in words; True if the unit is a guess;
    and notes."""
    names = ", ".join(repr(table.names[k]) for k in group.columns)
    unit, _, order = (asked.unit or "").partition(":")
    if len(group.columns) > 3 or group.kind == "angles":
        form = {4: "quaternions", 9: "rotation matrices"}.get(len(group.columns), "angles")
        if group.kind == "angles":
            stated = next((v for k, v in table.settings.items() if "rotation type" in k or "rotation order" in k), "")
            order = (order or stated).upper()
            if not re.fullmatch(r"[XYZ]{3}", order):
                raise Unreadable(
                    f"{names} are angles, of which nothing says in which order they turn: export quaternions, or say it "
                    "as --unit deg:ZYX"
                )
            of_unit = (group.unit or ("", ""))[1]
            if not unit:
                unit = of_unit if of_unit in ("deg", "rad") else "deg" if np.abs(values).max() > 7 else "rad"
            form = f"angles in {unit}, turned about {order}"
            q = orientation.of_angles(np.radians(values) if unit == "deg" else values, order)
        else:
            q = orientation.of_matrix(values) if len(group.columns) == 9 else values
        if unit == "world-to-body":
            q = q * [1, -1, -1, -1]
        good = np.linalg.norm(q, axis=1) > 0.5
        t, w, notes = orientation.rates(times.ns[good], q[good])
        return t, w, f"rates of {form} in {names}, body to room", False, notes
    by, scale = "", 1.0
    if unit:
        number, _, unit = re.sub(rf"({'|'.join(RATE_UNITS)})$", r" \1", unit).rpartition(" ")
        by = "given"
        scale = float(number or 1)
    elif group.unit and group.unit[0] == "rate":
        unit, by = group.unit[1], "named"
    elif "gscale" in table.settings:
        # <https://docs.gyroflow.xyz/app/technical-details/gcsv-format>: rad/s in one count.
        scale, unit, by = float(table.settings["gscale"]), "rad/s", "scale in the header"
    elif maker := next(
        (m for m in MAKERS if m[1] <= {n.lower() for n in table.names} and m[2] <= table.settings.keys()), None
    ):
        unit, by = maker[3], f"as {maker[0]} writes them"
    else:
        beside = [g for g in groups(table) if g.kind == "acceleration" and len(g.columns) == 3]
        try:
            found = _by_gravity(times.ns, values, table.array(beside[0])[rows]) if beside else None
        except Unreadable:
            found = None
        unit = found or plausible_rate(values, times.ns)
        by = "by the gravity beside them" if found else "by their size"
        if by == "by their size" and unit == "mdps" and (values == np.round(values)).all():
            raise Unreadable(
                f"{names} are counts of up to {np.abs(values).max():.0f} without a unit: give what one is, "
                "as --unit 0.061deg/s"
            )
    shown = f"{scale:g} {unit}" if scale != 1 else unit
    kind = "" if group.named or group.kind else ", which nothing but their size says"
    form = f"rates of {names} in {shown} ({by}{kind})"
    return times.ns, values * scale * RATE_UNITS[unit], form, by == "by their size", []


def read(tables: list[Table], path: Path, form: str, asked: Asked, notes: list[str]) -> Recording:
    """Returns the gyroscope of a file's tables."""
    tables = [table for table in tables if len(table)]
    if not tables:
        raise Unreadable("no rows of samples")
    for table in tables:
        # With commas some loggers write w first.
        if not table.named and len(table.names) in UNNAMED and (
            len(table.names) != 8 or table.dialect.delimiter is None
        ):
            _name(table)
    topic, part = asked.topic, 0
    if topic and (cut := re.fullmatch(r"(.*?)\s*part (\d+)", topic)):
        topic, part = cut[1] or None, int(cut[2])
    if asked.columns:
        table, group, given = _asked_columns(tables, asked)
    else:
        (table, group), given = choose(tables, path, topic), None
    values = table.array(group)
    valid = np.isfinite(values).all(axis=1)
    if group.kind != "rate" and len(group.columns) > 3:
        valid &= np.abs(values).max(axis=1) > 0
    rows = np.flatnonzero(valid)
    if not len(rows):
        raise Unreadable("no rows of samples")
    clock = Clock(table, group, rows, asked.rate, asked.time_unit, part)
    times = clock.find(given)
    notes = [*notes, *times.notes]
    if missing := len(table) - len(clock.rows) - (0 if part == 0 else len(rows) - len(clock.rows)):
        notes.append(f"{missing} rows without numbers are left out")
    t, w, of_rates, is_guess, more = _as_rates(table, group, values[clock.rows], times, asked, clock.rows)
    step = float(np.median(np.diff(t))) * 1e-9 if len(t) > 1 else 0.0
    begin = f"from {np.datetime64(int(t[0]), 'ns')}".rstrip("0") if len(t) and t[0] > 10**18 else f"from {t[0] * 1e-9:.3f} s"
    of_table = f"{table.name}, " if table.name else ""
    words = f"{form}: {of_table}{times.form}, {of_rates}, {1 / step if step > 0 else 0:.4g} Hz, {begin}"
    out = Recording(path, words, t, w, notes=notes + more, topic=table.name or None, unit_is_guess=is_guess)
    if times.columns and (table.rows or table.lines_from):
        out.layout = {
            "columns": times.columns,
            "unit": times.unit,
            "moment": times.is_moment,
            "first": table.number(0),
            "added": clock.added,
            "dialect": [table.dialect.delimiter, table.dialect.decimal],
        }
    if times.columns:
        out.topic = out.topic or table.names[times.columns[0]]
    return out


def _name(table: Table) -> None:
    """Names the columns of a file that has none, if the values are those of the layout."""
    known = UNNAMED[len(table.names)]
    trial = Table(table.name, known, [""] * len(known), True, table.data, table.rows, dialect=table.dialect)
    try:
        oriented = [g for g in groups(trial) if len(g.columns) > 3]
        rates = [g for g in groups(trial) if g.kind == "rate"]
        if any(_is_orientation(trial, g) for g in oriented) or any(trial.array(g).any() for g in rates):
            table.names, table.named = known, True
    except Unreadable:
        return
