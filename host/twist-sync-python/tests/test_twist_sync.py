"""Tests of the package, as `cargo xtask wheel` runs them.

SMARTDEPTHSYNC names the program, SYNC_BENCH a folder of twists with the crate's results
(`sync_bench --export`).
"""

import csv
import json
import os
import pathlib
import subprocess
import unittest

import matplotlib

matplotlib.use("Agg")

import numpy as np
from scipy.signal import correlate, correlation_lags
from twistnsync.twistnsync import TimeSync

import twist_sync
import twist_sync.plot

HOST = pathlib.Path(__file__).resolve().parents[2]
REAL = HOST / "twist-scenarios/data/twist"
BOOT_S = 1000.25
SKEW = 12e-6


def read(path):
    data = np.loadtxt(path, delimiter=",", skiprows=1)
    return data[:, 0], data[:, 1:]


def recordings(seconds, seed, peak=2.5, unrelated=False):
    """Two simulated gyroscopes on one body, the second on another clock and turned."""
    rng = np.random.default_rng(seed)

    def motion():
        f = rng.uniform(0.3, 3.0, (3, 12))
        p = rng.uniform(0, 2 * np.pi, (3, 12))
        rms = peak / 3
        return lambda t: rms * np.sum(
            np.sin(2 * np.pi * f * t[:, None, None] + p), axis=2
        ) / np.sqrt(6)

    of_a = motion()
    of_b = motion() if unrelated else of_a
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    t_a = np.arange(0, seconds, 1 / 500)
    t_b = np.arange(0.2, seconds, 1 / 497)
    w_a = of_a(t_a) + rng.normal(0, 1.4e-3, (len(t_a), 3))
    w_b = of_b(t_b) @ turn.T + rng.normal(0, 1.2e-3, (len(t_b), 3))
    return t_a, w_a, t_b * (1 + SKEW) + BOOT_S, w_b


def truth(reference):
    return BOOT_S + SKEW * reference


