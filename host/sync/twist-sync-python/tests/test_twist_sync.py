"""Tests of the estimates, as `cargo xtask wheel` runs them.

SYNC_BENCH names a folder of twists with the crate's results (`sync_bench --export`), WHEELS that of
the package's wheel.
"""

import csv
import email
import functools
import http.server
import itertools
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import matplotlib

matplotlib.use("Agg")

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import correlate, correlation_lags
from twistnsync.twistnsync import TimeSync

import twist_sync
import twist_sync.plot

PACKAGE = pathlib.Path(__file__).resolve().parents[1]
BOOT_S = 1000.25
SKEW = 12e-6
#: Twists of three devices.
LOOPS = int(os.environ.get("LOOPS", "12"))
#: Twists for the published package.
TWISTS = int(os.environ.get("TWISTS", "40"))


def read(path):
    data = np.loadtxt(path, delimiter=",", skiprows=1)
    return data[:, 0], data[:, 1:]


def recordings(seconds, seed, peak=2.5, unrelated=False, rate=500):
    """Two simulated gyroscopes on one body, the second on another clock and turned."""
    rng = np.random.default_rng(seed)

    def motion():
        f = rng.uniform(0.3, 3.0, (3, 12))
        p = rng.uniform(0, 2 * np.pi, (3, 12))
        rms = peak / 3
        return lambda t: (
            rms * np.sum(np.sin(2 * np.pi * f * t[:, None, None] + p), axis=2) / np.sqrt(6)
        )

    of_a = motion()
    of_b = motion() if unrelated else of_a
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    t_a = np.arange(0, seconds, 1 / (1.000013 * rate))
    t_b = np.arange(0.2, seconds, 1 / 497)
    w_a = of_a(t_a) + rng.normal(0, 1.4e-3, (len(t_a), 3))
    w_b = of_b(t_b) @ turn.T + rng.normal(0, 1.2e-3, (len(t_b), 3))
    return t_a, w_a, t_b * (1 + SKEW) + BOOT_S, w_b


def true_offset(reference):
    return BOOT_S + SKEW * reference


