"""Plots with matplotlib: ``pip install "twist-sync[plot]"``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import Clock, Course, Estimate, Floats, Unreadable
from ._recording import Recording
from .network import Pair, Synchronized

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Length of the part of a long recording that is drawn in detail, s.
DETAIL_S = 10.0
POINTS = 4000
HINT = 'plots need matplotlib: pip install "twist-sync[plot]"'


def _seconds(t: ArrayLike) -> Floats:
    t = np.asarray(t)
    return t * 1e-9 if t.dtype.kind in "iu" else t


def twist(
    t_a: ArrayLike, w_a: ArrayLike, t_b: ArrayLike, w_b: ArrayLike, found: Estimate
) -> Figure:
    """Draws a twist: both gyroscopes before and after, the residual, and the offset over time."""
    return _figure(
        [(_seconds(t_a), np.asarray(w_a), _seconds(t_b), np.asarray(w_b), found, ("a", "b"))]
    )


def save(path: Path, solved: Synchronized) -> None:
    """Draws each pair that is related, side by side.

    Raises:
        Unreadable: There is no matplotlib, or no such kind of picture.
    """
    try:
        import matplotlib
    except ImportError:
        raise Unreadable(HINT) from None
    matplotlib.use("Agg")
    pairs = [_of_pair(solved.recordings, pair) for pair in solved.pairs]
    figure = _figure(pairs)
    try:
        figure.savefig(path, dpi=100)
    except ValueError as error:
        raise Unreadable(f"{path}: {error}") from None


def _of_pair(recordings: list[Recording], pair: Pair) -> tuple[Any, ...]:
    a, b = recordings[pair.a], recordings[pair.b]
    t_a, t_b = (r.t - r.t[0] for r in (a, b))
    return t_a * 1e-9, a.w, t_b * 1e-9, b.w, pair.found, (a.name, b.name)


def _figure(pairs: list[tuple[Any, ...]]) -> Figure:
    import matplotlib.pyplot as plt

    rows = plt.subplots(
        6, len(pairs), figsize=(9 * len(pairs), 12), layout="constrained", squeeze=False
    )
    for column, pair in enumerate(pairs):
        _draw([row[column] for row in rows[1]], *pair)
    return rows[0]


def _envelope(panel: Any, t: Floats, values: Floats, **more: Any) -> None:
    """Draws a line, or its extremes for long recordings."""
    step = len(t) // POINTS
    if step < 2:
        panel.plot(t, values, **more)
        return
    count = len(t) // step
    blocks = values[: count * step].reshape(count, step)
    both = np.column_stack([blocks.min(axis=1), blocks.max(axis=1)]).ravel()
    panel.plot(np.repeat(t[: count * step : step], 2), both, **more)


def _draw(
    panels: list[Any],
    t_a: Floats,
    w_a: Floats,
    t_b: Floats,
    w_b: Floats,
    found: Estimate | Course | None,
    names: tuple[str, str],
) -> None:
    first, motion = t_a[0], np.linalg.norm(w_a, axis=1)
    before = panels[0]
    _envelope(before, t_a - first, motion, lw=1.5, alpha=0.6, label=names[0])
    _envelope(before, t_b - t_b[0], np.linalg.norm(w_b, axis=1), lw=0.8, label=names[1])
    before.set(ylabel="rate, rad/s", xlabel="s from each one's first sample", title="before")
    before.legend(loc="upper left")
    if found is None:
        for panel in panels[1:]:
            panel.set_axis_off()
        before.set_title(f"{names[1]} - {names[0]}: REFUSED")
        return
    relation = found.clock if isinstance(found, Estimate) else found
    on_a = relation.b_to_a(t_b)
    inside = (on_a >= t_a[0]) & (on_a <= t_a[-1])
    there = np.column_stack([np.interp(on_a, t_a, w_a[:, k]) for k in range(3)])
    # Where a has no samples there is nothing to compare with.
    gaps = np.diff(t_a)[np.clip(np.searchsorted(t_a, on_a) - 1, 0, len(t_a) - 2)]
    there[~inside | (gaps > 0.05)] = np.nan
    if isinstance(found, Estimate):
        there = there @ found.calibration.T + found.bias
    else:
        good = np.flatnonzero(np.isfinite(there[:, 0]))
        some = good[:: max(len(good) // 100_000, 1)]
        more = np.column_stack([there[some], np.ones(len(some))])
        matrix = np.linalg.lstsq(more, w_b[some], rcond=None)[0]
        there = there @ matrix[:3] + matrix[3]
    centre = t_a[int(np.argmax(np.where((t_a >= on_a[0]) & (t_a <= on_a[-1]), motion, 0)))]
    shown = (on_a[0], on_a[-1])
    if shown[1] - shown[0] > 6 * DETAIL_S:
        shown = (centre - DETAIL_S / 2, centre + DETAIL_S / 2)
    part = (on_a >= shown[0]) & (on_a <= shown[1])
    for k, panel in enumerate(panels[1:4]):
        panel.plot(
            on_a[part] - first,
            there[part, k],
            lw=4,
            alpha=0.4,
            label=f"{names[0]}, in the axes of {names[1]}",
        )
        panel.plot(on_a[part] - first, w_b[part, k], lw=1, label=names[1])
        panel.set_ylabel(f"{'xyz'[k]}, rad/s")
    panels[1].set_title("after")
    panels[1].legend(loc="upper left")
    rest = (w_b - there) * 1e3
    for k in range(3):
        _envelope(panels[4], on_a - first, rest[:, k], lw=0.5, label="xyz"[k])
    # Stretches that were left out must not flatten the rest.
    panels[4].set_ylim(*(np.nanquantile(np.abs(rest), 0.99) * 3 * np.array([-1, 1])))
    panels[4].set(ylabel="residual, mrad/s")
    panels[4].legend(loc="upper left")
    if isinstance(found, Estimate):
        for stretch in found.report.left_out:
            for panel in panels[1:5]:
                panel.axvspan(stretch.start, stretch.end, color="tab:pink", alpha=0.2)
    _offset(panels[5], found, (max(on_a[0], t_a[0]), min(on_a[-1], t_a[-1])), first, names[0])
    stated = relation.at(
        first + found.clock.reference
        if isinstance(found, Estimate)
        else 0.5 * (on_a[0] + on_a[-1])
    )
    before.set_title(
        f"{names[1]} - {names[0]}: ± {stated.offset_sigma * 1e6:.2f} µs, "
        f"skew {stated.skew * 1e6:+.1f} ± {stated.skew_sigma * 1e6:.1f} ppm"
    )


def _offset(
    panel: Any, found: Estimate | Course, span: tuple[float, float], zero: float, name: str = "a"
) -> None:
    """Draws the offset over time with its sigma, minus a straight line."""
    first, last = span
    t = np.linspace(first, last, 300)
    relation: Clock | Course = found.clock if isinstance(found, Estimate) else found
    there = relation.at(t)
    offset, sigma = np.asarray(there.offset), there.offset_sigma
    slope = (offset[-1] - offset[0]) / (last - first) if last > first else 0.0

    def rest(times: Floats, values: Floats) -> Floats:
        return (values - offset[0] - slope * (times - first)) * 1e6

    if isinstance(found, Course):
        at = np.array([e.reference for e in found.estimates])
        values = np.array([e.offset for e in found.estimates])
        sigmas = np.array([e.offset_sigma for e in found.estimates])
        panel.errorbar(at - zero, rest(at, values), sigmas * 1e6, fmt=".", label="windows")
    panel.plot(
        t - zero, rest(t, offset), label="smoothed" if isinstance(found, Course) else "offset"
    )
    panel.fill_between(
        t - zero, rest(t, offset - sigma), rest(t, offset + sigma), alpha=0.3, label="± 1 sigma"
    )
    panel.set_xlabel(f"s from the first sample of {name}")
    panel.set_ylabel(f"offset less\n{slope * 1e6:+.3f} ppm, µs")
    panel.legend(loc="upper left")
