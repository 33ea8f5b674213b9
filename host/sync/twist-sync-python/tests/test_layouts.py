"""Tests of what is read from files of many layouts, those of `layouts`, and of what is refused."""

import builtins
import contextlib
import gzip
import io
import json
import pathlib
import tempfile
import unittest
from types import SimpleNamespace

import layouts
import numpy as np
from layouts import LAYOUTS, Made, Motion, xyz
from scipy.spatial.transform import Rotation

import twist_sync
from twist_sync import command, files, held, network, report, write

MOTION = Motion()
BY_NAME = {layout.name: layout for layout in LAYOUTS}
SINCE_2000 = 946_684_800 * 10**9


class Folder(unittest.TestCase):
    """With readers in this process; that of others is tested in `test_command`."""

    def setUp(self):
        self.addCleanup(setattr, files, "_in_process", files._in_process)
        files._in_process = files._read_here
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def file(self, name, content):
        path = self.folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def read(self, layout, made, name="log"):
        path = self.file(name + layout.suffix, layout.make(made))
        return twist_sync.read(f"{path}@{layout.topic}" if layout.topic else path, **layout.options)


class Layouts(Folder):
    def test_every_layout_gives_the_times_and_rates_that_it_was_made_of_also_when_written_again(self):
        kept = 0
        for layout in LAYOUTS:
            with self.subTest(f"{layout.kind}: {layout.name}"):
                made = Made(MOTION, start=layout.start)
                read = self.read(layout, made)
                self.assertIn(layout.said, f"{read.form} {read.notes}")
                start = layout.start
                if layout.counted:
                    # Midway between two orientations.
                    start = read.t[0] - round(0.0525e9 if layout.kind == "orientations" else 0.05e9)
                elif layout.name.startswith("Polar"):
                    start = layouts.EPOCH - SINCE_2000
                self.assertGreater(read.seconds, layouts.LENGTH - 1.2)
                expected = MOTION.w((read.t - start) * 1e-9)
                self.assertLess(np.abs(read.w - expected).max(), layout.off, read.form)
                kept += self.is_kept(layout, read)
        self.assertGreater(kept, 80)

    def test_sources_and_kinds_are_given(self):
        kinds = {layout.kind for layout in LAYOUTS}
        self.assertEqual(len(BY_NAME), len(LAYOUTS))
        self.assertGreater(len(LAYOUTS), 40 + 18)
        self.assertEqual(len(kinds), 7)
        self.assertTrue(all(layout.source for layout in LAYOUTS))

    def is_kept(self, layout, read):
        """Writes a recording again with its times moved, and checks it; True if its form is kept."""
        moved = 1_234_567_891
        clock = SimpleNamespace(b_to_a=lambda t: t + moved, offset=lambda t: (0 * t, 0 * t))
        out = self.folder / f"again{layout.suffix}"
        out.unlink(missing_ok=True)
        path = pathlib.Path(write.again(read, clock, out).partition(": ")[0])
        is_kept = path == out
        again = twist_sync.read(f"{path}@{layout.topic}" if layout.topic and is_kept else path, **layout.options if is_kept else {})
        path.unlink()
        self.assertLess(np.abs(again.t - read.t - moved).max(), 300)
        np.testing.assert_allclose(again.w, read.w, rtol=0 if is_kept else 1e-12)
        self.assertTrue(is_kept or layout.kind in ("containers", "orientations", "time"))
        return is_kept


def case(a, b, bound, a_zero=None, b_zero=None, **more):
    return SimpleNamespace(a=a, b=b, bound=bound, a_zero=a_zero, b_zero=b_zero, **more)


