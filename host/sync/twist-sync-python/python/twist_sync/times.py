"""The times of a table's rows: of its columns, of a counter and a rate, exact to the nanosecond.

Of several columns of times the sensor's own is taken before that of an arrival, then the evener one.
Counters that wrap go on; a clock that starts again is refused with its line.
"""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np

from . import rules
from ._recording import Unreadable
from .columns import Group, Table, axis_of, kind_of, split_unit, unit_of, unnamed_times, words_of
from .rules import MORE_TIME, TIME_UNITS

_TIMES = [(rank, re.compile(rf"(?<![^\W_])(?:{words})(?![^\W_])")) for rank, words in rules.TIMES]
#: Longest distance of a gyroscope's samples by which a unit is found, and the shortest, s.
LONGEST_STEP_S, SHORTEST_STEP_S = 0.2, 1e-4
#: Share of samples that may have the time of the one before.
MOST_REPEATED = 0.2
#: Samples in a row that may be missing where a counter wraps.
MOST_SKIPPED = 20
#: Where counters of 16, 24, 31, 32 bits wrap, also of µs given in ms or s and of ticks in s; and times of
#: a minute, an hour, a day or a week, s.
MODULI = [2.0**bits / part for bits in (16, 24, 31, 32) for part in (1, 1e3, 1e6, 32768)]
PERIODS_S = (60, 3600, 86400, 604800)


class Empty(Exception):
    """A column of times without any."""


@dataclass
class Times:
    """Times of the rows in ns; the columns, unit and words that they are of, and from which lines
    how much is added."""

    ns: np.ndarray
    form: str
    columns: list[int] = field(default_factory=list)
    unit: str = "ns"
    is_moment: bool = False
    added: list[tuple[int, int]] = field(default_factory=list)


def moment(text: str) -> int:
    """Returns nanoseconds of a date and time since 1970, of UTC unless a zone is given, or of a
    time alone, which may be minutes and seconds, since its zero."""
    found = rules.MOMENT.fullmatch(text.strip())
    if not found:
        raise ValueError(f"could not read {text[:40]!r} as a time")
    one = found.groupdict()
    parts = [int(part) for part in one["clock"].split(":")]
    dated = one["y"] or one["y2"]
    if len(parts) == 2:
        parts = [*parts, 0] if dated else [0, *parts]
    if one["month"] and one["month"] not in rules.MONTHS:
        raise ValueError(f"could not read the month of {text[:40]!r}: expected {rules.MONTHS[0]} to {rules.MONTHS[-1]}")
    if one["half"]:
        parts[0] = parts[0] % 12 + 12 * (one["half"][0] in "pP")
    whole = parts[0] * 3600 + parts[1] * 60 + parts[2]
    if dated:
        month, day = (one["m"], one["d"]) if one["y"] else (one["b"], one["a"])
        if one["month"]:
            month = rules.MONTHS.index(one["month"]) + 1
        elif int(month) > 12 or (one["half"] and one["b"] and int(day) <= 12):
            # The month is first where hours are counted to twelve.
            month, day = day, month
        year = int(dated) + (2000 if len(dated) == 2 else 0)
        whole += (datetime.date(year, int(month), int(day)) - datetime.date(1970, 1, 1)).days * 86400
    whole += int(one["days"] or 0) * 86400
    if one["zone"] and one["zone"][0] in "+-":
        away = int(one["zone"][1:3]) * 3600 + int(one["zone"][3:].strip(":") or 0) * 60
        whole -= away if one["zone"][0] == "+" else -away
    return whole * 10**9 + int((one["f"] or "0")[:9].ljust(9, "0"))


def scale_of(unit: str) -> Decimal:
    """Returns the nanoseconds in one of a unit, also of one such as `1e-6 s`."""
    number, _, one = unit.rpartition(" ") if unit not in MORE_TIME else ("1", "", unit)
    return Decimal(number) * MORE_TIME[one]


def exact(text: str, dialect: Any, scale: Decimal) -> int:
    """Returns a number of a text in nanoseconds."""
    plain = dialect.plain(text)
    try:
        return round(Decimal(plain) * scale) if not plain.isdecimal() or scale != int(scale) else int(plain) * int(scale)
    except (ArithmeticError, ValueError):
        raise ValueError(f"could not convert {text[:40]!r}") from None


