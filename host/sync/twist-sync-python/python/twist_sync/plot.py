"""Plots with matplotlib: ``pip install "twist-sync[plot]"``."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import Course, Estimate, Floats, Refused, Unreadable, _seconds
from ._recording import Recording
from .network import Pair, Synchronized
from .report import SIGMAS_95, object_of, size, supported

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Length of the part of a long recording that is drawn in detail, s.
DETAIL_S = 10.0
POINTS = 4000
HINT = 'plots need matplotlib: pip install "twist-sync[plot]"'
#: Colours of the first, the second before and after, that differ in print and for the colour-blind.
A, BEFORE, AFTER = "tab:blue", "0.7", "tab:orange"


def twist(t_a: ArrayLike, w_a: ArrayLike, t_b: ArrayLike, w_b: ArrayLike, found: Estimate) -> Figure:
    """Draws a twist: both gyroscopes before and after, the residual, and the offset over time."""
    both = [
        Recording(Path(name), "", np.round((_seconds(t) - _seconds(t)[0]) * 1e9).astype(np.int64), np.asarray(w))
        for name, t, w in (("a", t_a, w_a), ("b", t_b, w_b))
    ]
    first, second = _seconds(t_a)[0], _seconds(t_b)[0]
    moved = found._moved(first, second - first)
    return figure(Synchronized(both, [Pair(0, 1, moved, None)], None, Refused("")))


def save(path: Path, solved: Synchronized) -> None:
    """Draws each pair, side by side.

    Raises:
        Unreadable: There is no matplotlib, or no such kind of picture.
    """
    try:
        import matplotlib
    except ImportError:
        raise Unreadable(HINT) from None
    matplotlib.use("Agg")
    try:
        figure(solved).savefig(path, dpi=100)
    except ValueError as error:
        raise Unreadable(f"{path}: {error}") from None


def figure(solved: Synchronized) -> Figure:
    """Returns the drawing: a column for each pair, the verdict as its title."""
    import matplotlib.pyplot as plt

    found, count = object_of(solved), len(solved.pairs)
    rows = 4 if any(pair.found for pair in solved.pairs) else 2
    out, panels = plt.subplots(rows, count, figsize=(10 * count, 3.2 * rows + 1), layout="constrained", squeeze=False)
    if count > 1:
        out.suptitle(found["verdict"]["text"], fontsize=14)
    for pair, own, column in zip(solved.pairs, found["pairs"], panels.T, strict=True):
        if pair.found is None:
            why = found["verdict"]["text"] if count == 1 else f"NOT RELATED: {own['reasons'][0]}"
            column[0].set_title("\n".join(textwrap.wrap(why, 100)), fontsize=10)
            _refusal(column, solved, pair, own)
        else:
            text = f"{own['b']} on the clock of {own['a']}: to ± {size(own['largest_95_s'])} (95 %), {own['agree']}"
            column[0].set_title(text if count > 1 else found["verdict"]["text"], fontsize=10)
            _relation(column, solved, pair)
    return out


def _envelope(panel: Any, t: Floats, values: Floats, **more: Any) -> None:
    """Draws a line, or its extremes for long recordings."""
    step = len(t) // POINTS
    if step >= 2:
        count = len(t) // step
        blocks = values[: count * step].reshape(count, step)
        values = np.column_stack([blocks.min(axis=1), blocks.max(axis=1)]).ravel()
        t = np.repeat(t[: count * step : step], 2)
    panel.plot(t, values, **more)


def _both(solved: Synchronized, pair: Pair) -> tuple[Recording, Floats, Recording, Floats]:
    a, b = solved.recordings[pair.a], solved.recordings[pair.b]
    return a, (a.t - a.t[0]) * 1e-9, b, (b.t - b.t[0]) * 1e-9


def _refusal(panels: Any, solved: Synchronized, pair: Pair, own: dict[str, Any]) -> None:
    """Draws what is refused and by how much each gate is passed or missed."""
    a, t_a, b, t_b = _both(solved, pair)
    for r, t, color in ((a, t_a, A), (b, t_b, AFTER)):
        _envelope(panels[0], t, np.linalg.norm(r.w, axis=1), lw=0.8, color=color, label=r.name)
    panels[0].set(ylabel="rate, rad/s", xlabel="s from each one's first sample")
    panels[0].legend(loc="upper right")
    for panel in panels[2:]:
        panel.set_visible(False)
    gates = list({gate["name"]: gate for gate in own["gates"]}.values())
    for k, gate in enumerate(gates):
        ratio = np.clip(abs(gate["value"]) / max(abs(gate["limit"]), 1e-12), 1e-3, 1e3)
        panels[1].barh(k, np.log10(ratio), color="tab:green" if gate["passed"] else "tab:red")
        said = f"{gate['name']}: {gate['value']:.3g}, limit {gate['limit']:.3g} {gate['unit']}"
        panels[1].text(0.01, k, said, va="center", transform=panels[1].get_yaxis_transform(), fontsize=9)
    text = "\n".join(line for reason in own["reasons"] for line in textwrap.wrap(reason, 110))
    if gates:
        panels[1].axvline(0, color="black", lw=1)
        panels[1].set(yticks=[], xlim=(-6, 3.2), xticks=[-3, 0, 3], xticklabels=["1/1000", "the limit", "1000 times"])
        panels[1].invert_yaxis()
        panels[1].set_title(text, fontsize=9, loc="left")
    else:
        panels[1].set_axis_off()
        panels[1].text(0, 1, text, va="top", fontsize=11)


def _relation(panels: Any, solved: Synchronized, pair: Pair) -> None:
    a, t_a, b, t_b = _both(solved, pair)
    found = pair.found
    on_a = pair.relation.b_to_a(t_b)
    there = np.column_stack([np.interp(on_a, t_a, a.w[:, k]) for k in range(3)])
    # Where a has no samples there is nothing to compare with.
    gaps = np.diff(t_a)[np.clip(np.searchsorted(t_a, on_a) - 1, 0, len(t_a) - 2)]
    there[(on_a < t_a[0]) | (on_a > t_a[-1]) | (gaps > 0.05)] = np.nan
    looks = supported(pair, solved)
    near = np.zeros(len(on_a), bool)
    near[np.isfinite(there[:, 0])] = True
    if isinstance(found, Estimate):
        there = there @ found.calibration.T + found.bias
    elif found is not None:
        for start, end in found.unsupported:
            near &= (on_a < start) | (on_a > end)
        some = np.flatnonzero(near)
        some = some[:: max(len(some) // 100_000, 1)]
        matrix = np.linalg.lstsq(np.column_stack([there[some], np.ones(len(some))]), b.w[some], rcond=None)[0]
        there = there @ matrix[:3] + matrix[3]
    speed = np.where(near, np.linalg.norm(there, axis=1), 0)
    centre = on_a[int(np.argmax(np.nan_to_num(speed)))]
    low, high = max(on_a[0], t_a[0]), min(on_a[-1], t_a[-1])
    if high - low > 3 * DETAIL_S:
        low, high = max(low, centre - DETAIL_S / 2), min(high, centre + DETAIL_S / 2)
    part = (on_a >= low) & (on_a <= high)
    axis = int(np.argmax(np.nanstd(there[part], axis=0)))
    before = (t_b >= low) & (t_b <= high)
    panels[0].plot(t_b[before], b.w[before, axis], color=BEFORE, lw=1, label=f"{b.name} before, from its first sample")
    panels[0].plot(on_a[part], there[part, axis], color=A, lw=3.5, alpha=0.5, label=f"{a.name}, in the axes of {b.name}")
    panels[0].plot(on_a[part], b.w[part, axis], color=AFTER, lw=1, label=f"{b.name} after")
    panels[0].set(ylabel=f"{'xyz'[axis]}, rad/s", xlim=(low, high))
    whole = panels[1]
    _envelope(whole, t_a, np.linalg.norm(a.w, axis=1), color=A, lw=2, alpha=0.5, label=a.name)
    _envelope(whole, on_a, np.linalg.norm(b.w, axis=1), color=AFTER, lw=0.7, label=f"{b.name} after")
    whole.set_ylabel("rate, rad/s")
    rest = (b.w - there) * 1e3
    for k in range(3):
        _envelope(panels[2], on_a, rest[:, k], lw=0.5, label="xyz"[k])
    # Stretches that were left out must not flatten the rest.
    panels[2].set_ylim(*(np.nanquantile(np.abs(rest[near]), 0.99) * 3 * np.array([-1, 1]) if near.any() else (-1, 1)))
    panels[2].set_ylabel("residual, mrad/s")
    apart = found.unsupported if isinstance(found, Course) else [(own.start, own.end) for own in found.report.left_out]
    for panel in panels[:4]:
        for start, end in apart:
            panel.axvspan(start, end, color="tab:pink", alpha=0.2, lw=0)
    panels[0].set_xlim(low, high)
    _offset(panels[3], pair, looks)
    for panel in panels:
        panel.set_xlabel(f"s from the first sample of {a.name}")
        panel.legend(loc="upper right")


def _offset(panel: Any, pair: Pair, looks: Floats) -> None:
    """Draws the offset over time with its sigma, minus a straight line."""
    there = pair.relation.at(looks)
    offset, sigma = np.asarray(there.offset), SIGMAS_95 * there.offset_sigma
    slope = (offset[-1] - offset[0]) / (looks[-1] - looks[0]) if looks[-1] > looks[0] else 0.0

    def rest(times: Floats, values: Floats) -> Floats:
        return (values - offset[0] - slope * (times - looks[0])) * 1e6

    if isinstance(pair.found, Course):
        at, values, sigmas = (np.array([getattr(e, n) for e in pair.found.estimates]) for n in ("reference", "offset", "offset_sigma"))
        panel.errorbar(at, rest(at, values), SIGMAS_95 * sigmas * 1e6, fmt=".", color=BEFORE, label="windows")
    # Not across stretches that nothing supports.
    cuts = np.flatnonzero(np.diff(looks) > 3 * np.median(np.diff(looks)) + 1e-9) + 1
    for k, own in enumerate(np.split(np.arange(len(looks)), cuts)):
        labels = ("offset", "± 95 %") if not k else (None, None)
        panel.plot(looks[own], rest(looks[own], offset[own]), color=A, label=labels[0])
        low, high = (rest(looks[own], offset[own] + sign * sigma[own]) for sign in (-1, 1))
        panel.fill_between(looks[own], low, high, alpha=0.3, color=A, label=labels[1])
    panel.set_ylabel(f"offset less\n{slope * 1e6:+.3f} ppm, µs")
