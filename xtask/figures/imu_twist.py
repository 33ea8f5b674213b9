"""Plots a CSV of `smartdepthsync imu`: angular rate and specific force.

usage: imu_twist.py CSV SVG
"""

import io
import re
import sys
from pathlib import Path

import matplotlib

matplotlib.use("svg")
# The same samples give the same file.
matplotlib.rcParams["svg.hashsalt"] = "imu_twist"
# Text as text, not as outlines of its letters.
matplotlib.rcParams["svg.fonttype"] = "none"

import matplotlib.pyplot as plt
import pandas as pd

# 50 of the 500 samples a second: one a point of width, and the tremor of hands
# (up to 12 Hz) still shows.
EVERY = 10


def compact(svg: str) -> str:
    """The same picture with paths on one line each, to a tenth of a point."""

    def path(match: re.Match) -> str:
        rounded = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.1f}", match[1])
        line = " ".join(rounded.split())
        # Points after M are ends of lines even without an L.
        return f' d="{line if "Q" in line else line.replace(" L ", " ")}"'

    svg = re.sub(r"\sd=\"([^\"]*)\"", path, svg)
    # Groups of one.
    return re.sub(r"<g>\s*(<[^<>]*/>)\s*</g>", r"\1", svg)


source, target = sys.argv[1:3]
table = pd.read_csv(source).iloc[::EVERY]
time = table["time_s"] - table["time_s"].iloc[0]

figure, (rate, force) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
for axis, colour in zip("xyz", ("tab:red", "tab:green", "tab:blue")):
    rate.plot(time, table[f"gyro_{axis}_rad_s"], color=colour, linewidth=0.8, label=axis)
    force.plot(time, table[f"accel_{axis}_m_s2"], color=colour, linewidth=0.8, label=axis)
rate.set_ylabel("angular rate, rad/s")
rate.set_title(f"Simulated hand twist: every {EVERY}th sample of smartdepthsync imu --csv")
rate.legend(loc="upper left", ncols=3)
force.set_ylabel("specific force, m/s²")
force.set_xlabel("board time since the first sample, s")
rate.tick_params(bottom=False)
for panel in (rate, force):
    panel.grid(alpha=0.3)

# No metadata at all: it would name the day and the version that drew it.
metadata = dict.fromkeys(["Creator", "Date", "Format", "Type"])
svg = io.StringIO()
figure.savefig(svg, format="svg", metadata=metadata)
Path(target).write_text(compact(svg.getvalue()), encoding="utf-8")