#: Pairs of files, and by how much the relation may be off, s; zeros are what the clocks show when
#: the motion is at 0, where it is not the layout's start, ns.
PAIRS = {
    "Sensor Logger JSON": case("Sensor Logger JSON", "x, y, z, t", 100e-6),
    "phyphox": case("phyphox, semicolons and commas", "phyphox, tabs", 100e-6),
    "Physics Toolbox": case("Physics Toolbox, U+2212", "time,wx,wy,wz", 100e-6),
    "Shimmer": case("Shimmer, commas", "Shimmer, tabs", 100e-6),
    "Delsys": case("Delsys, a time for each channel", "Sensor Logger", 100e-6),
    "GoPro telemetry": case("GoPro telemetry CSV", "GoPro telemetry CSV", 200e-6),
    "gcsv": case("gcsv, counts with a scale", "Sensor Logger", 100e-6),
    "Arduino": case("micros of 32 bits", "Sensor Logger", 100e-6, a_zero=4_289_967_295_000 - 50_000_000 + 1000),
    "Polar": case("Polar, the sensor's ns", "Polar, the sensor's ns", 600e-6, layouts.EPOCH - SINCE_2000, layouts.EPOCH - SINCE_2000),
    "rows of sensors": case("IPIN's log, a row a sensor", "a word in a column", 700e-6, limit=1000),
    "ros2 topic echo": case("ros2 topic echo --csv", "Timestamp (us)", 150e-6),
    "Motive": case("Motive, quaternions", "Sensor Logger", 300e-6),
    "Stray Scanner, rates": case("Stray Scanner, alpha", "x,y,z,timestamp_ns", 100e-6),
    "Stray Scanner, poses": case("Stray Scanner, poses", "x,y,z,timestamp_ns", 300e-6),
    "RealSense": case("RealSense, two tables", "Sensor Logger", 150e-6),
    "MCAP of JSON": case("MCAP of JSON", "Sensor Logger", 100e-6),
    "GPMF": case("GPMF without its video", "Sensor Logger", 200e-6),
}  # fmt: skip
#: The second files that are no layout of their own.
PLAIN = {
    "Sensor Logger": layouts.sensor_logger,
    "x, y, z, t": lambda m: m.rows("{:.7f},{:.7f},{:.7f},{}", *xyz(m.w), m.ns),
    "x,y,z,timestamp_ns": lambda m: "x,y,z,timestamp_ns\n" + m.rows("{:.7f},{:.7f},{:.7f},{}", *xyz(m.w), m.ns),
    "time,wx,wy,wz": lambda m: "time,wx,wy,wz\n" + m.rows("{:.4f},{:.4f},{:.4f},{:.4f}", m.ns * 1e-9, *xyz(m.w)),
    "Timestamp (us)": lambda m: "Timestamp (us),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)\n"
    + m.rows("{},{:.4f},{:.4f},{:.4f}", m.ns // 1000, *xyz(m.deg)),
}


class Pairs(Folder):
    def test_two_files_of_any_layout_are_related(self):
        for name, one in PAIRS.items():
            with self.subTest(name):
                layout = BY_NAME[one.a]
                a = Made(MOTION, start=layout.start)
                b = Made(
                    MOTION,
                    rate=250.0,
                    start=BY_NAME[one.b].start + 3_141_592_653 if one.b in BY_NAME else layouts.EPOCH,
                    skew=30e-6,
                    turn=Rotation.from_euler("xyz", [0.5, -1.0, 2.0]),
                    seed=5,
                )
                first = self.file("a" + layout.suffix, layout.make(a))
                make = PLAIN.get(one.b) or BY_NAME[one.b].make
                second = self.file("b.csv", make(b))
                limit = ["--max-sigma-us", str(getattr(one, "limit", 100))]
                out = io.StringIO()
                with contextlib.redirect_stdout(out):
                    code = command.main(["--json", "--exact-stamps", *limit, str(first), str(second)])
                found = json.loads(out.getvalue())
                pair = found["pairs"][0]
                self.assertEqual(code, 0, pair["reasons"])
                a_zero = layout.start if one.a_zero is None else one.a_zero
                b_zero = b.start if one.b_zero is None else one.b_zero + 3_141_592_653
                at = (pair["reference_ns"] - a_zero) * 1e-9
                expected = b_zero - a_zero + round(b.skew * at * 1e9)
                self.assertLess(abs(pair["offset_ns"] - expected) * 1e-9, one.bound, found["recordings"])
                self.assertLess(abs(pair["skew_ppm"] - 30), 5 * pair["skew_sigma_ppm"] + 3)


    def test_columns_that_nothing_names_are_doubted_where_the_motions_differ(self):
        made = Made(MOTION)
        positions = self.file("a.csv", layouts.table("time,x,y,z", made.ns * 1e-9, *xyz(np.cumsum(made.w, axis=0) * 0.005)))
        solved = twist_sync.sync([positions, self.file("b.csv", layouts.sensor_logger(made))])
        self.assertRegex(report.object_of(solved)["pairs"][0]["reasons"][0], "^nothing says that 'x', 'y', 'z' of a.csv are rates; .*--columns")


#: Name, content (of a motion), and words of the one line that is said.
REFUSED = {
    "a clock that started again": ("a.csv", layouts.reboot, r"line \d+: 't_ms' falls from .* under a repeated header.*FILE@part 1 to FILE@part 2"),
    "minutes and seconds of a spreadsheet": ("a.csv", layouts.spreadsheet, r"steps of 0\.1 s, which some \d+ rows share; a spreadsheet"),
    "positions": ("a.csv", lambda m: "time,x,y,z\n" + m.rows("{:.4f},{:.4f},{:.4f},{:.4f}", m.s, *xyz(m.w + [5, 4, 0])), "constant part"),
    "accelerations by their size": ("a.csv", lambda m: "time,x,y,z\n" + m.rows("{:.4f},{:.4f},{:.4f},{:.4f}", m.s, *xyz(m.acc)), "gravity, 9.81 m/s"),
    "accelerations by their unit": ("a.csv", lambda m: "time,x (g),y (g),z (g)\n" + m.rows("{:.4f},{:.4f},{:.4f},{:.4f}", m.s, *xyz(m.w)), "something else"),
    "accelerations by the file's name": ("Accelerometer.csv", layouts.sensor_logger, "measure acceleration"),
    "accelerations by a word": ("a.csv", lambda m: "sensor,time,x,y,z\n" + m.rows("acc,{:.4f},{:.4f},{:.4f},{:.4f}", m.s, *xyz(m.w)), "measure acceleration"),
    "angles of no order": ("a.csv", lambda m: "time,roll,pitch,yaw\n" + m.rows("{:.4f},{:.4f},{:.4f},{:.4f}", m.s, *xyz(m.w)), "in which order.*--unit deg:ZYX"),
    "quaternions of no names": ("a.csv", lambda m: m.rows(",".join(["{:.6f}"] * 8), m.s, *xyz(m.acc), *m.q.T), "8 columns without names"),
    "counts": ("a.csv", lambda m: "time_ms,gx,gy,gz\n" + m.rows("{:.1f},{:.0f},{:.0f},{:.0f}", m.s * 1e3, *xyz(m.deg * 65.5)), "counts of up to .* --unit 0.061deg/s"),
    "a counter": ("a.csv", lambda m: "sample,gx_dps,gy_dps,gz_dps\n" + m.rows("{},{:.3f},{:.3f},{:.3f}", np.arange(len(m.s)), *xyz(m.deg)), "--rate HZ"),
    "a counter called time": ("a.csv", lambda m: "time,gx_dps,gy_dps,gz_dps\n" + m.rows("{},{:.3f},{:.3f},{:.3f}", np.arange(len(m.s)), *xyz(m.deg)), "'time' rises by 1 a row"),
    "an empty column of times": ("a.txt", lambda m: layouts.mt_manager(m).replace("Update Rate", "Filter"), "'SampleTimeFine' is empty; give --rate HZ of the counter 'PacketCounter'"),
    "times in a wrong unit": ("a.csv", lambda m: "time (s),gx,gy,gz\n" + m.rows("{:.0f},{:.3f},{:.3f},{:.3f}", m.ns / 1e6, *xyz(m.w)), r"in s \(named\) would be 5 s apart"),
    "arrivals in bursts": ("a.csv", lambda m: "time_ms,gx_dps,gy_dps,gz_dps\n" + m.rows("{:.0f},{:.3f},{:.3f},{:.3f}", np.floor(m.s * 10) * 100, *xyz(m.deg)), "steps of 0.1 s, which some 20 rows share"),
    "gravity under a letter": ("a.csv", lambda m: layouts.table("time,gx,gy,gz", m.s, *xyz(m.acc)), "gx, gy, gz are not rates: their size is that of gravity"),
    "angles of a gyroscope": ("a.csv", lambda m: layouts.table("time,gyroAngleX,gyroAngleY,gyroAngleZ", m.s, *xyz(m.w)), "are angles.*in which order"),
    "a unit that is none": ("a.csv", lambda m: layouts.table("t,gx (gon/s),gy (gon/s),gz (gon/s)", m.s, *xyz(m.deg)), "unit 'gon/s' of .* is not known: give --unit"),
    "a rate of no sensor": ("a.csv", lambda m: "# heart rate: 72 bpm\n" + layouts.table("gx,gy,gz,flag", *xyz(m.deg), [1] * len(m.s)), "no column of times among .*--rate HZ"),
    "quaternions as counts": ("a.csv", lambda m: layouts.table("t,qw,qx,qy,qz", m.s, *np.round(m.q * 16384).T), "no rotations: not of size 1"),
    "minutes without seconds": ("a.csv", lambda m: layouts.table("time,gx,gy,gz", ["2026-03-08 20:00"] * len(m.s), *xyz(m.w)), "the same in all rows"),
    "ticks": ("a.csv", lambda m: layouts.table("ticks,gx_dps,gy_dps,gz_dps", np.round(m.s * 32768), *xyz(m.deg)), "'ticks' counts ticks.*--time-unit"),
    "FILETIME": ("a.csv", lambda m: layouts.table("", 116444736 * 10**9 + m.ns // 100, *xyz(m.w)), "ticks of 100 ns since 1601"),
    "parts of a second": ("a.csv", lambda m: layouts.table("ms,gx,gy,gz", m.ns // 10**6 % 1000, *xyz(m.w)), "line 192: 'ms' falls from 995 to 0, as parts of a second do.*--columns SECONDS"),
    "times that a spreadsheet rounded": ("a.csv", lambda m: layouts.table("time,gx,gy,gz", ["1.773E+18"] * len(m.s), *xyz(m.w)), "'time' is 1.773e.18 in each of 1380 rows"),
    "names of other columns": ("a.csv", lambda m: layouts.table("t;gx;gy;gz;flag", m.s, *xyz(m.w), between=";"), "line 2: 4 columns, 5 names.*--columns"),
    "another header in the middle": ("a.csv", lambda m: layouts.table("t,gx,gy,gz", m.s, *xyz(m.w)) + layouts.table("t,ax,ay,az,gx,gy,gz", m.s, *xyz(m.acc), *xyz(m.w)), "@line 2 g .*@line 1383 g"),
    "a table of Arrow": ("a.feather", lambda m: b"ARROW1" + bytes(64), "Parquet or Arrow.*save it as CSV"),
    "a pointer in place of a file": ("a.csv", lambda m: "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n", "git lfs pull"),
    "a tar archive": ("a.tar", lambda m: b"a.csv".ljust(257, b"\0") + b"ustar" + bytes(250), "unpack it"),
    "two bodies": ("a.csv", lambda m: "t,left_gyro_x,left_gyro_y,left_gyro_z,right_gyro_x,right_gyro_y,right_gyro_z\n" + m.rows(",".join(["{:.4f}"] * 7), m.s, *xyz(m.w), *xyz(-m.w)), "several gyroscopes: @left gyro .*@right gyro"),
    "two sensors by a number": ("a.csv", layouts.sensors_by_number, "several gyroscopes: @1 .*@2"),
    "two instances of ArduPilot": ("a.bin", lambda m: layouts.ardupilot(m.again(seed=77)), "several gyroscopes: @IMU 0"),
    "commas for both": ("a.csv", lambda m: "t,gx,gy,gz\n" + m.rows("{:.3f},{:.3f},{:.3f},{:.3f}", m.s, *xyz(m.w)).replace(".", ","), "line 2: 8 columns, 4 names: .*decimal commas"),
    "mixed decimals": ("a.csv", lambda m: "t (s);gx (rad/s);gy (rad/s);gz (rad/s)\n" + m.rows("{:.3f};{:.3f};{:.3f};{:.3f}", m.s, *xyz(m.w)).replace(".", ",") + "13,0;0,1;0.5;0,2\n13,1;0,1;0,5;0,2\n", r"line \d+, column 'gy .*decimal point"),
    "GPMF of an old camera": ("a.bin", lambda m: layouts.gpmf(m, False), "--rate HZ of the rows"),
    "HDF5": ("a.h5", lambda m: b"\x89HDF\r\n\x1a\n" + bytes(64), "HDF5, which is not read"),
    "MATLAB's HDF5": ("a.mat", lambda m: b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM" + bytes(64), "version 7.3.*-v7"),
    "cut gzip": ("a.csv.gz", lambda m: gzip.compress(layouts.sensor_logger(m).encode())[:-900], "ended before"),
    "damaged gzip": ("a.csv.gz", lambda m: (lambda c: c[:900] + bytes(99) + c[999:])(gzip.compress(layouts.sensor_logger(m).encode())), "a.csv.gz: "),
    "cut UTF-16": ("a.csv", lambda m: layouts.windows_text(m)[:3], "no rows|empty"),
    "an archive of others": ("a.zip", lambda m: layouts.zipped(**{"a.doc": "b"}), "an archive without"),
    "an archive of several": ("a.zip", lambda m: layouts.zipped(**{"a.csv": layouts.sensor_logger(m), "b.csv": "x"}), "several recordings in the archive: a.csv, b.csv"),
    "JSON without rates": ("a.json", lambda m: json.dumps({"a": [1, 2, 3]}), "no rows of samples"),
    "broken JSON": ("a.json", lambda m: '{"a": [1, 2\n{"b": 3}\n{"c":', "neither JSON .* nor lines of it"),
}  # fmt: skip


class Refusals(Folder):
    def test_what_cannot_be_known_is_refused_in_one_line(self):
        for name, (file, make, words) in REFUSED.items():
            with self.subTest(name):
                path = self.file(file, make(Made(MOTION)))
                with self.assertRaises(twist_sync.Unreadable) as caught:
                    print(twist_sync.read(path).form)
                said = str(caught.exception)
                self.assertRegex(said, words)
                self.assertNotIn("\n", said)
                path.unlink()

    def test_parts_of_a_file_whose_clock_started_again_are_two_recordings(self):
        made = Made(MOTION)
        path = self.file("a.csv", layouts.reboot(made))
        half = len(made.ns) // 2
        first, second = (twist_sync.read(f"{path}@part {k}") for k in (1, 2))
        np.testing.assert_allclose(first.t, made.ns[:half], atol=600)
        np.testing.assert_allclose(second.t, made.ns[half:] - made.ns[half] + 412 * 10**6, atol=600)
        self.assertIn("part 2 of 2, from line", second.notes[0])

    def test_a_missing_library_is_one_line_that_says_what_to_install(self):
        real = builtins.__import__
        missing = {"scipy.io", "openpyxl", "pyulog", "pymavlink.DFReader"}

        def refuse(name, *more, **also):
            if name in missing:
                raise ImportError(name)
            return real(name, *more, **also)

        self.addCleanup(setattr, builtins, "__import__", real)
        for name, extra in [
            ("MAT-file", "mat"),
            ("phyphox's Excel", "xlsx"),
            ("PX4 ULog", "ulg"),
            ("ArduPilot's binary log", "ardupilot"),
        ]:
            path = self.file("a" + BY_NAME[name].suffix, BY_NAME[name].make(Made(MOTION)))
            builtins.__import__ = refuse
            with self.assertRaisesRegex(twist_sync.Unreadable, rf"pip install \"twist-sync\[{extra}\]\""):
                twist_sync.read(path)
            builtins.__import__ = real

    def test_columns_of_seconds_and_nanoseconds_quaternions_and_none_can_be_given(self):
        made = Made(MOTION, start=layouts.EPOCH)
        path = self.file("a.csv", made.rows("{},{},{:.6f},{:.6f},{:.6f},x,9,9", made.ns // 10**9, made.ns % 10**9, *xyz(made.w)))
        read = twist_sync.read(path, columns=["1+2", "3", "4", "5"])
        np.testing.assert_array_equal(read.t, made.ns)
        read = twist_sync.read(path, columns=["-", "3", "4", "5"], rate=200.0)
        np.testing.assert_allclose(np.diff(read.t), 5e6)
        path = self.file("a.csv", made.rows(",".join(["{:.6f}"] * 8), made.s, *xyz(made.acc), *made.q.T))
        read = twist_sync.read(path, columns=["1", "5", "6", "7", "8"], unit="rad/s")
        self.assertLess(np.abs(read.w - MOTION.w(read.t * 1e-9)).max(), 0.06)
        again = twist_sync.read(path, columns=["1", "5", "6", "7", "8"], unit="world-to-body")
        self.assertGreater(np.abs(again.w - read.w).max(), 1)

    def test_gaps_of_orientations_are_said(self):
        read = self.read(BY_NAME["Motive, quaternions"], Made(MOTION))
        self.assertRegex(str(read.notes), r"and 20 more: .* is no row.*1 gaps of its orientations")


    def test_rows_that_come_twice_are_taken_once(self):
        made = Made(MOTION)
        lines = made.rows("{:.4f},{:.5f},{:.5f},{:.5f}", made.s, *xyz(made.w)).splitlines()
        path = self.file("a.csv", "t (s),gx,gy,gz\n" + "".join(f"{line}\n{line}\n" for line in lines))
        read = twist_sync.read(path)
        self.assertEqual((len(read.t), read.open_s), (len(made.s), 0))
        self.assertRegex(read.notes[0], f"{len(made.s)} rows repeat both time and values")

    def test_values_held_in_step_with_the_rows_are_a_warning(self):
        fine = Motion(seed=6)
        t = np.arange(0.0, 6.9, 1 / 100)
        w = np.tile(fine.w(t), (2, 1))
        w = np.repeat(w + np.random.default_rng(1).normal(0, 2e-3, w.shape), 2, axis=0)
        rows = np.arange(len(w)) / 200
        path = self.file("a.csv", "t (s),gx,gy,gz\n" + "".join(f"{s:.4f},{x:.5f},{y:.5f},{z:.5f}\n" for s, (x, y, z) in zip(rows.tolist(), w.tolist())))
        other = self.file("b.csv", "t (s),gx,gy,gz\n" + "".join(f"{s:.4f},{x:.5f},{y:.5f},{z:.5f}\n" for s, (x, y, z) in zip(rows[::2].tolist(), w[::2].tolist())))
        pair = report.object_of(twist_sync.sync([path, other], exact_stamps=True))["pairs"][0]
        self.assertTrue(pair["accepted"])
        self.assertRegex(pair["warnings"][0], "a.csv: 50% of its rows .*the first row of each value is taken; if the sensor .*up to 5 ms older")


class HeldValues(unittest.TestCase):
    """Rows of a logger that repeat the latest value of a sensor at other rates."""

    @staticmethod
    def sensor(rate, phase=0.0013, length=6.9):
        t = np.arange(0.01 + phase, length, 1 / rate)
        return t, MOTION.w(t) + np.random.default_rng(1).normal(0, 2e-3, (len(t), 3))

    @staticmethod
    def polled(rows, t, w):
        rows = rows[rows >= t[0]]
        return rows, w[np.searchsorted(t, rows, side="right") - 1]

    def off(self, t, w):
        """Error of the offset to an ordinary gyroscope, its sigma, s, and notes."""
        ns, (t_b, w_b) = np.round(t * 1e9).astype(np.int64), self.sensor(333.0, 0.0)
        a = twist_sync.Recording(pathlib.Path("a"), "", ns, w)
        if found := held.samples(ns, w):
            a.t, a.w, a.open_s, a.notes = found.t, w[found.rows], found.open_s, [found.note]
        b = twist_sync.Recording(pathlib.Path("b"), "", np.round(t_b * 1e9).astype(np.int64), w_b)
        one = network.relate(a, b, False, sigma_limit=20e-3)
        between = (b.t[0] - a.t[0]) * 1e-9
        return one.offset + between, one.clock.offset_sigma, a.notes

    def test_samples_of_a_sensor_with_a_clock_of_its_own_lie_between_the_rows(self):
        rng = np.random.default_rng(2)
        regular, irregular = np.arange(0.02, 6.8, 1 / 200), 0.02 + np.cumsum(rng.uniform(0.003, 0.007, 1350))
        for rate, rows in ((104.0, regular), (52.0, regular), (150.0, regular), (180.0, regular), (99.1, regular), (104.0, irregular)):
            with self.subTest(rate):
                error, sigma, notes = self.off(*self.polled(rows, *self.sensor(rate)))
                self.assertIn("a clock of its own", notes[0])
                self.assertLess(abs(error), 2.5 * sigma)
                # Half the distance of the rows, if the first row of each were taken.
                self.assertLess(abs(error), 0.7e-3)

    def test_rows_that_follow_the_sensor_are_taken_as_they_are(self):
        t, w = self.sensor(100.0)
        t = t + np.random.default_rng(3).normal(0, 1e-4, len(t))
        events = np.sort(np.r_[t, np.arange(0.02, 6.8, 1 / 173)])
        error, sigma, notes = self.off(*self.polled(events + 1e-8, t, w))
        self.assertLess(abs(error), 5 * sigma)
        self.assertLess(sigma, 20e-6)
        self.assertIn("the first row of each", notes[0])
        # Too short to show that the sensor has no clock of its own.
        rows = np.arange(t[0], 6.8, 1 / 200)
        even = np.arange(t[0] - 1e-9, 6.8, 1 / 100)
        _, sigma, notes = self.off(*self.polled(rows, even, MOTION.w(even)))
        self.assertGreater(sigma, 1e-3)
        self.assertIn("up to 5 ms older", notes[0])

    def test_other_repeats_are_left_to_the_estimator(self):
        t, w = self.sensor(200.0)
        ns = np.round(t * 1e9).astype(np.int64)
        self.assertIsNone(held.samples(ns, w))
        # Coarse values repeat where the body turns slowly.
        self.assertIsNone(held.samples(ns, np.round(w * 50) / 50))
        for copied in (np.arange(7, len(w), 10), np.flatnonzero(np.random.default_rng(4).random(len(w)) < 0.08)[1:]):
            faulty = w.copy()
            faulty[copied] = faulty[copied - 1]
            self.assertIsNone(held.samples(ns, faulty))

    def test_what_held_values_leave_open_is_a_refusal_that_says_so(self):
        t_b, w_b = self.sensor(333.0, 0.0)
        ns = [np.round(t * 1e9).astype(np.int64) for t in (t_b, t_b)]
        a, b = (twist_sync.Recording(pathlib.Path(n), "", t, w_b) for n, t in zip("ab", ns, strict=True))
        a.open_s = 0.9e-3
        solved = twist_sync.sync([a, b])
        self.assertRegex(report.object_of(solved)["pairs"][0]["reasons"][0], "the values of a are held, .* 900 µs .*--max-sigma-us 1080")
        solved = twist_sync.sync([a, b], sigma_limit=1.08e-3)
        self.assertAlmostEqual(solved.pairs[0].found.clock.offset_sigma, 0.9e-3, delta=1e-5)


if __name__ == "__main__":
    unittest.main()