class Twists(unittest.TestCase):
    def test_is_right_and_better_than_plain_correlation_and_the_published_package(self):
        ours, plain, published = [], [], []
        for seed in range(5):
            t_a, w_a, t_b, w_b = recordings(9, seed)
            found = twist_sync.estimate(t_a, w_a, t_b, w_b)
            error = found.offset - truth(found.reference)
            self.assertLess(abs(error), 5 * found.clock.offset_sigma)
            self.assertLess(abs(found.skew - SKEW), 5 * found.clock.skew_sigma)
            np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)
            ours.append(error)
            # scipy: magnitudes on one grid, the largest correlation.
            grid = np.arange(0, 8, 1 / 500)
            a = np.interp(grid, t_a - t_a[0], np.linalg.norm(w_a, axis=1))
            b = np.interp(grid, t_b - t_b[0], np.linalg.norm(w_b, axis=1))
            c = correlate(a - a.mean(), b - b.mean())
            lag = correlation_lags(len(a), len(b))[np.argmax(c)] / 500
            plain.append(t_b[0] - t_a[0] - lag - truth(4.5))
            sync = TimeSync(w_a, w_b, t_a - t_a[0], t_b - t_b[0], True)
            sync.resample(step=None)
            sync.obtain_delay()
            published.append(t_b[0] - t_a[0] + sync.time_delay - truth(4.5))
        largest = [max(map(abs, errors)) for errors in (ours, plain, published)]
        self.assertLess(20 * largest[0], min(largest[1:]), largest)

    def test_a_real_twist_as_the_command_has_it_to_the_bit(self):
        files = REAL / "mcu_gyro_data.csv", REAL / "smartphone_gyro_data.csv"
        found = twist_sync.estimate(*read(files[0]), *read(files[1]))
        args = ["offset", "--json", "--mcu", files[0], "--phone", files[1]]
        command = subprocess.run(
            [os.environ["SMARTDEPTHSYNC"], *args], check=True, capture_output=True
        )
        said = json.loads(command.stdout)
        self.assertEqual(
            [said[key] for key in ("reference_s", "offset_s", "offset_sigma_s", "calibration")],
            [found.reference, found.offset, found.clock.offset_sigma, found.calibration.tolist()],
        )
        self.assertEqual(
            [(f["kind"], f["count"]) for f in said["faults"]],
            [(f.kind, f.count) for f in found.faults],
        )

    def test_every_scenario_as_the_crate_has_it_to_the_bit(self):
        accepted = refused = 0
        for table in sorted(pathlib.Path(os.environ["SYNC_BENCH"]).glob("*/ours.csv")):
            with open(table, newline="") as file:
                rows = list(csv.DictReader(file))
            for row in rows:
                a, b = (read(table.with_name(f"{row['trial']}_{side}.csv")) for side in "ab")
                try:
                    found = twist_sync.estimate(
                        *a, *b, a_delay=float(row["a_delay_s"]), b_delay=float(row["b_delay_s"])
                    )
                except twist_sync.Refused:
                    self.assertEqual(row["offset_s"], "NaN", (table, row))
                    refused += 1
                    continue
                accepted += 1
                self.assertEqual(
                    [float(row[key]) for key in ("reference_s", "offset_s", "sigma_s")],
                    [found.reference, found.offset, found.clock.offset_sigma],
                    (table, row),
                )
        self.assertGreater(accepted, 20)
        self.assertGreater(refused, 3)

    def test_a_refusal_says_why(self):
        with self.assertRaisesRegex(twist_sync.Refused, "too little motion") as caught:
            twist_sync.estimate(*recordings(9, 1, peak=0))
        missed = [gate.name for gate in caught.exception.report.gates if not gate.passed]
        self.assertEqual(missed, ["motion"])
        with self.assertRaises(twist_sync.Refused):
            twist_sync.estimate(*recordings(9, 1, unrelated=True))

    def test_nanoseconds_keep_the_digits_of_a_clock_since_1970(self):
        t_a, w_a, t_b, w_b = recordings(9, 2)
        since = 1_700_000_000_000_000_000
        nanos = [np.round(t * 1e9).astype(np.int64) for t in (t_a, t_b)]
        found = twist_sync.estimate(nanos[0] + since, w_a, nanos[1] + since, w_b)
        error = found.offset - truth(found.reference - since * 1e-9)
        # What a float of seconds since 1970 holds: 0.24 µs.
        self.assertLess(abs(error), 5 * found.clock.offset_sigma + 0.5e-6)

    def test_wrong_arguments_are_named(self):
        t_a, w_a, t_b, w_b = recordings(9, 3)
        with self.assertRaisesRegex(ValueError, r"w_b .*expected \(n,\) and \(n, 3\)"):
            twist_sync.estimate(t_a, w_a, t_b, w_b.T)
        with self.assertRaisesRegex(ValueError, "expected 5 to 100"):
            twist_sync.estimate(t_a, w_a, t_b, w_b, low_pass_hz=4)


class Recordings(unittest.TestCase):
    def test_two_minutes_of_motion_without_a_twist(self):
        found = twist_sync.course(*(made := recordings(120, 4, peak=0.8)))
        self.assertGreaterEqual(found.used, 11)
        for t in (10.0, 60.0, 110.0):
            clock = found.at(t)
            self.assertLess(abs(clock.offset - truth(t)), 5 * clock.offset_sigma)
            self.assertLess(clock.offset_sigma, 20e-6)
        back = found.b_to_a([60 * (1 + SKEW) + BOOT_S])[0]
        self.assertLess(abs(back - 60), 50e-6)
        self.assertEqual(len(twist_sync.plot.course(found).axes), 1)
        with self.assertRaises(twist_sync.Refused):
            twist_sync.course(made[0], made[1] * 0, made[2], made[3])


class Documents(unittest.TestCase):
    def test_the_notebook_runs_and_has_no_output(self):
        path = HOST / "twist-sync-python/example.ipynb"
        cells = [c for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]
        names = {"__name__": "notebook"}
        os.chdir(path.parent)
        for cell in cells:
            self.assertEqual(cell["outputs"], [])
            exec("".join(cell["source"]), names)
        self.assertEqual(len(names["figure"].axes), 4)


if __name__ == "__main__":
    unittest.main()