def nanos(table: Table, column: int, unit: str, rows: np.ndarray) -> np.ndarray:
    """Returns a column of numbers of a unit in ns, exactly, at some of the rows."""
    scale, values = scale_of(unit), table.columns[column]
    if table.is_text(column):
        try:
            return np.array([exact(values[row], table.dialect, scale) for row in rows.tolist()], dtype=np.int64)
        except OverflowError:
            raise Unreadable(
                f"times of {table.names[column]!r} of more than 19 digits of ns: give --time-unit; ticks of 100 ns since "
                "1601 or the year 1 (FILETIME, .NET) must be converted to ns since 1970"
            ) from None
    values = values[rows]
    largest = float(np.abs(values.astype(float)).max(initial=0))
    if not np.isfinite(largest) or largest * float(scale) > 9.2e18:
        raise Unreadable(f"times up to {largest:g} {unit} are none: give --time-unit")
    if scale != int(scale):
        return np.array([round(Decimal(value) * scale) for value in values.tolist()], dtype=np.int64)
    # Whole units apart, so that no digits are lost.
    whole = (values if values.dtype.kind in "iu" else np.floor(values)).astype(np.int64)
    return whole * int(scale) + np.round((values - whole) * float(scale)).astype(np.int64)


def plausible_unit(step: float, rate: float | None) -> str:
    """Returns the unit in which the samples are as far apart as those of a gyroscope, or as the
    file's own rate says."""
    if rate:
        near = {unit: abs(np.log(step * scale * 1e-9 * rate)) for unit, scale in MORE_TIME.items()}
        if near[best := min(near, key=lambda unit: near[unit])] < 0.2:
            return best
    seconds = {unit: step * MORE_TIME[unit] * 1e-9 for unit in ("s", "ms", "us", "ns", "days")}
    return next((unit for unit, own in seconds.items() if SHORTEST_STEP_S <= own <= LONGEST_STEP_S), "ns")


def rate_of(settings: dict[str, str]) -> float | None:
    """Returns the rate that a file states above its rows, Hz."""
    for name in sorted(settings, key=lambda name: ("gyr" not in name, "capture" in name)):
        if rules.OTHER_RATE.search(name):
            continue
        found = re.match(r"(\d+(?:[.,]\d+)?)", settings[name])
        if found and re.search(r"\b(rate|frequency|freq|fs|odr|sampling|sps)\b", name.replace("_", " ")):
            if 1 <= (value := float(found[1].replace(",", "."))) <= 20000:
                return value
        unit = split_unit(name)[1]
        if found and unit and unit[0] == "time" and re.search(r"\b(interval|period)\b", name):
            return float(10**9 / (Decimal(found[1].replace(",", ".")) * scale_of(unit[1])))
    return None


def _is_moment(table: Table, column: int) -> bool:
    return table.is_text(column) and rules.MOMENT.fullmatch(table.columns[column][0]) is not None


def time_columns(table: Table) -> list[tuple[int, int]]:
    """Returns rank and number of each column of times."""
    if not table.named:
        return list(enumerate(unnamed_times(table)))
    out = []
    for column, name in enumerate(table.names):
        words, unit = split_unit(name, table.units[column])
        text = " ".join(words_of(name))
        is_unit = _is_moment(table, column) or (unit is not None and unit[0] == "time")
        if rules.DURATION.search(text) or (not is_unit and (unit or axis_of(name, words))):
            continue
        rank = next((r for r, form in _TIMES if form.search(text)), 4 if is_unit else None)
        if rank is not None:
            out.append((rank, column))
    return out


