"""Plots with matplotlib: ``pip install "twist-sync[plot]"``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from . import Course, Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _seconds(t: ArrayLike) -> np.ndarray:
    t = np.asarray(t)
    return t * 1e-9 if np.issubdtype(t.dtype, np.integer) else t


def twist(
    t_a: ArrayLike, w_a: ArrayLike, t_b: ArrayLike, w_b: ArrayLike, found: Estimate
) -> Figure:
    """Both gyroscopes in the axes and on the time of one, the residual, what was left out."""
    import matplotlib.pyplot as plt

    t_a, t_b = _seconds(t_a), _seconds(t_b)
    w_a, w_b = np.asarray(w_a), np.asarray(w_b)
    on_a = found.clock.b_to_a(t_b)
    turned = w_a @ found.calibration.T + found.bias
    there = np.column_stack([np.interp(on_a, t_a, turned[:, k]) for k in range(3)])
    inside = (on_a >= t_a[0]) & (on_a <= t_a[-1])
    there[~inside] = np.nan
    figure, panels = plt.subplots(4, 1, sharex=True, figsize=(9, 9), layout="constrained")
    for k, panel in enumerate(panels[:3]):
        panel.plot(on_a - t_a[0], there[:, k], lw=4, alpha=0.4, label="a, in the axes of b")
        panel.plot(on_a - t_a[0], w_b[:, k], lw=1, label="b")
        panel.set_ylabel(f"{'xyz'[k]}, rad/s")
    panels[0].legend(loc="upper right")
    panels[3].plot(on_a - t_a[0], (w_b - there) * 1e3, lw=0.5)
    # What was left out must not press the rest flat.
    limit = 8e3 * (found.report.residual_rms or 1e-3)
    panels[3].set_ylim(-limit, limit)
    panels[3].set_ylabel("b − a, mrad/s")
    panels[3].set_xlabel("s from the first sample of a")
    for stretch in found.report.left_out:
        for panel in panels:
            panel.axvspan(stretch.start, stretch.end, color="tab:pink", alpha=0.2)
    clock = found.clock
    figure.suptitle(
        f"offset {clock.offset:.6f} s ± {clock.offset_sigma * 1e6:.2f} µs, "
        f"skew {clock.skew * 1e6:+.1f} ± {clock.skew_sigma * 1e6:.1f} ppm"
    )
    return figure


def course(found: Course) -> Figure:
    """The estimates of the windows and the smoothed course, less a straight line."""
    import matplotlib.pyplot as plt

    first, last = found.span
    t = np.linspace(first, last, 300)
    offset, sigma = found.offsets(t)
    slope = (offset[-1] - offset[0]) / (last - first) if last > first else 0.0

    def rest(times: np.ndarray, values: np.ndarray) -> np.ndarray:
        return (values - offset[0] - slope * (times - first)) * 1e6

    figure, panel = plt.subplots(figsize=(9, 4), layout="constrained")
    at = np.array([e.reference for e in found.estimates])
    values = np.array([e.offset for e in found.estimates])
    sigmas = np.array([e.offset_sigma for e in found.estimates])
    panel.errorbar(at - first, rest(at, values), sigmas * 1e6, fmt=".", label="windows")
    panel.plot(t - first, rest(t, offset), label="smoothed")
    panel.fill_between(
        t - first, rest(t, offset - sigma), rest(t, offset + sigma), alpha=0.3, label="± 1 sigma"
    )
    panel.set_xlabel("s")
    panel.set_ylabel(f"b − a less {slope * 1e6:+.3f} ppm, µs")
    panel.legend()
    return figure
