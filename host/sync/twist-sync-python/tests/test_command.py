"""Tests of the command `twist-sync` and of the readers of files.

The real twist that comes with the package is written in each form; files of forms that are no text
are written by the libraries of others: rosbags, mcap, numpy.
"""

import bz2
import contextlib
import ctypes as C
import gzip
import io
import json
import os
import pathlib
import re
import struct
import subprocess
import sys
import sysconfig
import tempfile
import unittest
from types import SimpleNamespace
from unittest import mock

import layouts
import numpy as np

import twist_sync
from twist_sync import command, files, report, text, video

ROOT = pathlib.Path(__file__).resolve().parents[4]
A = command.EXAMPLE / "mcu_gyro_data.csv"
B = command.EXAMPLE / "smartphone_gyro_data.csv"
TABLE = np.loadtxt(B, delimiter=",", skiprows=1)
T, W = TABLE[:, 0], TABLE[:, 1:]
NS = np.round(T * 1e9).astype(np.int64)


def run(*arguments):
    """Exit code, standard output and errors of the command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = command.main([os.fspath(a) for a in arguments])
        except SystemExit as end:
            code = end.code
    return code, out.getvalue(), err.getvalue()


def rows(form, t=T, w=W):
    return "".join(
        form.format(t, *row) + "\n" for t, row in zip(t.tolist(), w.tolist(), strict=True)
    )


def iso(t):
    return [f"{np.datetime64(n, 'ns')}Z" for n in t.tolist()]


class Folder(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def file(self, name, content):
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def offset(self, *arguments):
        code, out, err = run("--json", *arguments)
        self.assertEqual(code, 0, out + err)
        return json.loads(out)["pairs"][0]


DEG, ACC = np.degrees(W), np.tile([0.1, 0.2, 9.81], (len(W), 1))
W_ACC = np.hstack([W, ACC])
#: Name, content, words of what is said about it.
TEXTS = {
    "OpenCamera-Sensors": ("".join(f"{x},{y},{z},{n}\n" for n, (x, y, z) in zip(NS.tolist(), W.tolist())), "ns"),
    "Sensor Logger": ("time,seconds_elapsed,z,y,x\n" + "".join(
        f"{n + 1_700_000_000 * 10**9},{(n - NS[0]) / 1e9},{z},{y},{x}\n" for n, (x, y, z) in zip(NS.tolist(), W.tolist())), "'time' in ns"),
    "phyphox": ('"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)","Absolute (rad/s)"\n'
        + rows("{:.9f},{:.9e},{:.9e},{:.9e},0", T - T[0]), "in rad/s (named)"),
    "phyphox, decimal commas": ('"Time (s)";"Gyroscope x (rad/s)";"Gyroscope y (rad/s)";"Gyroscope z (rad/s)";"Absolute (rad/s)"\n'
        + rows("{:.9f};{:.9e};{:.9e};{:.9e};0", T - T[0]).replace(".", ","), "semicolons"),
    "AndroSensor": ("sep=;\nACCELEROMETER X (m/s²);ACCELEROMETER Y (m/s²);ACCELEROMETER Z (m/s²);GYROSCOPE X (rad/s);GYROSCOPE Y (rad/s);"
        "GYROSCOPE Z (rad/s);Time since start in ms \n"
        + "".join(f"0;0;9.8;{x};{y};{z};{t:.6f}\n" for t, (x, y, z) in zip(((T - T[0]) * 1e3).tolist(), W.tolist())), "in ms (named)"),
    "Physics Toolbox": ("time,wx,wy,wz\n" + rows("{:.9f},{},{},{}", T - T[0]), "'wx', 'wy', 'wz'"),
    "SensorLog of iOS": ("loggingTime(txt),accelerometerAccelerationX(G),accelerometerAccelerationY(G),accelerometerAccelerationZ(G),"
        "gyroTimestamp_sinceReboot(s),gyroRotationX(rad/s),gyroRotationY(rad/s),gyroRotationZ(rad/s)\n"
        + "".join(f"{i},0,0,1,{t:.9f},{x},{y},{z}\n" for i, t, (x, y, z) in zip(iso(NS), T.tolist(), W.tolist())), "sinceReboot"),
    "EuRoC": ("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
        + rows("{},{},{},{},{},{},{}", NS, W_ACC), "in ns (named)"),
    "rostopic echo -p": ("%time,field.header.seq,field.header.stamp,field.header.frame_id,field.orientation.x,field.orientation.y,"
        "field.orientation.z,field.orientation.w,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,"
        "field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z\n"
        + "".join(f"{n + 5_000_000 + k % 7 * 10**6},{k},{n},imu,0,0,0,1,{x},{y},{z},0,0,9.8\n" for k, (n, (x, y, z)) in enumerate(zip(NS.tolist(), W.tolist()))), "header.stamp"),
    "bagpy": ("Time,header.seq,header.stamp.secs,header.stamp.nsecs,angular_velocity.x,angular_velocity.y,angular_velocity.z\n"
        + "".join(f"{n / 1e9 + 0.01},0,{n // 10**9},{n % 10**9},{x},{y},{z}\n" for n, (x, y, z) in zip(NS.tolist(), W.tolist())), "stamp.secs"),
    "PX4": ("timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]\n"
        + "".join(f"{n // 1000},{x},{y},{z},2000,0,0,9.8\n" for n, (x, y, z) in zip(NS.tolist(), W.tolist())), "in us (by their distance)"),
    "Betaflight": ("loopIteration,time (us),accSmooth[0],accSmooth[1],accSmooth[2],gyroADC[0],gyroADC[1],gyroADC[2]\n"
        + "".join(f"{k},{n // 1000},0,0,2048,{x:.4f},{y:.4f},{z:.4f}\n" for k, (n, (x, y, z)) in enumerate(zip(NS.tolist(), (DEG).tolist()))), "'gyroADC[0]'"),
    "ArduPilot": ("TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ\n" + rows("{},{},{},{},{},{},{}", NS // 1000, W_ACC), "in us (named)"),
    "Arduino, micros": ("micros\tgx_dps\tgy_dps\tgz_dps\n" + rows("{}\t{}\t{}\t{}", NS // 1000, DEG), "in deg/s (named)"),
    "mdps": ("# a comment\n# another\nt_ns, gyro_x [mdps], gyro_y [mdps], gyro_z [mdps]\n" + rows("{}, {}, {}, {}", NS, DEG * 1e3), "in mdps (named)"),
    "rpm": ("time_s,gyro_x_rpm,gyro_y_rpm,gyro_z_rpm\n" + rows("{},{},{},{}", T, W * 30 / np.pi), "in rpm (named)"),
    "ISO times": ("timestamp,gyro_x,gyro_y,gyro_z\n" + "".join(f"{i},{x},{y},{z}\n" for i, (x, y, z) in zip(iso(NS), W.tolist())), "dates"),
    "headerless t x y z": (rows("{} {} {} {}"), "'1' in s"),
    "degrees without a name": ("t,x,y,z\n" + rows("{},{},{},{}", T, DEG), "in deg/s (by their size)"),
}  # fmt: skip


class Texts(Folder):
    def test_every_form_gives_the_same_and_says_what_it_took(self):
        plain = self.offset(A, B)
        self.assertAlmostEqual(plain["offset_s"], 947848.638469, delta=2e-6)
        for name, (content, said) in TEXTS.items():
            with self.subTest(name):
                path = self.file("b.csv", content)
                read = twist_sync.read(path)
                self.assertEqual(len(read.t), len(T))
                self.assertIn(said, read.form)
                # What is noise in the last digits is none of it.
                np.testing.assert_allclose(read.w, W, atol=2e-6)
                step = (read.t - read.t[0]) - (NS - NS[0])
                self.assertLess(np.abs(step).max(), 1001)

    def test_fields_of_regular_rows_are_not_judged_one_by_one(self):
        judged = []
        is_row = text.Dialect.is_row
        self.addCleanup(setattr, text.Dialect, "is_row", is_row)
        text.Dialect.is_row = lambda own, fields: judged.append(1) or is_row(own, fields)
        for name in ("OpenCamera-Sensors", "Sensor Logger", "phyphox, decimal commas", "EuRoC", "PX4"):
            judged.clear()
            path = self.file("b.csv", TEXTS[name][0])
            self.assertEqual(len(twist_sync.read(path).t), len(T))
            # Those by which the separators are found, and one of the table.
            self.assertLess(len(judged), 400 * 9 + 9)

    def test_what_cannot_be_found_can_be_said(self):
        path = self.file("b.txt", "7\n" + rows("5 {2} {3} {1} {0}", (T - T[0]) * 1e6))
        code, _, err = run(A, path)
        self.assertEqual(code, 5)
        self.assertIn("--columns", err)
        given = [
            "--columns",
            "mcu_time,mcu_x,mcu_y,mcu_z",
            "--columns",
            "5,4,2,3",
            "--time-unit",
            "s",
            "--time-unit",
            "us",
        ]
        self.assertAlmostEqual(
            self.offset(A, path, *given)["offset_s"], 947848.638469 - T[0], delta=1e-3
        )
        code, _, err = run(A, path, "--columns", "a", "--columns", "b", "--columns", "c")
        self.assertEqual(code, 2)
        code, _, err = run(A, B, "--columns", "mcu_time,mcu_x,mcu_y,nothing")
        self.assertEqual((code, "nothing" in err), (5, True))

    def test_rates_in_unnamed_degrees_are_seen_by_the_other_recording(self):
        # Slow enough to be rad/s by its size.
        slow = self.file("b.csv", "t,x,y,z\n" + rows("{},{},{},{}", T, DEG * 0.2))
        named = self.file("a.csv", "t,x rad/s,y rad/s,z rad/s\n" + rows("{},{},{},{}", T, W * 0.2))
        solved = twist_sync.sync([named, slow])
        self.assertIn("divided by 57.296", solved.recordings[1].notes[-1])
        np.testing.assert_allclose(solved.recordings[1].w, W * 0.2, atol=1e-9)

    def test_rows_without_numbers_and_a_cut_last_row_are_left_out(self):
        lines = B.read_text().splitlines()
        lines[10] = lines[10].split(",")[0] + ",,nan,"
        whole = "\n".join(lines)
        # Between two fields, and within the last number's exponent.
        for text in (whole[:-30], whole.rpartition(",")[0] + ",-1E-"):
            read = twist_sync.read(self.file("b.csv", text))
            self.assertEqual(len(read.t), len(T) - 2)
            missing = "line 11: '949113.233985,,nan,' is no row: left out"
            expected = [missing, "its last line is cut and left out"]
            self.assertEqual(read.notes, expected)

    def test_several_gyroscopes_are_named(self):
        path = self.file("b.csv", "t,gyro_left_x,gyro_left_y,gyro_left_z,gyro_right_x,gyro_right_y,gyro_right_z\n"
            + rows("{0},{1},{2},{3},{2},{1},{3}"))  # fmt: skip
        code, _, err = run(A, path)
        self.assertEqual((code, "@gyro left" in err), (5, True), err)
        self.assertAlmostEqual(
            self.offset(A, f"{path}@gyro left")["offset_s"], 947848.638469, delta=2e-6
        )

    def test_damage_is_an_error_with_its_line(self):
        for content, said in [
            ("", "empty"),
            ("time,x,y,z\n", "no rows"),
            ("time,x,y,z\n1,2,3,4\n1.1,2,three,4\n1.2,2,3,4\n", "line 3, column 'y': could not convert"),
            ("time,x,y,z\n1,2,3,4\n1.1,2,3\n1.2,2,3,4\n", "line 3: expected 4 columns"),
            ("time (s),x,y,z\n1,2,3,4\n1.5,2,3,4\n2,2,3,4\n", "0.5 s apart"),
            ("a,b,c,d\n1,2,3,4\n", "no columns of a gyroscope among a, b, c, d"),
            ("x,y,z,q\n1,2,3,4\n", "no column of times"),
            ("time,x_deg,y_deg,z\n1,2,3,4\n2,2,3,4\n", "one unit"),
            ("time,x,y,z\n1e300,2,3,4\n2e300,2,3,4\n", "times"),
            (b"time,x,y,z\n\0\1\2", "no text"),
            ("x" * 300_000, "without end"),
            ("99999999999999999999999,1,2,3\n", ""),
        ]:
            with self.subTest(content[:40]):
                code, _, err = run(A, self.file("b.csv", content))
                self.assertEqual(code, 5, err)
                self.assertIn(said, err)


def write_bag(path, kind, samples, topics=("/imu/data",)):
    """A bag by the library rosbags, as its other users write them."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    types = store.types
    Time, Vector3, Imu = (
        types[k]
        for k in ("builtin_interfaces/msg/Time", "geometry_msgs/msg/Vector3", "sensor_msgs/msg/Imu")
    )
    Header, Quaternion = types["std_msgs/msg/Header"], types["geometry_msgs/msg/Quaternion"]
    Text = types["std_msgs/msg/String"]
    if kind == "ros1":
        writer = rosbag1.Writer(path)
        writer.set_compression(writer.CompressionFormat.BZ2)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    pack = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
    with writer:
        own = [writer.add_connection(topic, Imu.__msgtype__, typestore=store) for topic in topics]
        chat = writer.add_connection("/chat", Text.__msgtype__, typestore=store)
        for k, (ns, w) in enumerate(zip(NS.tolist(), samples.tolist(), strict=True)):
            stamp = Time(sec=ns // 10**9, nanosec=ns % 10**9)
            more = {"seq": k} if kind == "ros1" else {}
            for connection in own:
                message = Imu(
                    header=Header(stamp=stamp, frame_id="imu"[: k % 4], **more),
                    orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
                    orientation_covariance=np.zeros(9),
                    angular_velocity=Vector3(x=w[0], y=w[1], z=w[2]),
                    angular_velocity_covariance=np.zeros(9),
                    linear_acceleration=Vector3(x=0.0, y=0.0, z=9.8),
                    linear_acceleration_covariance=np.zeros(9),
                )
                # Received later than measured: the header counts.
                writer.write(
                    connection, ns + 5_000_000 + k % 7 * 10**6, pack(message, Imu.__msgtype__)
                )
            if k % 100 == 0:
                writer.write(chat, ns + 10**6, pack(Text(data="hello"), Text.__msgtype__))


class Bags(Folder):
    """With readers in this process; that of others is tested in `Others`."""

    def setUp(self):
        super().setUp()
        self.addCleanup(setattr, files, "_in_process", files._in_process)
        files._in_process = files._read_here

    def test_bags_of_every_storage_are_read_and_written_again(self):
        expected = self.offset(A, B)
        for kind, name in [("ros1", "b.bag"), ("sqlite3", "b"), ("mcap", "b")]:
            folder = self.folder / kind
            folder.mkdir()
            path = folder / name
            write_bag(path, kind, W)
            recordings = [path, *(path.glob("*.mcap") if kind == "mcap" else [])]
            for recording in recordings:
                with self.subTest(recording.name):
                    out = folder / f"out {recording.name}"
                    pair = self.offset(A, recording, "--write", out)
                    self.assertAlmostEqual(pair["offset_s"], expected["offset_s"], delta=1e-8)
                    self.assertEqual(pair["b"], recording.name)
                    again = out / recording.name
                    after = self.offset(A, again)
                    self.assertLess(abs(after["offset_s"]), 5e-6)
                    self.assertLess(abs(after["skew_ppm"]), 0.05 * after["skew_sigma_ppm"])
                    # Log times of all topics move as the stamps do.
                    logs = []
                    for bag in (recording, again):
                        if bag.is_file() and bag.suffix == ".mcap":
                            from mcap.reader import make_reader

                            with bag.open("rb") as file:
                                messages = make_reader(file).iter_messages(log_time_order=False)
                                logs.append([(c.topic, m.log_time) for _, c, m in messages])
                        else:
                            from rosbags.highlevel import AnyReader

                            with AnyReader([bag]) as reader:
                                logs.append([(c.topic, log) for c, log, _ in reader.messages()])
                    self.assertEqual(len(logs[0]), len(T) + 49)
                    self.assertEqual([t for t, _ in logs[0]], [t for t, _ in logs[1]])
                    clock = twist_sync.sync([A, recording]).clock(1)
                    moved = clock.b_to_a(np.array([n for _, n in logs[0]]))
                    self.assertLess(np.abs(moved - np.array([n for _, n in logs[1]])).max(), 2)

    def test_the_storage_of_a_bag_without_its_metadata_is_read_and_written_again(self):
        write_bag(self.folder / "b", "sqlite3", W)
        (self.folder / "b/metadata.yaml").unlink()
        path = next((self.folder / "b").glob("*.db3"))
        before = path.read_bytes()
        out = self.folder / "out"
        pair = self.offset(A, path, "--write", out)
        self.assertAlmostEqual(pair["offset_s"], 947848.638469, delta=2e-6)
        self.assertLess(abs(self.offset(A, out / path.name)["offset_s"]), 5e-6)
        self.assertEqual(path.read_bytes(), before)

    def test_stamps_of_json_in_mcap_are_written_again_to_the_nanosecond(self):
        made = layouts.Made(layouts.Motion(), start=layouts.EPOCH)
        path = self.file("b.mcap", layouts.mcap_json(made))
        a = self.file("a.csv", layouts.sensor_logger(made.again(start=5 * 10**9, seed=3)))
        self.offset(a, path, "--exact-stamps", "--write", self.folder / "out")
        clock = twist_sync.sync([a, path], exact_stamps=True).clock(1)
        again = twist_sync.read(self.folder / "out/b.mcap")
        self.assertLessEqual(np.abs(again.t - clock.b_to_a(made.ns)).max(), 1)
        np.testing.assert_array_equal(again.w, made.w)

    def test_poses_in_a_bag_are_turned_into_rates(self):
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        made = layouts.Made(layouts.Motion())
        for ros1 in (True, False):
            store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
            kinds = "Header std_msgs Time builtin_interfaces Point geometry_msgs Vector3 geometry_msgs Quaternion geometry_msgs Pose geometry_msgs PoseStamped geometry_msgs Transform geometry_msgs TransformStamped geometry_msgs".split()
            make = SimpleNamespace(**{k: store.types[f"{p}/msg/{k}"] for k, p in zip(kinds[::2], kinds[1::2])})
            for name in ("PoseStamped", "TransformStamped"):
                with self.subTest(name=name, ros1=ros1):
                    path = self.folder / f"{name}{ros1}{'.bag' if ros1 else ''}"
                    writer = rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9)
                    kind = f"geometry_msgs/msg/{name}"
                    with writer:
                        connection = writer.add_connection("/body", kind, typestore=store)
                        for k, (ns, q) in enumerate(zip(made.ns.tolist(), made.q.tolist())):
                            stamp = make.Time(sec=ns // 10**9, nanosec=ns % 10**9)
                            header = make.Header(stamp=stamp, frame_id="room"[: k % 5], **({"seq": k} if ros1 else {}))
                            turn = make.Quaternion(w=q[0], x=q[1], y=q[2], z=q[3])
                            if name == "PoseStamped":
                                message = make.PoseStamped(header, make.Pose(make.Point(1.0, 2.0, 3.0), turn))
                            else:
                                moved = make.Transform(make.Vector3(1.0, 2.0, 3.0), turn)
                                message = make.TransformStamped(header, "body"[: k % 3], moved)
                            pack = store.serialize_ros1 if ros1 else store.serialize_cdr
                            writer.write(connection, ns, pack(message, kind))
                    read = twist_sync.read(path)
                    self.assertIn("quaternions", read.form)
                    self.assertEqual(len(read.t), len(made.ns) - 1)
                    error = read.w - made.motion.w(read.t * 1e-9)
                    self.assertLess(np.abs(error).max(), 0.06)

    def test_one_of_several_topics_is_chosen(self):
        path = self.folder / "b.bag"
        write_bag(path, "ros1", W, ("/imu/data", "/other"))
        code, _, err = run(A, path)
        self.assertEqual((code, "several gyroscopes: @/imu/data" in err), (5, True), err)
        self.assertTrue(self.offset(A, f"{path}@/other")["accepted"])
        code, _, err = run(A, f"{path}@/chat")
        self.assertEqual((code, "no gyroscope named" in err and "/chat" in err), (5, True), err)


def insta360(t, w):
    """A video of an Insta360 camera without a picture: after the boxes of MP4 come records,
    each before its format, kind and length, and a trailer. By InsvHeader.java, FrameHeader.java,
    GyroV2Record.java and extra_metadata.proto of <https://github.com/alex-plekhanov/insvtools>;
    samples are about half of 65536, which is 4000 °/s."""

    counts = np.round(np.degrees(w) / 4000 * 65536).astype(int) + 32768
    half = 32768
    samples = b"".join(
        struct.pack("<Q6H", round(at * 1e6), half, half, half, *row)
        for at, row in zip(t.tolist(), counts.tolist(), strict=True)
    )
    # Protocol buffers: 2 (text) is the camera, 62 (bool) says that the samples are raw.
    camera = b"\x12\x07Tests 1\xf0\x03\x01"
    records = b"".join(
        content + bytes([0, kind]) + len(content).to_bytes(4, "little")
        for kind, content in ((3, samples), (1, camera))
    )
    trailer = bytes(32) + (len(records) + 72).to_bytes(4, "little") + (3).to_bytes(4, "little")
    begin = b"\0\0\0\x10ftypmp41\0\0\0\0\0\0\0\x08moov"
    return begin + records + trailer + b"8db42d694ccc418790edff439fe026bf"


class Others(Folder):
    def test_arrays_of_numpy(self):
        path = self.folder / "b.npz"
        np.savez(path, time=NS, gyro=W, acc=ACC)
        pair = self.offset(A, path, "--write", self.folder / "out")
        self.assertAlmostEqual(pair["offset_s"], 947848.638469, delta=2e-6)
        self.assertLess(abs(self.offset(A, self.folder / "out/b.npz")["offset_s"]), 1e-6)
        np.savez(path, acc=ACC, gyro=W)
        self.assertEqual(run(A, path)[0], 5)

    def test_matroska_of_the_cameras_maker_is_read_as_its_own_library_does(self):
        """The file was written by libk4arecord; its reader is the oracle."""
        packed = next((ROOT / "hil-sim/scenarios/tests/data").glob("k4arecord*.mkv.bz2"))
        path = self.file("depth.mkv", bz2.decompress(packed.read_bytes()))
        libraries = pathlib.Path(sysconfig.get_path("purelib")) / "pyk4a_bundle.libs"
        _, _, k4a = (
            C.CDLL(os.fspath(next(libraries.glob(name))), C.RTLD_GLOBAL)
            for name in ("libudev*", "libk4a-*", "libk4arecord-*")
        )

        class Sample(C.Structure):
            _fields_ = [
                ("temperature", C.c_float),
                ("acc", C.c_float * 3),
                ("acc_us", C.c_uint64),
                ("gyro", C.c_float * 3),
                ("gyro_us", C.c_uint64),
            ]

        handle, sample = C.c_void_p(), Sample()
        self.assertEqual(k4a.k4a_playback_open(os.fspath(path).encode(), C.byref(handle)), 0)
        expected = []
        while k4a.k4a_playback_get_next_imu_sample(handle, C.byref(sample)) == 0:
            expected.append((sample.gyro_us, *sample.gyro))
        k4a.k4a_playback_close(handle)
        self.assertGreater(len(expected), 300)
        expected = np.array(expected)
        read = twist_sync.read(path)
        np.testing.assert_array_equal(read.t // 1000, expected[:, 0])
        np.testing.assert_array_equal(read.w, expected[:, 1:])
        self.assertEqual([len(frames) for frames in read.frames.values()], [6, 6, 6])
        # Cut off anywhere, it gives what is there.
        whole = path.read_bytes()
        cut = twist_sync.read(self.file("cut.mkv", whole[: len(whole) // 2]))
        self.assertIn("ends within", cut.notes[0])
        np.testing.assert_array_equal(cut.t, read.t[: len(cut.t)])

    @unittest.skipIf(sys.version_info >= (3, 13), "telemetry-parser has no wheel")
    def test_a_video_of_insta360_by_telemetry_parser(self):
        pair = self.offset(A, self.file("VID.insv", insta360(T - T[0], W)))
        self.assertLess(abs(pair["offset_s"] + T[0] - 947848.638469), 2 * pair["offset_sigma_s"])

    def test_frames_of_a_video_are_those_that_ffmpeg_wrote(self):
        path = self.folder / "a.mp4"
        make = "ffmpeg -v error -f lavfi -i testsrc=size=64x64:rate=30000/1001 -frames:v 40 -bf 2 -c:v libx264"
        subprocess.run([*make.split(), path], check=True)
        show = "ffprobe -v error -select_streams v -show_entries packet=pts_time -of csv=p=0"
        said = subprocess.run([*show.split(), path], check=True, capture_output=True, text=True)
        expected = sorted(float(line.strip(",")) for line in said.stdout.split())
        with path.open("rb") as file:
            frames = video.mp4_frames(file)
        np.testing.assert_allclose(frames * 1e-9, expected, atol=1e-6)

    def test_a_folder_of_a_phones_app(self):
        self.file("phone/Gyroscope.csv", TEXTS["Sensor Logger"][0])
        self.file("phone/Accelerometer.csv", "time,seconds_elapsed,z,y,x\n1,2,3,4,5\n")
        pair = self.offset(A, self.folder / "phone")
        self.assertEqual((pair["accepted"], pair["b"]), (True, "Gyroscope.csv"))

    def test_hostile_files_are_errors(self):
        bag = self.folder / "a.bag"
        write_bag(bag, "ros1", W[:500].repeat(10, axis=0)[: len(W)])
        ros1 = bag.read_bytes()
        bomb = self.folder / "bomb.npz"
        np.savez_compressed(bomb, t=np.zeros(3), w=np.zeros((3, 3)))
        packed = bomb.read_bytes().replace(b"(3, 3)", b"(9999999999, 3)"[:6])
        for name, content in [
            ("a.bag", ros1[:3000]),
            ("b.bag", ros1[:100] + bytes(3000)),
            ("c.mcap", b"\x89MCAP0\r\n" + bytes(range(256)) * 20),
            ("d.db3", b"SQLite format 3\0" + bytes(100)),
            (
                "e.mkv",
                b"\x1a\x45\xdf\xa3"
                + b"\x18\x53\x80\x67\x01\xff\xff\xff\xff\xff\xff\xff"
                + b"\xff" * 99,
            ),
            ("f.mp4", b"\0\0\0\x10ftypmp41\0\0\0\0\xff\xff\xff\xffmoov" + bytes(99)),
            ("g.npz", packed[: len(packed) // 2]),
            ("h.zip", b"PK\x03\x04" + bytes(30)),
            ("i.insv", b"\0\0\0\x08moov" + bytes(72) + b"8db42d694ccc418790edff439fe026bf"),
        ]:
            with self.subTest(name):
                code, out, err = run(A, self.file(name, content))
                self.assertEqual((code, out), (5, ""), err)

    def test_small_files_cost_little(self):
        held = np.zeros((20_000_000, 3), np.float32)
        np.savez_compressed(self.folder / "memory.npz", time=held[:, 0], gyro=held)
        np.savez(self.folder / "samples.npz", time=NS, gyro=W)
        self.enterContext(mock.patch.multiple(files, SMALL_SAMPLES=99, SAMPLES_A_BYTE=0))
        with gzip.open(self.folder / "text.csv.gz", "wb") as file:
            file.write(b"0,0,0,0\n" * 10_000_000)
        os.mkfifo(self.folder / "pipe.csv")
        for name, said in [
            ("memory.npz", "of memory would be needed"),
            ("samples.npz", "samples; a file of its size"),
            ("text.csv.gz", "an archive that holds more than"),
            ("pipe.csv", "not a regular file"),
        ]:
            with self.subTest(name):
                path = self.folder / name
                if path.is_file():
                    # Far below what it would take, and far above nothing.
                    self.assertLess(path.stat().st_size, 2_000_000)
                code, out, err = run(A, path)
                self.assertEqual((code, out, said in err), (5, "", True), err)

    def test_nothing_of_a_file_acts_on_the_terminal(self):
        evil = self.file("\x1b]0;title\x07.csv", "time,x,y,z\n" + "\x1b[2J\x9b31m,0,0,0\n" * 9)
        for files_given in [(A, evil), (A, self.folder / "none\x1b[2J.csv")]:
            code, out, err = run(*files_given)
            self.assertEqual(code, 5)
            self.assertEqual([c for c in out + err if c != "\n" and not c.isprintable()], [])
            self.assertIn("\\x1b", err)

    def test_a_reader_that_hangs_crashes_or_takes_all_memory_is_ended(self):
        video = self.file("a.mp4", b"\0\0\0\x10ftypmp41\0\0\0\0")
        parser = "class Parser:\n camera, model = 'Cam', 'A\\x1b1'\n def __init__(self, path): pass\n def normalized_imu(self): "
        limits = files.LIMIT_S
        self.addCleanup(setattr, files, "LIMIT_S", limits)
        sys.path.insert(0, os.fspath(self.folder))
        self.addCleanup(sys.path.remove, os.fspath(self.folder))
        for body, said in [
            ("import time; time.sleep(99)", "ended with -14"),
            ("import os; os.abort()", "ended with -6"),
            ("import os; os._exit(7)", "ended with 7"),
            ("return bytearray(1 << 30)", "of memory would be needed"),
            ("raise ValueError('No metadata')", "ValueError: No metadata"),
            ("print('noise'); return []", "telemetry"),
        ]:
            with self.subTest(body):
                files.LIMIT_S = 2 if "sleep" in body else limits
                self.file("telemetry_parser.py", parser + body)
                code, _, err = run(A, video)
                self.assertEqual((code, said in err), (5, True), err)
        self.file(
            "telemetry_parser.py",
            parser
            + "return [{'timestamp_ms': k / 2, 'gyro': (180.0, 0.0, -90.0 * k)} for k in range(9)]",
        )
        read = twist_sync.read(video)
        self.assertIn("Cam (A1)".replace("A1", "A\x1b1"), read.form)
        np.testing.assert_array_equal(read.t, np.arange(9) * 500_000)
        np.testing.assert_allclose(read.w[1], [np.pi, 0, -np.pi / 2])
        self.file("telemetry_parser.py", "raise ImportError")
        self.assertIn('pip install "twist-sync[video]"', run(A, video)[2])


class Command(Folder):
    def test_exit_codes_and_the_object(self):
        code, out, _ = run("--json", "--example")
        found = json.loads(out)
        pair = found["pairs"][0]
        self.assertEqual((code, pair["a"], pair["b"]), (0, A.name, B.name))
        self.assertIsNone(found["network"])
        self.assertAlmostEqual(pair["offset_s"], 947848.638469, delta=2e-6)
        self.assertAlmostEqual(pair["offset_sigma_s"], 23.6e-6, delta=1e-7)
        self.assertTrue(
            all(gate["passed"] and {"value", "limit"} <= gate.keys() for gate in pair["gates"])
        )
        self.assertEqual(np.shape(pair["rotation"]), (3, 3))
        self.assertEqual({f["recording"] for f in pair["faults"]}, {A.name, B.name})
        self.assertEqual(
            {f["kind"] for f in pair["faults"]},
            {"copied_sample", "displaced_class", "timestamp_sawtooth", "outlier"},
        )

        rest = self.file(
            "rest.csv",
            "t,x,y,z\n" + rows("{},{},{},{}", T, W * 0 + 1e-3 * np.sin(np.arange(len(T)))[:, None]),
        )
        code, out, _ = run("--json", A, rest)
        pair = json.loads(out)["pairs"][0]
        self.assertEqual((code, pair["accepted"], pair["offset_s"]), (3, False, None))
        self.assertTrue(pair["reasons"] and not all(gate["passed"] for gate in pair["gates"]))
        code, out, _ = run(A, rest)
        self.assertIn(f"rest.csv - {A.name}: REFUSED", out)

        for arguments in (
            [],
            [A],
            [A, B, "--delay-us", "1,2,3"],
            [A, B, "--low-pass-hz", "4"],
            [A, B, "--no-such"],
        ):
            self.assertEqual(run(*arguments)[0], 2, arguments)
        code, _, err = run(A, "no such.csv")
        self.assertEqual((code, "no such.csv: No such file" in err), (5, True), err)

    def test_text_names_files_and_never_board_or_phone(self):
        code, out, _ = run("--example")
        self.assertEqual(code, 0)
        pair = json.loads(run("--json", "--example")[1])["pairs"][0]
        self.assertIn(f"± {pair['offset_sigma_s'] * 1e6:.2f} µs", out)
        self.assertRegex(out, r"twist_sync\.sync\(\[.*\]\)\.clock\(1\)\.b_to_a\(t\)")
        self.assertNotRegex(out, r"\b(board|phone|stream [ab])\b")
        # The line of Python that is printed.
        line = out.split("in Python, t in ns: ")[1].strip()
        moved = eval(line, {"twist_sync": twist_sync, "t": NS})
        self.assertLess(abs(moved[0] * 1e-9 + 947848.6385 - T[0]), 1e-3)

    def test_three_recordings_and_their_files_on_one_clock(self):
        b = self.file("b/gyro.csv", TEXTS["phyphox, decimal commas"][0])
        c = self.file("c/gyro.csv", "when,gyro_x,gyro_y,gyro_z,note\n".replace("when", "timestamp")
            + "".join(f"{i},{x},{y},{z},\"a, {k}\"\n" for k, (i, (x, y, z)) in enumerate(zip(iso(NS), (W @ np.diag([1, -1, -1])).tolist()))))  # fmt: skip
        before = c.read_bytes()
        out = self.folder / "out"
        plot = self.folder / "all.png"
        code, text_out, err = run("--json", A, b, c, "--write", out, "--plot", plot)
        self.assertEqual(code, 0, err)
        found = json.loads(text_out)
        self.assertEqual(len(found["pairs"]), 3)
        (loop,) = found["network"]["loops"]
        self.assertLess(loop["closure_rms_s"], loop["sigma_rms_s"])
        self.assertEqual(
            [k["recording"] for k in found["network"]["clocks"]], ["gyro.csv", "gyro.csv"]
        )
        self.assertEqual(plot.read_bytes()[:4], b"\x89PNG")
        self.assertEqual(c.read_bytes(), before)
        for name, original in (("2_gyro.csv", b), ("3_gyro.csv", c)):
            written = out / name
            self.assertEqual(
                len(written.read_text().splitlines()), len(original.read_text().splitlines())
            )
            after = self.offset(A, written)
            self.assertLess(abs(after["offset_s"]), 5e-6)
        self.assertIn('"a, 7"', (out / "3_gyro.csv").read_text())
        # Nothing is overwritten.
        self.assertEqual(run(A, b, c, "--write", out)[0], 5)

    def test_whole_recordings_say_their_windows(self):
        rng = np.random.default_rng(5)
        t = np.arange(0, 70, 1 / 200.01)
        w = sum(
            np.sin(2 * np.pi * f * t[:, None] + p)
            for f, p in zip(rng.uniform(0.3, 3, 12), rng.uniform(0, 6, (12, 3)))
        )
        form = "t,gx,gy,gz\n"
        a = self.file(
            "a.csv", form + rows("{:.9f},{:.6f},{:.6f},{:.6f}", t, w + rng.normal(0, 1e-3, w.shape))
        )
        b = self.file(
            "b.csv",
            form
            + rows(
                "{:.9f},{:.6f},{:.6f},{:.6f}", t * (1 + 2e-5) + 7, w + rng.normal(0, 1e-3, w.shape)
            ),
        )
        pair = self.offset(a, b, "--plot", self.folder / "a.svg")
        windows = pair["windows"]
        self.assertGreaterEqual(windows["used"], 6)
        self.assertEqual(windows["refused"], sum(one["windows"] for one in pair["refused_windows"]))
        self.assertEqual((pair["steps"], pair["unsupported"]), ([], []))
        self.assertLess(
            abs(pair["offset_s"] - 7 - 2e-5 * pair["reference_s"]), 5 * pair["offset_sigma_s"]
        )
        self.assertRegex(run(a, b)[1], r"^RELATED: .* to ± .* \(95 %\); 7 of 7 stretches agree")
        self.assertIn("7 windows: 7 estimates used", run(a, b, "-v")[1])
        self.assertIsNone(self.offset(a, b, "--twist")["windows"])
        self.assertIsNotNone(self.offset(A, B, "--whole", "--max-sigma-us", "5000")["windows"])

    def test_recordings_that_were_together_only_at_times_are_related_there(self):
        rng = np.random.default_rng(8)

        def motion(t):
            f, p = rng.uniform(0.3, 3, 12), rng.uniform(0, 6, (12, 3))
            return sum(np.sin(2 * np.pi * f * t[:, None] + p) for f, p in zip(f, p))

        t = np.arange(0, 400, 1 / 100)
        together = ((t > 10) & (t < 50)) | ((t > 350) & (t < 390))
        a, b = motion(t), 1.5 * motion(t)
        b[together] = a[together] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
        form = "{:.9f},{:.6f},{:.6f},{:.6f}"
        noisy = lambda w: w + rng.normal(0, 3e-3, w.shape)  # noqa: E731
        first = self.file("a.csv", "t (s),gx (rad/s),gy (rad/s),gz (rad/s)\n" + rows(form, t, noisy(a)))
        second = self.file("b.csv", "t (s),gx (rad/s),gy (rad/s),gz (rad/s)\n" + rows(form, t * (1 + 2e-5) + 7, noisy(b)))
        code, out, err = run(first, second, "--exact-stamps")
        self.assertEqual(code, 0, out + err)
        self.assertRegex(out, r"^RELATED: .*, to ± [\d.]+ µs \(95 %\) where they were together; 8 of 8 stretches agree")
        self.assertRegex(out, r"b.csv - a.csv, 50\.0 to 350\.0 s: nothing supports the relation there")
        relation = twist_sync.sync([first, second], exact_stamps=True).pairs[0].found
        for at in (30.0, 370.0):
            there = relation.at(at)
            self.assertLess(abs(there.offset - 2e-5 * at), 4 * there.offset_sigma)
            self.assertLess(there.offset_sigma, 20e-6)
        self.assertGreater(relation.at(200.0).offset_sigma, 1e-3)
        # Nothing else in common.
        alone = self.file("c.csv", "t (s),gx (rad/s),gy (rad/s),gz (rad/s)\n" + rows(form, t, noisy(1.5 * motion(t))))
        code, out, _ = run(first, alone)
        self.assertEqual((code, out.startswith("NOT RELATED: ")), (3, True), out)

    def test_mirrored_axes_and_units_that_cannot_be_are_said(self):
        made = layouts.Made(layouts.Motion())
        form = "t,x rad/s,y rad/s,z rad/s\n"
        right = self.file("a.csv", form + rows("{},{},{},{}", made.s, made.w))
        for axes in ([0, 1, 2], [1, 0, 2]):
            w = made.again(seed=4).w[:, axes] * ([1, 1, -1] if axes[0] == 0 else 1)
            mirrored = self.file("b.csv", form + rows("{},{},{},{}", made.s, w))
            code, out, _ = run(right, mirrored, "--exact-stamps")
            self.assertEqual(code, 0)
            self.assertRegex(out, "^RELATED.*mind the warning")
            self.assertIn("mirrored: in one of them two axes are exchanged", out)
            pair = self.offset(right, mirrored, "--exact-stamps")
            self.assertEqual((pair["mirrored"], pair["rotation"]), (True, None))
        self.assertFalse(self.offset(A, B)["mirrored"])
        wrong = self.file("c.csv", "t,x,y,z\n" + rows("{},{},{},{}", T, W))
        code, out, _ = run(B, wrong, "--unit", "rad/s", "--unit", "deg/s")
        self.assertEqual(code, 3)
        self.assertRegex(out.splitlines()[0], r"57 times as fast as c\.csv.*the unit of .*c\.csv \(given\) is doubted.*Next: give it with --unit")
        code, out, _ = run(wrong, wrong, "--unit", "deg/s", "--unit", "deg/s")
        self.assertEqual(code, 3)
        self.assertRegex(out.splitlines()[0], r"c\.csv hardly turns, by 0\.0\d+ rad/s .*that unit is doubted.*Next: give it")
        alone = twist_sync.sync([B, twist_sync.read(wrong, unit="deg/s")])
        with self.assertRaisesRegex(twist_sync.Refused, r"number 2; .*c\.csv: "):
            alone.clock(1)

    def test_a_refusal_is_drawn_with_its_gates_and_ten_recordings_end_in_ten_rows(self):
        from twist_sync import plot

        other = self.file("other.csv", "t,x rad/s,y rad/s,z rad/s\n" + rows("{},{},{},{}", T, np.roll(W[::-1], 700, axis=0)))
        solved = twist_sync.sync([A, other])
        figure = plot.figure(solved)
        self.assertRegex(figure.axes[0].get_title(), "^NOT RELATED: ")
        self.assertEqual([len(axes.patches) > 3 or len(axes.lines) == 2 for axes in figure.axes], [True, True])
        figure = plot.figure(twist_sync.sync([A, B]))
        self.assertRegex(figure.axes[0].get_title(), r"^RELATED: .* \(95 %\)")
        self.assertEqual([line.get_label()[-6:] for line in figure.axes[0].lines][-1], " after")
        read = [twist_sync.read(p) for p in (A, B)]
        solved = twist_sync.sync([read[k % 2] for k in range(4)])
        lines = report.text_of(solved, report.object_of(solved), None, False).splitlines()
        self.assertIn("its clock less the first", lines[-5])
        self.assertEqual([line.split()[0] for line in lines[-4:]], [r.name for r in solved.recordings])

    def test_commands_of_the_documents_are_those_of_the_program(self):
        pages = [
            ROOT / "README.md",
            *(ROOT / "docs").glob("*.md"),
            ROOT / "host/sync/twist-sync-python/README.md",
        ]
        parser = command.parser()
        seen = 0
        for page in pages:
            for words in re.findall(r"(?m)(?:^|`)twist-sync( [^`#\n]*)", page.read_text()):
                options = {word for word in words.split() if word.startswith("--")}
                self.assertLessEqual(options, parser._option_string_actions.keys(), (page, words))
                seen += 1
        self.assertGreater(seen, 10)


if __name__ == "__main__":
    unittest.main()
