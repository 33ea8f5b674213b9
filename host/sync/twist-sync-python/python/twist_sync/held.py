"""Values that a logger holds: rows that repeat the sample of a slower sensor.

A row shows a new sample of the sensor if its values differ from those of the row before. Its time is

* that of the row, if the rows follow the sensor: the rows with new samples are then evenly spaced,
  whatever lies between them;
* before that of the row and after that of the row before, if the sensor runs by its own clock and
  the logger asks for its latest value. The sensor's rate is even, so a line through the middles of
  these intervals gives the times: the more often the two slip against each other, the better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Least share of rows of a moving body that repeat the row before.
LEAST_HELD = 0.003
#: Rows with new samples whose times scatter by less than this part of their distance from the row
#: before are those of the sensor, and by more than the second are no even rate. At random they
#: scatter by 0.29 of it.
EVEN, UNEVEN = 0.15, 0.4
#: Least number of slips with which the line is known, and longest stretch of one line, s.
LEAST_SLIPS, LONGEST_LINE_S = 5, 60.0
#: Length without a slip, s, after which the sensor's clock is taken for that of the rows.
LOCKED_S = 10.0
#: Part of the roughness that times of their own leave of one or the other reading, at most.
SMOOTHER = 0.7


@dataclass
class Held:
    """Rows with new samples, their times in ns, the 1-sigma of these times in s that nothing in
    the file settles, a sentence, and True if that is a warning."""

    rows: np.ndarray
    t: np.ndarray
    open_s: float
    note: str
    is_doubtful: bool = False


def samples(t: np.ndarray, w: np.ndarray) -> Held | None:
    """Returns the samples of a slower sensor whose values are held; None if there are none such.

    Args:
        t: Times of the rows, ns, shape (n,).
        w: Their values, shape (n, 3).
    """
    new = np.r_[True, (np.diff(w, axis=0) != 0).any(axis=1)]
    moving = _moving(w, new)
    if moving.sum() < 50 or 1 - new[moving].mean() < LEAST_HELD:
        return None
    rows = np.flatnonzero(new)[1:]
    first, before, of_motion = t[rows] * 1.0 - t[0], t[rows - 1] * 1.0 - t[0], moving[rows]
    runs = np.diff(rows)[of_motion[1:] & of_motion[:-1]]
    if len(runs) < 20:
        return None
    gap, slips = float(np.median(first - before)), int((runs != np.median(runs)).sum())
    share = f"{1 - len(rows) / len(w):.0%} of its rows repeat the values before"
    if not slips or _off_line(_numbered(first), first, of_motion)[1] < EVEN * gap:
        said = f"{share}: the first row of each value is taken"
        if not slips:
            said += f"; if the sensor has a clock of its own, it is up to {gap * 1e-6:.3g} ms older"
        is_short = not slips and float(first[-1]) < LOCKED_S * 1e9
        return Held(rows, t[rows], gap * 1e-9 / 12**0.5 if is_short else 0.0, said, not slips)
    number = _numbered((first + before) / 2)
    line, scatter = _off_line(number, (first + before) / 2, of_motion)
    is_even = scatter < UNEVEN * gap
    # The two readings differ where the number of rows of a value does.
    all_runs = np.diff(rows, prepend=rows[0] - np.median(runs))
    differ = of_motion & (np.convolve(all_runs != np.median(runs), np.ones(3), "same") > 0)
    if is_even and _roughness(line, w[rows], differ) > SMOOTHER * _roughness(first, w[rows], differ):
        # Single samples that a faulty stream copies, each of which is missing elsewhere.
        return None
    if not is_even and 1 - new[moving].mean() < 0.2:
        return None
    # Where in its interval the line is: it may lie anywhere between two of these places.
    phase = np.sort(((line - before) / np.maximum(first - before, 1))[of_motion] % 1)
    free = float(np.diff(np.r_[phase, phase[0] + 1]).max())
    if not is_even or slips < LEAST_SLIPS:
        free = 1.0
    open_s = gap * 1e-9 / 12**0.5 * max(free, 1 / max(slips, 1), len(rows) ** -0.5)
    said = f"{share}: they are those of a slower sensor with a clock of its own, whose samples lie between the rows"
    return Held(rows, t[0] + np.round(line).astype(np.int64), open_s, f"{said} (± {max(open_s * 1e6, 1):.3g} µs)")


def _moving(w: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Returns True for rows about which the values change by far more than their steps: at rest
    coarse values repeat by themselves."""
    change = np.abs(np.diff(w, axis=0))
    step = np.array([c[c > 0].min(initial=np.inf) for c in change.T])
    wide = np.abs(w[10:] - w[:-10])
    out = np.zeros(len(w), bool)
    out[5 : 5 + len(wide)] = (wide > 20 * step).any(axis=1)
    return out


def _numbered(middles: np.ndarray) -> np.ndarray:
    """Returns the numbers of samples of an even rate, some of which may be missing."""
    far = min(100, len(middles) - 1)
    step = float(np.median(middles[far:] - middles[:-far])) / far
    number, at = np.zeros(len(middles), np.int64), float(middles[0])
    for k in range(1, len(middles)):
        more = max(round((middles[k] - at) / step), 1)
        at += more * step
        at += 0.02 * (middles[k] - at)
        number[k] = number[k - 1] + more
    return number


def _off_line(number: np.ndarray, times: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns times on lines through the chosen ones, stretch by stretch, and their scatter."""
    line, scatter = times.copy(), []
    parts = max(int((times[-1] - times[0]) * 1e-9 / LONGEST_LINE_S), 1)
    for part in np.array_split(np.arange(len(times)), parts):
        own = part[chosen[part]]
        if len(own) < 20:
            continue
        fit = np.polynomial.Polynomial.fit(number[own], times[own], 1)
        line[part] = fit(number[part])
        scatter.append(float(np.std(times[own] - fit(number[own]))))
    return line, float(np.median(scatter)) if scatter else np.inf


def _roughness(t: np.ndarray, w: np.ndarray, chosen: np.ndarray) -> float:
    """Returns by how much values differ from the cubic through two neighbours on either side."""
    around, out = [t[k : len(t) - 4 + k] for k in (0, 1, 3, 4)], np.zeros((len(t) - 4, 3))
    for k, own in enumerate(around):
        others = [other for j, other in enumerate(around) if j != k]
        weight = np.prod([(t[2:-2] - o) / np.where(own == o, 1, own - o) for o in others], axis=0)
        out += weight[:, None] * w[(0, 1, 3, 4)[k] :][: len(out)]
    return float(np.median(np.linalg.norm(out - w[2:-2], axis=1)[chosen[2:-2]]))
