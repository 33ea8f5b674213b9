"""Plots a CSV of `smartdepthsync imu`: angular rate and specific force.

usage: imu_twist.py CSV SVG
"""

import sys

import matplotlib

matplotlib.use("svg")
# The same samples give the same file.
matplotlib.rcParams["svg.hashsalt"] = "imu_twist"

import matplotlib.pyplot as plt
import pandas as pd

source, target = sys.argv[1:3]
table = pd.read_csv(source)
time = table["time_s"] - table["time_s"].iloc[0]

figure, (rate, force) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
for axis, colour in zip("xyz", ("tab:red", "tab:green", "tab:blue")):
    rate.plot(time, table[f"gyro_{axis}_rad_s"], color=colour, linewidth=0.8, label=axis)
    force.plot(time, table[f"accel_{axis}_m_s2"], color=colour, linewidth=0.8, label=axis)
rate.set_ylabel("angular rate, rad/s")
rate.set_title("Simulated hand twist, as smartdepthsync imu --csv records it")
rate.legend(loc="upper right", ncols=3)
force.set_ylabel("specific force, m/s²")
force.set_xlabel("board time since the first sample, s")
for panel in (rate, force):
    panel.grid(alpha=0.3)
figure.savefig(target, metadata={"Date": None})
