"""Reads a CSV of `smartdepthsync board imu` with pandas and checks that it shows a twist.

usage: twist_csv.py FILE

The file begins at rest; how long that lasts depends on how soon the program was there.
"""

import sys

import numpy as np
import pandas as pd

table = pd.read_csv(sys.argv[1])

gyro = ["gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"]
accel = ["accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2"]
expected = ["ticks", "time_s", *gyro, *accel, "temperature_c", "flags"]
assert list(table.columns) == expected, list(table.columns)
assert table["ticks"].dtype == np.int64, table["ticks"].dtype
assert not table.isna().any().any()

# Board time: 48 MHz ticks, 500 Hz exactly.
assert (table["ticks"].diff().dropna() == 96_000).all()
assert np.allclose(table["ticks"] / 48e6, table["time_s"], atol=1e-9)

time = table["time_s"] - table["time_s"].iloc[0]
onset = time[(table[gyro].abs() > 0.5).any(axis="columns")].iloc[0]
still = table[time < onset - 0.5]
twist = table[(time > onset + 1.0) & (time < onset + 7.0)]
assert len(still) > 200 and len(twist) > 2000, (len(still), len(twist))

# At rest: noise and bias only, and gravity.
assert still[gyro].std().max() < 0.01, still[gyro].std()
assert still[gyro].mean().abs().max() < 0.05, still[gyro].mean()
gravity = np.sqrt((still[accel] ** 2).sum(axis=1)).mean()
assert 9.2 < gravity < 10.4, gravity

# The twist: 2 to 4 rad/s about each axis, and it goes both ways.
for axis in gyro:
    peak = twist[axis].abs().max()
    assert 1.9 < peak < 4.2, (axis, peak)
    assert twist[axis].max() > 0.5 and twist[axis].min() < -0.5, axis

print(f"{len(table)} samples, peaks {twist[gyro].abs().max().round(2).tolist()} rad/s")
