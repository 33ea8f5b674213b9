"""The clock estimate on all simulated scenarios and on twists over an hour; then the published
package twistnsync beside it, on the same files, without skew: the package has none.

usage: sync_bench.py TARGET [TRIALS]
TARGET is cargo's folder; in its `sync-bench` the example `sync_bench --export` leaves N_a.csv,
N_b.csv (time, x, y, z) and ours.csv. Run by `cargo xtask bench sync`.

Two forms of the package: as published, and with the interval of the spline
repaired. As published, the index of the correlation's peak has had a (negative)
shift added in `obtain_delay`, is stepped back by one if the slope there is
negative, and the root is taken in [0, 1) of that interval, or not, depending on
the slope; the repaired form takes the maximum of the spline in the two intervals
around the peak. Both see times from their own first sample, as its examples do.
"""

import csv
import math
import pathlib
import subprocess
import sys
import time

import numpy as np
from scipy.interpolate import CubicSpline
from twistnsync.twistnsync import TimeSync

import twist_sync


# As often as the example runs ours; time of the processor, as there.
RUNS = 5

# Twists that the package is given at most: it is measured, not studied.
MOST = 100


def read(path):
    data = np.loadtxt(path, delimiter=",", skiprows=1)
    return data[:, 0], data[:, 1:]


def peak(correlation):
    """Place of the maximum of the spline around the largest value."""
    top = int(np.argmax(correlation))
    low, high = max(top - 1, 0), min(top + 1, len(correlation) - 1)
    spline = CubicSpline(np.arange(len(correlation)), correlation, bc_type="natural")
    roots = spline.derivative().roots(extrapolate=False)
    near = [r for r in roots if low <= r <= high] + [float(top)]
    return max(near, key=spline)


def offsets(mcu, phone):
    """Phone - mcu as published, and repaired; and the seconds of the fastest run."""
    (t_mcu, w_mcu), (t_phone, w_phone) = mcu, phone
    seconds = math.inf
    for _ in range(RUNS):
        start = time.process_time()
        sync = TimeSync(w_mcu, w_phone, t_mcu - t_mcu[0], t_phone - t_phone[0], True)
        sync.resample(step=None)
        sync.obtain_delay()
        seconds = min(seconds, time.process_time() - start)
    between = t_phone[0] - t_mcu[0]
    shift = -len(sync._xx1_new) + 1
    repaired = (peak(sync.cor) + shift) * sync._dt
    return between + sync.time_delay, between + repaired, seconds


def through_python(mcu, phone):
    """Seconds of the fastest run of the package of ours, refused or not, and of the native call in it: both
    of the same moment, since other work on the machine slows processes by more than Python costs."""
    native = twist_sync._twist_sync.estimate
    fastest = (math.inf, math.inf)
    inner = math.inf

    def timed(*arguments):
        nonlocal inner
        start = time.process_time()
        found = native(*arguments)
        inner = time.process_time() - start
        return found

    twist_sync._twist_sync.estimate = timed
    for _ in range(RUNS):
        start = time.process_time()
        try:
            twist_sync.estimate(*mcu, *phone)
        except twist_sync.Refused:
            pass
        fastest = min(fastest, (time.process_time() - start, inner))
    twist_sync._twist_sync.estimate = native
    return fastest


def rms(values):
    return math.sqrt(sum(v * v for v in values) / len(values))


def compare(folder):
    errors = {"as published": [], "index repaired": [], "smartdepthsync": []}
    seconds, ours_ms, wheel_ms = [], [], []
    with open(folder / "ours.csv", newline="") as file:
        for row in csv.DictReader(file):
            mcu = read(folder / f"{row['trial']}_a.csv")
            phone = read(folder / f"{row['trial']}_b.csv")
            published, repaired, took = offsets(mcu, phone)
            truth = float(row["true_offset_s"])
            errors["as published"].append(published - truth)
            errors["index repaired"].append(repaired - truth)
            if not math.isnan(float(row["offset_s"])):
                errors["smartdepthsync"].append(float(row["offset_s"]) - truth)
            seconds.append(took)
            ours_ms.append(float(row["ms"]))
            wheel_ms.append(np.multiply(through_python(mcu, phone), 1e3))
    print(f"{len(seconds)} simulated twists, the same files for all\n")
    print("| | RMSE µs | median µs | largest µs | ms |")
    print("|---|---|---|---|---|")
    for name, values in errors.items():
        if not values:
            print(f"| {name} | all refused | | | |")
            continue
        ms = np.median(ours_ms) if name == "smartdepthsync" else 1e3 * np.median(seconds)
        absolute = np.abs(values) * 1e6
        print(
            f"| {name} | {rms(values) * 1e6:.2f} | {np.median(absolute):.2f}"
            f" | {absolute.max():.2f} | {ms:.1f} |"
        )
    whole, native = np.transpose(wheel_ms)
    print(
        f"\nsmartdepthsync through Python: {np.median(whole):.2f} ms, "
        f"{np.median(whole / native):.3f} times the native call in it"
    )
    if errors["smartdepthsync"]:
        factor = rms(errors["index repaired"]) / rms(errors["smartdepthsync"])
        print(f"\nerror of the repaired package / ours: {factor:.1f}")


def main(target, trials="300"):
    target = pathlib.Path(target)

    def example(*options):
        subprocess.run([target / "release/examples/sync_bench", *options], check=True)

    example("--trials", trials)
    example("--hour", "--trials", trials)
    for scenario in ("base", "faulty stream b"):
        print(f"\n{scenario}:", flush=True)
        folder = target / "sync-bench" / scenario.replace(" ", "-")
        files = str(min(int(trials), MOST))
        example("--trials", files, "--scenario", scenario, "--no-skew", "--export", folder)
        compare(folder)


main(*sys.argv[1:])
