"""From the tables of a file to a recording: which group of columns is the gyroscope or the
orientation, and what its unit is. What names mean is in :mod:`twist_sync.rules`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import orientation, rules
from ._recording import Recording, Unreadable
from .columns import Group, Table, gravity, groups, not_rates, sensor_of, split_unit, unit_of
from .rules import RATE_UNITS, UNNAMED
from .times import Clock, Times

#: What options of units take.
UNITS = "expected rad/s, mrad/s, deg/s, mdps, rpm, 0.061deg/s or deg:ZYX"
OF_TIME = "expected s, ms, us, ns or one with a factor, as 30.5us"
#: Said of columns that are taken for rates by their values alone.
NAMELESS = "nothing says that they are rates"
#: The unit of rates that nothing names.
BY_SIZE = "by their size"
#: Nine of ten samples of a moved body turn slower than this, rad/s (20 rad/s are 3 turns a second).
FASTEST = 20.0
#: A body that is swung turns by less before it turns back, rad.
LONGEST_SWING = 2 * np.pi


@dataclass
class Asked:
    """Settings for a file: names or numbers of columns, units, rate in Hz, sensor."""

    topic: str | None = None
    columns: list[str] | None = None
    unit: str | None = None
    time_unit: str | None = None
    rate: float | None = None


def is_unit(text: str) -> bool:
    """Returns True for what ``--unit`` takes."""
    of_rates = (unit_of(text) or ("",))[0] == "rate"
    return of_rates or re.fullmatch(r"(deg|rad):[XYZxyz]{3}|world-to-body", text) is not None


def is_time_unit(text: str) -> bool:
    """Returns True for what ``--time-unit`` takes."""
    return (unit_of(text) or ("",))[0] == "time"


def typical_rate(rates: np.ndarray) -> float:
    """Returns a large rate of the motion that outliers do not affect: nine of ten are slower."""
    return float(np.quantile(np.linalg.norm(rates, axis=1), 0.9)) if len(rates) else 0.0


def plausible_rate(rates: np.ndarray, t: np.ndarray) -> str:
    """Returns the unit in which a body turns as fast as a hand or a vehicle turns it, and swings
    no farther than it can."""
    typical = typical_rate(rates)
    unit = next((u for u in ("rad/s", "deg/s") if typical * RATE_UNITS[u] <= FASTEST), "mdps")
    if unit == "rad/s" and typical > 1:
        axis = rates[:, int(np.argmax(rates.std(axis=0)))]
        turned = np.concatenate([[0], np.cumsum(axis[1:] * np.diff(t) * 1e-9)])
        swings = np.abs(np.diff(turned[np.flatnonzero(np.diff(np.signbit(axis)))]))
        if len(swings) > 4 and np.quantile(swings, 0.75) > LONGEST_SWING:
            return "deg/s"
    return unit


def _by_gravity(t: np.ndarray, w: np.ndarray, acc: np.ndarray) -> str | None:
    """Returns the unit in which rates turn the gravity that the accelerometer beside them sees:
    its direction g changes by -w x g."""
    step = float(np.median(np.diff(t))) * 1e-9
    wide = max(int(0.2 / max(step, 1e-6)), 1)
    if len(t) < 8 * wide or step <= 0 or not np.isfinite(acc).all() or not acc.any():
        return None
    box = np.ones(wide) / wide
    g, v = (np.column_stack([np.convolve(c, box, "valid") for c in a.T]) for a in (acc, w))
    g /= np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)
    change, turn = np.gradient(g, step, axis=0), np.cross(g, v)
    both, sizes = float((change * turn).sum()), (float((turn**2).sum()), float((change**2).sum()))
    if not min(sizes) or both / (sizes[0] * sizes[1]) ** 0.5 < 0.5:
        return None
    off = {unit: abs(np.log(both / sizes[0] / own)) for unit, own in RATE_UNITS.items()}
    unit = min(off, key=lambda unit: off[unit])
    return unit if off[unit] < 0.7 else None


def _asked_columns(tables: list[Table], asked: list[str], unit: str | None) -> tuple[Table, Group, list[int]]:
    """Returns table, group and columns of times that ``--columns`` names."""
    kind = {3: "rate", 4: "orientation", 9: "orientation"}.get(len(asked) - 1)
    time = [] if asked[0] in ("", "-") else asked[0].split("+")
    if any(asked[0] in table.names for table in tables):
        time = asked[:1]
    if kind is None or len(time) > 2:
        raise Unreadable(
            f"--columns {','.join(asked)}: expected time and x, y, z; or time and w, x, y, z; or time and nine of a "
            "matrix; time may be SECONDS+NANOSECONDS, or - with --rate"
        )
    missing = ""
    for table in tables:
        by_name = {str(k): k - 1 for k in range(1, len(table.names) + 1)} | {n: k for k, n in enumerate(table.names)}
        wanted = [*time, *asked[1:]]
        missing = next((name for name in wanted if name not in by_name), "")
        if not missing:
            found = [by_name[name] for name in wanted]
            columns = found[len(time) :]
            units = {split_unit(table.names[k], table.units[k])[1] for k in columns}
            of_names = units.pop() if len(units) == 1 else None
            if kind == "rate" and of_names and of_names[0] == "angle":
                of_names = ("rate", {"deg": "deg/s", "rad": "rad/s"}[of_names[1]])
            kind = "angles" if unit and ":" in unit else kind
            return table, Group("", columns, kind, of_names), found[: len(time)]
    there = ", ".join(tables[0].names)
    raise Unreadable(f"no column {missing!r}; there are {there[:300]}, or 1 to {len(tables[0].names)}")


def _is_orientation(table: Table, group: Group) -> bool:
    if len(group.columns) == 3:
        return group.kind == "angles"
    values = table.array(group)
    return orientation.is_matrix(values) if len(group.columns) == 9 else orientation.is_quaternion(values)


def _rank(table: Table, group: Group, kind: str | None, oriented: bool, why: list[str]) -> float | None:
    """Returns the order in which a group is taken: 0 to 1.5 for rates, 2 for what may be rates,
    3 to 5 for orientations, 6 for others, which are taken by their name alone."""
    names = table.named_as(group.columns)
    if len(group.columns) > 3:
        return {4: 3, 9: 4}[len(group.columns)] if kind == "orientation" else None
    if kind == "rate":
        label = f"{table.name} {group.stem}".lower()
        # Letters such as g and w have other meanings too.
        is_sure = (group.unit and group.unit[0] == "rate") or re.search("gyr|giro|ang|omega|rot|rate|speed", label)
        if not is_sure and (reason := gravity(table.array(group))):
            why.append(f"{names} are not rates: {reason}")
            return 6
        return ("gyr" not in label) + bool(re.search(r"uncal|raw", label)) / 2
    if kind is None:
        reason = None if oriented else not_rates(table.array(group))
        if reason:
            why.append(f"nothing says that {names} are rates, and {reason}")
        return 6 if reason or oriented else 2
    if kind == "angles":
        return 5
    why.append(f"{names} measure {kind if kind != 'other' else 'something else'}")
    return 6


def _plain(text: str) -> str:
    return " ".join(re.findall(r"[^\W_]+", text.lower()))


def choose(tables: list[Table], path: Path, topic: str | None) -> tuple[Table, Group]:
    """Returns the group that is the gyroscope, or the orientation, of a file.

    Raises:
        Unreadable: There is none, or there are several.
    """
    hint = "name the columns with --columns TIME,X,Y,Z"
    of_file = sensor_of(path.name.removesuffix(path.suffix)) if len(tables) == 1 else None
    found: list[tuple[float, Table, Group]] = []
    why: list[str] = []
    for table in tables:
        own = groups(table)
        for group in own:
            try:
                rank = _rank(table, group, group.kind or of_file, any(len(g.columns) == 4 for g in own), why)
            except Unreadable:
                if len(tables) == 1:
                    raise
                continue
            if rank is not None and (rank < 6 or topic):
                found.append((rank, table, group))
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
        best = [f for f in found if f[0] == rank and (rank not in (3, 4, 5) or _is_orientation(f[1], f[2]))]
        if rank in (3, 4) and not best:
            why.append(f"{' and '.join(f[1].named_as(f[2].columns) for f in found if f[0] == rank)} are no rotations: not of size 1, or constant")
        if len(best) > 1 or (best and any(f[0] in (3, 4) for f in found)):
            moving = [f for f in best if np.nan_to_num(f[1].array(f[2])).any()]
            # Rates that are all zero are none beside orientations.
            best = moving or ([] if rank < 3 and any(f[0] in (3, 4) and _is_orientation(f[1], f[2]) for f in found) else best)
        if len(best) == 1:
            return best[0][1], best[0][2]
        if best:
            of_each = "; ".join(f"@{t.label(g)} ({t.named_as(g.columns)})" for _, t, g in best[:12])
            raise Unreadable(f"several gyroscopes: {of_each}: name one after the file, as {path.name}@NAME, or {hint}")
    table = max(tables, key=lambda one: len(one.names))
    if not table.named:
        said = "; ".join([table.misnamed or f"{len(table.names)} columns without names", *why][:3])
        raise Unreadable(f"{said}: say with --columns TIME,X,Y,Z (numbers from 1) which is which")
    names = ", ".join(table.names)[:200]
    raise Unreadable("; ".join([f"no columns of a gyroscope among {names}", *dict.fromkeys(why)][:5]) + f"; {hint}")


def _of_orientations(
    table: Table, group: Group, values: np.ndarray, t: np.ndarray, unit: str | None
) -> tuple[np.ndarray, np.ndarray, str, list[str]]:
    """Returns times, ns, and rates, rad/s, from one orientation to the next; what they are in
    words; and notes."""
    names = ", ".join(repr(table.names[k]) for k in group.columns)
    form = {4: "quaternions", 9: "rotation matrices"}.get(len(group.columns), "angles")
    q = orientation.of_matrix(values) if len(group.columns) == 9 else values
    if group.kind == "angles":
        given, _, order = (unit or "").partition(":")
        stated = (v for k, v in table.settings.items() if "rotation type" in k or "rotation order" in k)
        order = (order or next(stated, "")).upper()
        if not re.fullmatch(r"[XYZ]{3}", order):
            raise Unreadable(
                f"{names} are angles, of which nothing says in which order they turn: export quaternions, or say it "
                "as --unit deg:ZYX"
            )
        named = group.unit[1] if group.unit and group.unit[0] == "angle" else ""
        unit = given or named or ("deg" if np.abs(values).max() > 7 else "rad")
        form = f"angles in {unit}, turned about {order}"
        q = orientation.of_angles(np.radians(values) if unit == "deg" else values, order)
    if unit == "world-to-body":
        q = q * [1, -1, -1, -1]
    good = np.linalg.norm(q, axis=1) > 0.5
    t, w, notes = orientation.rates(t[good], q[good])
    return t, w, f"rates of {form} in {names}, body to room", notes


def _unit_of_rates(
    table: Table, group: Group, values: np.ndarray, t: np.ndarray, unit: str | None, rows: np.ndarray
) -> tuple[str, float, str]:
    """Returns the unit of rates, a factor, and who says so."""
    said = table.settings.get("turning in", "")
    for named, by in ((unit_of(unit or ""), "given"), (group.unit, "named"), (unit_of(said), "said above")):
        number, _, one = named[1].rpartition(" ") if named and named[0] == "rate" else ("", "", "")
        # A larger one in a name is the range.
        if one and (by == "given" or float(number or 1) <= 1):
            return one, float(number or 1), by
    if "gscale" in table.settings:
        # <https://docs.gyroflow.xyz/app/technical-details/gcsv-format>: rad/s in one count.
        return "rad/s", float(table.settings["gscale"]), "scale in the header"
    names = {name.lower() for name in table.names}
    for maker, own, settings, of_maker in rules.MAKERS:
        if own <= names and settings <= table.settings.keys():
            return of_maker, 1.0, f"as {maker} writes them"
    beside = [g for g in groups(table) if g.kind == "acceleration" and len(g.columns) == 3]
    try:
        if beside and (found := _by_gravity(t, values, table.array(beside[0])[rows])):
            return found, 1.0, "by the gravity beside them"
    except Unreadable:
        pass
    if odd := re.search(r"[\[(]([^\[\]()]+/s\w*)[\])]", table.names[group.columns[0]] + f"[{table.units[group.columns[0]]}]"):
        raise Unreadable(f"the unit {odd[1]!r} of {table.names[group.columns[0]]!r} is not known: give --unit")
    unit = plausible_rate(values, t)
    if group.unit == ("counts", "") or (unit == "mdps" and (values == np.round(values)).all()):
        raise Unreadable(
            f"{', '.join(repr(table.names[k]) for k in group.columns)} are counts of up to {np.abs(values).max():.0f} "
            "without a unit: give what one is, as --unit 0.061deg/s"
        )
    return unit, 1.0, BY_SIZE


def read(tables: list[Table], path: Path, form: str, asked: Asked, notes: list[str]) -> Recording:
    """Returns the gyroscope of a file's tables."""
    tables = [table for table in tables if len(table)]
    if not tables:
        raise Unreadable("no rows of samples")
    for table in tables:
        # With commas some loggers write w first.
        if not table.named and len(table.names) in UNNAMED and (len(table.names) != 8 or table.dialect.delimiter is None):
            _name(table)
    if asked.unit and not is_unit(asked.unit):
        raise Unreadable(f"unit {asked.unit!r}: {UNITS}")
    if asked.time_unit and not is_time_unit(asked.time_unit):
        raise Unreadable(f"unit of times {asked.time_unit!r}: {OF_TIME}")
    topic, part, given = asked.topic, 0, None
    if topic and (cut := re.fullmatch(r"(.*?)\s*part (\d+)", topic)):
        topic, part = cut[1] or None, int(cut[2])
    if asked.columns:
        table, group, given = _asked_columns(tables, asked.columns, asked.unit)
    else:
        table, group = choose(tables, path, topic)
    values = table.array(group)
    is_oriented = len(group.columns) > 3 or group.kind == "angles"
    valid = np.isfinite(values).all(axis=1) & (np.abs(values).max(axis=1) > 0 if len(group.columns) > 3 else True)
    rows = np.flatnonzero(valid)
    if not len(rows):
        raise Unreadable("no rows of samples")
    clock = Clock(table, group, rows, asked.rate, asked.time_unit, part)
    times: Times = clock.find(given)
    notes = [*notes, *clock.notes]
    if missing := len(table) - len(clock.rows) - (len(rows) - len(clock.rows) if part else 0):
        notes.append(f"{missing} rows without numbers are left out")
    t, w, by = times.ns, values[clock.rows], ""
    if is_oriented:
        t, w, of_rates, more = _of_orientations(table, group, w, t, asked.unit)
        notes += more
    else:
        unit, scale, by = _unit_of_rates(table, group, w, t, asked.unit, clock.rows)
        w = w * scale * RATE_UNITS[unit]
        kind = "" if group.kind or by != BY_SIZE else f", {NAMELESS}"
        names = ", ".join(repr(table.names[k]) for k in group.columns)
        of_rates = f"rates of {names} in {f'{scale:g} ' if scale != 1 else ''}{unit} ({by}){kind}"
    step = float(np.median(np.diff(t))) * 1e-9 if len(t) > 1 else 0.0
    first = int(t[0]) if len(t) else 0
    begin = f"{first * 1e-9:.3f} s" if first < 10**18 else str(np.datetime64(first, "ns")).rstrip("0")
    of_table = f"{table.name}, " if table.name else ""
    words = f"{form}: {of_table}{times.form}, {of_rates}, {1 / step if step > 0 else 0:.4g} Hz, from {begin}"
    topic = table.name or (table.names[times.columns[0]] if times.columns else None)
    out = Recording(path, words, t, w, notes=notes, topic=topic, unit_by=by)
    if times.columns and table.lines and not (times.is_moment and times.columns[1:]):
        out.layout = {
            "columns": times.columns,
            "unit": times.unit,
            "moment": times.is_moment,
            "first": table.lines[0],
            "added": times.added,
            "dialect": [table.dialect.delimiter, table.dialect.decimal],
        }
    return out


def _name(table: Table) -> None:
    """Names the columns of a file that has none, if the values are those of the layout."""
    known = UNNAMED[len(table.names)]
    if "frame" in known and table.is_numeric(2):
        return
    trial = Table(table.name, known, table.columns, lines=table.lines, dialect=table.dialect, flaw=table.flaw)
    try:
        for group in groups(trial):
            if _is_orientation(trial, group) if len(group.columns) > 3 else group.kind in ("rate", None) and trial.array(group).any():
                table.names, table.named = known, True
                return
    except Unreadable:
        return