class Twists(unittest.TestCase):
    def test_is_right_and_better_than_plain_correlation_and_the_published_package(self):
        ours, plain, published = [], [], []
        for seed in range(5):
            t_a, w_a, t_b, w_b = recordings(9, seed)
            found = twist_sync.estimate(t_a, w_a, t_b, w_b)
            error = found.offset - true_offset(found.reference)
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
            plain.append(t_b[0] - t_a[0] - lag - true_offset(4.5))
            sync = TimeSync(w_a, w_b, t_a - t_a[0], t_b - t_b[0], True)
            sync.resample(step=None)
            sync.obtain_delay()
            published.append(t_b[0] - t_a[0] + sync.time_delay - true_offset(4.5))
        largest = [max(map(abs, errors)) for errors in (ours, plain, published)]
        self.assertLess(20 * largest[0], min(largest[1:]), largest)

    def test_the_published_package_is_a_step_off_where_its_spline_falls(self):
        errors = {1: [], 0: []}
        for seed in range(TWISTS):
            t_a, w_a, t_b, w_b = recordings(9, seed)
            sync = TimeSync(w_a, w_b, t_a - t_a[0], t_b - t_b[0], True)
            sync.resample(step=None)
            sync.obtain_delay()
            top = int(np.argmax(sync.cor))
            spline = CubicSpline(np.arange(len(sync.cor)), sync.cor, bc_type="natural").derivative()
            roots = spline.roots(extrapolate=False)
            nearest = roots[np.argmin(np.abs(roots - top))]
            step = sync._dt
            right = (nearest - len(sync._xx1_new) + 1) * step
            falls = int(spline(top) < 0)
            self.assertAlmostEqual((sync.time_delay - right) / step, falls, delta=1e-3)
            errors[falls].append(t_b[0] - t_a[0] + right - true_offset(4.5))
        self.assertGreater(len(errors[1]), 3)
        self.assertGreater(len(errors[0]), 3)
        returned = np.concatenate([errors[1], errors[0]])
        published = np.concatenate([np.add(errors[1], step), errors[0]])
        rms = [1e3 * np.mean(e**2) ** 0.5 for e in (published, returned)]
        print(
            f"of {TWISTS} {len(errors[1])} are a step too large: {rms[0]:.2f} ms rms, else {rms[1]:.2f}"
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
                    [found.clock.reference, found.clock.offset, found.clock.offset_sigma],
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
        error = found.clock.offset - true_offset(found.clock.reference - since * 1e-9)
        # What a float of seconds since 1970 holds: 0.24 µs.
        self.assertLess(abs(error), 5 * found.clock.offset_sigma + 0.5e-6)

    def test_wrong_arguments_are_named(self):
        t_a, w_a, t_b, w_b = recordings(9, 3)
        with self.assertRaisesRegex(ValueError, r"w_b .*expected \(n,\) and \(n, 3\)"):
            twist_sync.estimate(t_a, w_a, t_b, w_b.T)
        with self.assertRaisesRegex(ValueError, "expected 5 to 100"):
            twist_sync.estimate(t_a, w_a, t_b, w_b, low_pass_hz=4)
        with self.assertRaisesRegex(ValueError, "t_b .*floats are seconds"):
            twist_sync.estimate(t_a, w_a, t_b * 1e3, w_b)
        with self.assertRaisesRegex(ValueError, "t_a .*integers are nanoseconds"):
            twist_sync.estimate((t_a * 1e3).astype(int), w_a, t_b, w_b)

    def test_times_of_any_kind_give_times_of_the_same_kind(self):
        t_a, w_a, t_b, w_b = recordings(9, 2)
        nanos = np.round(t_b * 1e9).astype(np.int64)
        dates = nanos.astype("M8[ns]")
        found = twist_sync.estimate(
            np.round(t_a * 1e9).astype(np.int64).astype("M8[ns]"), w_a, dates, w_b
        )
        back = found.clock.b_to_a(t_b)
        self.assertLess(np.abs(back - (t_b - BOOT_S) / (1 + SKEW)).max(), 50e-6)
        on_a = found.clock.b_to_a(nanos)
        self.assertEqual(on_a.dtype, np.int64)
        self.assertLess(np.abs(on_a - back * 1e9).max(), 2)
        np.testing.assert_array_equal(found.clock.b_to_a(dates).astype(np.int64), on_a)
        self.assertEqual(found.clock.b_to_a(int(nanos[5])), on_a[5])
        self.assertIsInstance(found.clock.b_to_a(float(t_b[5])), float)
        self.assertLess(np.abs(found.clock.a_to_b(on_a) - nanos).max(), 2)
        # The relation at a time, of the same kinds; its sigma grows by the wander.
        at = found.clock.at(on_a[[5, 9]].astype("M8[ns]"))
        np.testing.assert_array_equal(at.offset, found.clock.at(on_a[[5, 9]]).offset)
        np.testing.assert_allclose(at.reference, on_a[[5, 9]] * 1e-9, rtol=1e-12)
        self.assertEqual(found.clock.at(60_000_000_000).offset, found.clock.at(60.0).offset)
        with self.assertRaisesRegex(TypeError, "expected seconds"):
            found.clock.at("noon")
        still = twist_sync.Clock(0.0, 1.0, 0.0, np.zeros((2, 2)), wander_ppm=0.06)
        # q = (6e-8)²/60 = 6e-17; q·60³/3.
        self.assertAlmostEqual(still.at(60.0).offset_sigma, (6e-17 * 72_000) ** 0.5, delta=1e-12)
        self.assertAlmostEqual(still.at(-60.0).skew_sigma, 6e-8, delta=1e-14)

    def test_one_wild_stamp_at_the_end_changes_little(self):
        t_a, w_a, t_b, w_b = recordings(9, 2)
        right = twist_sync.estimate(t_a, w_a, t_b, w_b)
        t_b[-1] += 1e9
        found = twist_sync.estimate(t_a, w_a, t_b, w_b)
        self.assertLess(abs(found.offset - right.clock.at(found.reference).offset), 1e-6)

    def test_values_can_be_compared_and_shown(self):
        a, b = (twist_sync.estimate(*recordings(9, seed)) for seed in (1, 2))
        self.assertEqual(a.clock, twist_sync.estimate(*recordings(9, 1)).clock)
        self.assertNotEqual(a.clock, b.clock)
        self.assertNotEqual(a, b)
        for value in (a, a.clock, a.report, *a.faults):
            self.assertLess(len(repr(value)), 250)
        self.assertRegex(twist_sync.__version__, r"^\d+\.\d+\.\d+$")
        # What help() shows.
        for kind in (twist_sync.Clock, twist_sync.Report, twist_sync.Gate, twist_sync.Fault):
            for field in kind.__dataclass_fields__:
                self.assertIn(f"{field}:", kind.__doc__)


class Recordings(unittest.TestCase):
    def test_two_minutes_of_motion_without_a_twist(self):
        found = twist_sync.course(*(made := recordings(120, 4, peak=0.8)))
        self.assertGreaterEqual(found.used, 11)
        for t in (10.0, 60.0, 110.0):
            clock = found.at(t)
            self.assertLess(abs(clock.offset - true_offset(t)), 5 * clock.offset_sigma)
            self.assertLess(clock.offset_sigma, 20e-6)
        back = found.b_to_a(60 * (1 + SKEW) + BOOT_S)
        self.assertLess(abs(back - 60), 50e-6)
        self.assertEqual((found.steps, found.refused), ([], 0))
        self.assertLess(len(repr(found)), 250)

        # One time or many, of either clock.
        many = np.linspace(5, 115, 1_000_000)
        begun = time.process_time()
        there, sigmas = found.offsets(many)
        self.assertLess(time.process_time() - begun, 2)
        self.assertEqual(found.at(many[::1000]).covariance.shape, (1000, 2, 2))
        self.assertEqual(found.at(many[7]).offset, there[7])
        self.assertEqual(found.at(many[7]).offset_sigma, sigmas[7])
        on_b = found.a_to_b(many)
        np.testing.assert_allclose(on_b - many, there, atol=1e-9)
        np.testing.assert_allclose(found.b_to_a(on_b), many, atol=1e-9)
        self.assertIsInstance(found.b_to_a(float(on_b[7])), float)
        with self.assertRaises(twist_sync.Refused):
            twist_sync.course(made[0], made[1] * 0, made[2], made[3])


class Networks(unittest.TestCase):
    @staticmethod
    def pair(offset, sigma):
        return twist_sync.Clock(100.0, offset, 0.0, np.diag([sigma**2, 0.0]), wander_ppm=0)

    def test_an_open_loop_is_refused_and_its_pair_named(self):
        def pairs(devices, wrong, by):
            clocks = itertools.combinations(range(devices), 2)
            return {(i, j): self.pair((j - i) + by * ((i, j) in wrong), 1e-6) for i, j in clocks}

        for by in (0, 5e-6):
            twist_sync.Network(4, pairs(4, [(0, 3)], by))
        with self.assertRaisesRegex(twist_sync.Refused, "2 loops .* relation of 1–4 breaks it"):
            twist_sync.Network(4, pairs(4, [(0, 3)], 6e-6))
        with self.assertRaisesRegex(twist_sync.Refused, "relations of 1–4 and 2–3 break them"):
            twist_sync.Network(5, pairs(5, [(0, 3), (1, 2)], 6e-6))
        # One loop alone does not say which of its three.
        with self.assertRaisesRegex(twist_sync.Refused, "1–2, 1–3, 2–3 .* do not say which"):
            twist_sync.Network(3, pairs(3, [(0, 1)], -9e-3))

    def test_a_loop_that_does_not_close_is_shared_by_its_pairs(self):
        pairs = {
            (0, 1): self.pair(5, 1e-6),
            (1, 2): self.pair(2, 1e-6),
            (0, 2): self.pair(7 + 3e-6, 1e-6),
        }
        network = twist_sync.Network(3, pairs)
        value, sigma = network.offsets(100.0)
        np.testing.assert_allclose(value[:, 0], [0, 5 + 1e-6, 7 + 2e-6], atol=1e-9)
        # Two pairs more are no second opinion.
        np.testing.assert_allclose(sigma[:, 0], [0, 1e-6, 1e-6], rtol=1e-9)
        ((of, (error, of_sum)),) = network.closures(100.0).items()
        self.assertEqual(of, (0, 1, 2))
        self.assertAlmostEqual(error[0], -3e-6, delta=1e-9)
        self.assertAlmostEqual(of_sum[0], 3**0.5 * 1e-6, delta=1e-12)

    def test_a_chain_leads_around_a_missing_pair_in_either_direction(self):
        pairs = {(1, 2): self.pair(3, 4e-6), (0, 2): self.pair(10, 3e-6)}
        network = twist_sync.Network(3, pairs)
        value, sigma = network.offsets([100.0, 200.0])
        np.testing.assert_allclose(value[1], 7, atol=1e-9)
        np.testing.assert_allclose(sigma[1], 5e-6, rtol=1e-9)
        self.assertEqual(network.closures(100.0), {})
        with self.assertRaisesRegex(twist_sync.Refused, "number 4$"):
            twist_sync.Network(4, pairs)

    def test_loops_of_three_devices_close_and_their_clocks_are_right(self):
        squares, loops = [], []
        for seed in range(LOOPS):
            t_a, w_a, t_b, w_b = recordings(9, seed)
            rng = np.random.default_rng(seed + 10_000)
            turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            t_c, w_c, _, _ = recordings(9, seed, rate=416)
            w_c = w_c @ turn.T + rng.normal(0, 1e-4, w_c.shape)
            tracks = [(t_a, w_a), (t_b, w_b), (t_c + 50.0, w_c)]
            made = [
                twist_sync.Recording(pathlib.Path(n), n, np.round(t * 1e9).astype(int), w)
                for n, (t, w) in zip("abc", tracks)
            ]
            solved = twist_sync.sync(made)
            ((error, sigma),) = solved.network.closures(4.5).values()
            loops.append((error[0], sigma[0]))
            on_b, sigma_b = solved.clock(1).offset(4_500_000_000)
            on_c, sigma_c = solved.clock(2).offset(4_500_000_000)
            squares += [
                ((on_b[0] - true_offset(4.5)) / sigma_b[0]) ** 2,
                ((on_c[0] - 50) / sigma_c[0]) ** 2,
            ]
        loops = np.array(loops)
        self.assertTrue((np.abs(loops[:, 0]) < loops[:, 1]).all(), loops)
        ratio = np.mean(squares) ** 0.5
        self.assertTrue(0.6 < ratio < 1.5, ratio)
        rms = np.sqrt(np.mean(loops**2, axis=0)) * 1e6
        print(
            f"{LOOPS} loops close to {rms[0]:.3f} µs rms, stated {rms[1]:.2f}; clocks: error over sigma {ratio:.2f} rms"
        )


class Package(unittest.TestCase):
    def test_pip_installs_the_wheel_from_an_index_and_its_command_runs(self):
        """WHEELS names the folder of the wheel."""
        (wheel,) = pathlib.Path(os.environ["WHEELS"]).glob("twist_sync-*.whl")
        # One wheel for every Python from 3.10 on.
        self.assertIn("-cp310-abi3-", wheel.name)
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            (folder / "simple/twist-sync").mkdir(parents=True)
            (folder / "simple/twist-sync" / wheel.name).write_bytes(wheel.read_bytes())
            server = http.server.ThreadingHTTPServer(
                ("127.0.0.1", 0),
                functools.partial(Quiet, directory=name),
            )
            threading.Thread(target=server.serve_forever, daemon=True).start()
            try:
                index = f"http://127.0.0.1:{server.server_port}/simple"
                pip = "-m pip install --quiet --no-deps --disable-pip-version-check twist-sync"
                target = folder / "site"
                run = [sys.executable, *pip.split(), "--index-url", index, "--target", target]
                subprocess.run(run, check=True, capture_output=True)
            finally:
                server.shutdown()
                server.server_close()
            env = {**os.environ, "PYTHONPATH": str(target)}
            done = subprocess.run(
                [target / "bin/twist-sync", "--example"], env=env, capture_output=True, text=True
            )
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("smartphone_gyro_data.csv - mcu_gyro_data.csv", done.stdout)
            (metadata,) = target.glob("twist_sync-*.dist-info/METADATA")
            about = email.message_from_string(metadata.read_text())
            self.assertEqual(about["Description-Content-Type"].split(";")[0], "text/markdown")
            # Links of the page would lead nowhere.
            self.assertNotRegex(about.get_payload(), r"\]\((?!https://)")
            extras = set(about.get_all("Provides-Extra"))
            self.assertEqual(
                extras, {"ardupilot", "bags", "mat", "plot", "protobuf", "ulg", "video", "xlsx"}
            )


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


class Documents(unittest.TestCase):
    def test_the_notebook_runs_and_has_no_output(self):
        path = PACKAGE / "example.ipynb"
        cells = [c for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]
        names = {"__name__": "notebook"}
        os.chdir(path.parent)
        for cell in cells:
            self.assertEqual(cell["outputs"], [])
            exec("".join(cell["source"]), names)
        self.assertEqual(len(names["figure"].axes), 4)
        np.testing.assert_allclose(
            names["solved"].clock(1).b_to_a(names["phone"].t), names["on_board"], atol=2
        )


if __name__ == "__main__":
    unittest.main()