class Clock:
    """The times of a group's rows; `rows` are those that have any, of one part if the clock starts
    again."""

    def __init__(self, table: Table, group: Group, rows: np.ndarray, rate: float | None, unit: str | None, part: int):
        self.table, self.group, self.rows = table, group, rows
        self.rate, self.unit, self.part = rate, (unit_of(unit or "") or ("", None))[1], part
        self.notes: list[str] = []

    def find(self, given: list[int] | None) -> Times:
        """Returns the times by the columns that are given, else by those that are found."""
        if given:
            return self._pair(*given) if len(given) == 2 else self._of(given[0])
        if self.rate:
            return self._counted(self.rate, "given")
        why, pairs = [], self._seconds_with_more()
        for column in self._ordered():
            try:
                return self._pair(*pairs[column]) if column in pairs else self._of(column)
            except Empty as error:
                why.append(str(error))
        if stated := rate_of(self.table.settings):
            return self._counted(stated, "stated in the file")
        shown = "; ".join(why) or f"no column of times among {', '.join(self.table.names)[:200]}"
        counter = self._counter()
        what = f"of the counter {self.table.names[counter]!r}" if counter is not None else "of the rows"
        raise Unreadable(f"{shown}; give --rate HZ {what}, or name the columns with --columns TIME,X,Y,Z")

    def _ordered(self) -> list[int]:
        found, names = time_columns(self.table), self.table.names
        # A column of times for each channel, of one name: the one beside it.
        left = max((k for _, k in found if k < self.group.columns[0]), default=found[0][1] if found else 0)
        found = [own for own in found if [names[k] for _, k in found].count(names[own[1]]) == 1 or own[1] == left]
        own = set(self.group.stem.split()) - {"x", "axis", "1", "time"}

        def order(rank: int, k: int) -> tuple[Any, ...]:
            kind = kind_of(words_of(names[k]))
            shares = bool(own & set(words_of(names[k]))) or kind == (self.group.kind or "rate")
            try:
                steps = np.diff(self._raw(k)[0])
            except (Empty, Unreadable):
                return (True, True, 9, True, 9.0)
            usual = np.median(steps)
            uneven, coarse = 9.0, 0.0
            if usual > 0:
                uneven = float(np.mean(np.minimum(np.abs(steps - usual) / usual, 1)))
                coarse = float(np.diff(np.unique(np.round(steps / usual, 4))).min(initial=1)) % 1
            return (rank > 8 and not shares, np.mean(steps == 0) > MOST_REPEATED, kind == "acceleration", not shares, rank, round(max(uneven, coarse), 2))

        return [k for _, k in sorted(found, key=lambda one: order(*one) if len(found) > 1 else 0)]

    def _raw(self, column: int) -> tuple[np.ndarray, bool]:
        """Returns values of a column at the rows, and True if they are dates or times of day in
        ns."""
        table, values = self.table, self.table.columns[column]
        empty = Empty(f"the column of times {table.names[column]!r} is empty")
        if table.is_text(column):
            texts = [values[row] for row in self.rows.tolist()]
            some = next((text for text in texts if text.lower() not in rules.MISSING), None)
            if some is None:
                raise empty
            if rules.MOMENT.fullmatch(some):
                try:
                    return np.array([moment(text) for text in texts], dtype=np.int64), True
                except ValueError as error:
                    raise Unreadable(f"column {table.names[column]!r}: {error}") from None
        elif values.dtype.kind == "M":
            return values[self.rows].astype("M8[ns]").astype(np.int64), True
        raw = table.numbers(column)[self.rows]
        known = raw[np.isfinite(raw)]
        if not len(known):
            raise empty
        if not np.ptp(known):
            raise Empty(f"{table.names[column]!r} is {known[0]:.10g} in each of {len(known)} rows: rounded by a spreadsheet?")
        return raw, False

    def _seconds_with_more(self) -> dict[int, tuple[int, int]]:
        """Returns columns of whole seconds, or dates, with that of the parts of a second, by either."""
        table, out = self.table, {}
        words = {k: words_of(name) for k, name in enumerate(table.names) if words_of(name)}
        more = re.compile(r"(n|nano|u|micro|m|milli)s(ec(ond)?s?)?")
        parts = {m: other for m, other in words.items() if more.fullmatch(other[-1]) and table.is_numeric(m)}
        for k, one in words.items():
            is_moment = _is_moment(table, k)
            if one[-1] not in ("sec", "secs", "seconds", "s") and not is_moment:
                continue
            for m, other in parts.items():
                if is_moment or one[:-1] == other[:-1]:
                    values, whole = table.numbers(m)[self.rows], self._raw(k)[0]
                    unit = (split_unit(table.names[m])[1] or ("", "ns"))[1]
                    fits = 0 <= values.min(initial=0) and values.max(initial=0) * TIME_UNITS.get(unit, 1) < 10**9
                    if fits and not (whole % (10**9 if is_moment else 1)).any():
                        out[k] = out[m] = (k, m)
        return out

    def _pair(self, seconds: int, more: int) -> Times:
        table, name = self.table, self.table.names[more]
        part = table.numbers(more)[self.rows]
        unit = (split_unit(name)[1] or ("", ""))[1]
        if unit not in ("ms", "us", "ns"):
            unit = "ns" if part.max(initial=0) >= 1e6 else "us"
        if part.min(initial=0) < 0 or part.max(initial=0) * TIME_UNITS[unit] >= 10**9:
            raise Unreadable(f"{name!r} is no part of a second in {unit}: up to {part.max():g}")
        raw, is_moment = self._raw(seconds)
        ns = (raw if is_moment else nanos(table, seconds, "s", self.rows)) + nanos(table, more, unit, self.rows)
        of_both = f"{table.names[seconds]!r}{'' if is_moment else ' in s'} and {name!r} in {unit}"
        return self._checked(Times(ns, of_both, [seconds, more], unit, is_moment), ns * 1.0, 1.0)

    def _of(self, column: int) -> Times:
        table, name = self.table, self.table.names[column]
        raw, is_moment = self._raw(column)
        if is_moment:
            return self._checked(Times(raw, f"{name!r}, dates or times of day", [column], "ns", True), raw * 1.0, 1.0)
        self.rows, raw = self.rows[np.isfinite(raw)], raw[np.isfinite(raw)]
        steps = np.diff(raw)
        if not (steps > 0).any():
            raise Unreadable(f"the times of {name!r} do not rise")
        step = float(np.median(steps[steps > 0]))
        named = split_unit(name, table.units[column])[1]
        stated = rate_of(table.settings)
        if self.unit:
            unit, by = self.unit, "given"
        elif "tscale" in table.settings:
            unit, by = f"{Decimal(table.settings['tscale'])} s", "scale in the header"
        elif named and named[0] == "time":
            unit, by = named[1], "named"
        elif step == 1 and np.mean(steps == 1) > 0.9:
            if stated:
                return self._counted(stated, "stated in the file", column)
            raise Unreadable(
                f"{name!r} rises by 1 a row, as counters do: give --rate HZ, or --time-unit if it is a time"
            )
        elif not stated and re.search(r"\b(ticks?|cycles?)\b", " ".join(words_of(name))):
            raise Unreadable(f"{name!r} counts ticks, of which nothing says how long one is: give --time-unit, as 30.5us")
        else:
            unit, by = plausible_unit(step, stated), "by their distance"
        scale = float(scale_of(unit))
        if not 1e-5 <= step * scale * 1e-9 <= LONGEST_STEP_S:
            raise Unreadable(
                f"times of {name!r} in {unit} ({by}) would be {step * scale * 1e-9:.3g} s apart, which no "
                "gyroscope's are: give --time-unit, or --rate HZ if it is a counter"
            )
        ns = nanos(table, column, unit, self.rows)
        return self._checked(Times(ns, f"{name!r} in {unit} ({by})", [column], unit), raw, scale)

    def _counter(self) -> int | None:
        for k, name in enumerate(self.table.names):
            if rules.COUNTER.search(" ".join(words_of(name))) and k not in self.group.columns and self.table.is_numeric(k):
                steps = np.diff(self.table.numbers(k)[self.rows])
                if len(steps) and np.median(steps) > 0 and np.mean(steps == np.median(steps)) > 0.9:
                    return k
        return None

    def _counted(self, rate: float, by: str, column: int | None = None) -> Times:
        column = self._counter() if column is None else column
        counts, name = self.rows.astype(float), "the rows' numbers"
        if column is not None:
            counts, name = self.table.numbers(column)[self.rows], repr(self.table.names[column])
        usual = float(np.median(np.diff(counts))) if len(counts) > 1 else 1.0
        more, kept = self._unwrapped(counts, name)
        counts = counts[kept] + more
        ns = np.round((counts - counts[0]) / usual * 1e9 / rate).astype(np.int64)
        return Times(ns, f"times by {name} at {rate:g} Hz ({by})")

    def _unwrapped(self, raw: np.ndarray, name: str, scale: float = 0.0) -> tuple[np.ndarray, slice]:
        """Returns what makes values, in units of `scale` ns, go on where a counter wraps, and the
        values of the part that is asked for."""
        added, steps, cuts = np.zeros(len(raw)), np.diff(raw), [0]
        moduli = MODULI + ([period * 1e9 / scale for period in PERIODS_S] if scale else [256.0])
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        far = min(20 * step, float(np.ptp(raw)) / 2 if len(raw) else 0.0)
        for k in np.flatnonzero(steps < -far).tolist():
            # One bad stamp among good ones.
            if (k + 2 < len(raw) and raw[k + 2] > raw[k] - far) or (k and raw[k + 1] > raw[k - 1] - far):
                continue
            fits = [m for m in moduli if _wraps(raw[k], raw[k + 1], m, step)]
            if fits:
                added[k + 1 :] += fits[0]
                where = self.table.line(int(self.rows[k + 1]))
                self.notes.append(f"{where}: {name} wraps at {fits[0]:.10g}; it goes on there")
            elif scale and _wraps(raw[k], raw[k + 1], 1e9 / scale, step):
                raise Unreadable(
                    f"{self.table.line(int(self.rows[k + 1]))}: {name} falls from {raw[k]:.10g} to {raw[k + 1]:.10g}, as parts of "
                    "a second do: give the seconds too, as --columns SECONDS+PARTS,X,Y,Z"
                )
            else:
                cuts.append(k + 1)
        if len(cuts) == 1:
            return added, slice(None)
        if not self.part:
            k = cuts[1]
            again = any(abs(row - self.rows[k]) <= 1 for row in self.table.restarts)
            raise Unreadable(
                f"{self.table.line(int(self.rows[k]))}: {name} falls from {raw[k - 1]:.10g} to {raw[k]:.10g}"
                f"{' under a repeated header' if again else ''}: a clock that started again. Each part is a recording: "
                f"FILE@part 1 to FILE@part {len(cuts)}"
            )
        if self.part > len(cuts):
            raise Unreadable(f"there are {len(cuts)} parts, and none is number {self.part}")
        kept = slice(*[*cuts, len(raw)][self.part - 1 : self.part + 1])
        self.rows = self.rows[kept]
        self.notes.append(f"part {self.part} of {len(cuts)}, from {self.table.line(int(self.rows[0]))}")
        return added[kept], kept

    def _checked(self, times: Times, raw: np.ndarray, scale: float) -> Times:
        """Returns times, of the values `raw` in units of `scale` ns, that go on where they wrap."""
        name, steps = self.table.names[times.columns[0]], np.diff(raw)
        if (steps == 0).any():
            same = (np.diff(self.table.array(self.group)[self.rows], axis=0) == 0).all(axis=1) & (steps == 0)
            if same.any():
                once = np.r_[True, ~same]
                self.rows, raw, times.ns, steps = self.rows[once], raw[once], times.ns[once], steps[~same]
                self.notes.append(f"{same.sum()} rows repeat both time and values of the one before: left out")
        if not steps.any():
            raise Unreadable(f"times of {name!r} are the same in all rows; give --rate HZ of the rows")
        share = float(np.mean(steps == 0))
        if share > MOST_REPEATED:
            step = np.median(steps[steps > 0]) * scale * 1e-9 if (steps > 0).any() else 0
            hint = "; a spreadsheet that saves minutes and seconds does this: export it again without" if times.is_moment else ""
            raise Unreadable(
                f"times of {name!r} have steps of {step:.3g} s, which some {round(1 / max(1 - share, 1e-9))} rows share{hint}; "
                "or give --rate HZ of the rows"
            )
        added, kept = self._unwrapped(raw, repr(name), scale)
        more = np.array([round(a * scale) for a in added.tolist()] if added.any() else added, dtype=np.int64)
        times.ns, times.form = times.ns[kept] + more, f"times of {times.form}"
        lines = self.table.lines
        times.added = [(lines[self.rows[k + 1]], int(more[k + 1] - more[k])) for k in np.flatnonzero(np.diff(more)) if lines]
        return times


def _wraps(before: float, after: float, modulus: float, step: float) -> bool:
    """Returns True if a counter of this size, with a sign or without, wraps between these."""
    near = MOST_SKIPPED * step
    return 0 < after + modulus - before <= near and (
        (modulus - near <= before <= modulus + step and -step <= after <= near)
        or (modulus / 2 - near <= before <= modulus / 2 and -modulus / 2 <= after <= -modulus / 2 + near)
    )
