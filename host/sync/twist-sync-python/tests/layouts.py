"""Files in the layouts that apps, loggers, motion capture and robots write, of one made motion.

Each row of `LAYOUTS`: the kind of difficulty, a name, the source of the layout (a public document
or the code that writes it), a function that makes the file, and words that must be said about it.
To add a layout, add a row.
"""

import gzip
import io
import json
import lzma
import struct
import zipfile
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

#: The motion lasts so long, s.
LENGTH = 7.0


class Motion:
    """Rates of a body in its own axes and its orientation in the room, at any time."""

    def __init__(self, seed=0, size=1.2):
        rng = np.random.default_rng(seed)
        self.f = rng.uniform(0.3, 2.0, (3, 8))
        self.p = rng.uniform(0, 2 * np.pi, (3, 8))
        self.size = size
        fine = np.arange(-0.5, LENGTH + 0.5, 1 / 2000)
        # Products of ever more of them, by doubling.
        turns = Rotation.from_rotvec(self.w(fine[:-1] + 0.25e-3) / 2000)
        far = 1
        while far < len(turns):
            turns = Rotation.concatenate([turns[:far], turns[:-far] * turns[far:]])
            far *= 2
        first = Rotation.from_euler("zyx", [0.4, 0.3, -0.2])
        self.turns = Slerp(fine, Rotation.concatenate([first, first * turns]))

    def w(self, t):
        waves = np.sin(2 * np.pi * self.f * np.asarray(t)[:, None, None] + self.p)
        return self.size * waves.sum(axis=2) / 2

    def q(self, t):
        """w, x, y, z."""
        return self.turns(t).as_quat()[:, [3, 0, 1, 2]]

    def gravity(self, t):
        return self.turns(t).inv().apply([0, 0, 9.81])


@dataclass
class Made:
    """Content of a file: `rate` samples a second of a motion, read on a clock that shows
    `start` ns when the motion is at 0 and is fast by `skew`."""

    motion: Motion
    rate: float = 200.0
    start: int = 0
    skew: float = 0.0
    noise: float = 2e-3
    turn: Rotation = field(default_factory=Rotation.identity)
    seed: int = 0
    jitter: float = 0.0

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self.s = np.arange(0.05, LENGTH - 0.05, 1 / self.rate)
        self.s = self.s + rng.uniform(-self.jitter, self.jitter, len(self.s))
        self.ns = self.start + np.round(self.s * (1 + self.skew) * 1e9).astype(np.int64)
        w = self.turn.apply(self.motion.w(self.s))
        self.w = w + rng.normal(0, self.noise, w.shape)
        self.deg = np.degrees(self.w)
        self.acc = self.turn.apply(self.motion.gravity(self.s))
        q = (self.motion.turns(self.s) * self.turn.inv()) if self.turn.magnitude() else self.motion.turns(self.s)
        self.q = (q * Rotation.from_rotvec(rng.normal(0, self.noise / 200, (len(self.s), 3)))).as_quat()[:, [3, 0, 1, 2]]

    def again(self, **more):
        own = {k: getattr(self, k) for k in ("motion", "rate", "start", "skew", "noise", "turn", "seed", "jitter")}
        return Made(**{**own, **more})

    def rows(self, form, *columns):
        """Lines of a format of t (ns), then the columns."""
        columns = [np.asarray(c).tolist() for c in columns]
        return "".join(form.format(*row) + "\n" for row in zip(*columns, strict=True))

    @property
    def matrix(self):
        return Rotation.from_quat(self.q[:, [1, 2, 3, 0]]).as_matrix().reshape(-1, 9)

    def iso(self, digits=6):
        return [str(np.datetime64(n, "ns"))[: 20 + digits] for n in self.ns.tolist()]


EPOCH = 1_773_000_000 * 10**9


def head(*lines):
    return "".join(line + "\n" for line in lines)


def table(names, *columns, between=","):
    """Lines of values as they print, under their names."""
    columns = [np.asarray(c).tolist() for c in columns]
    rows = zip(*([f"{x:.7f}" if isinstance(x, float) else str(x) for x in c] for c in columns), strict=True)
    return head(*([names] if names else []), *map(between.join, rows))


def xyz(a):
    return a[:, 0], a[:, 1], a[:, 2]


def sensor_logger_json(m):
    rows = [{"sensor": "Metadata", "version": "3", "device name": "phone"}]
    for n, w, a in zip(m.ns.tolist(), m.w.tolist(), m.acc.tolist()):
        for name, v in (("Accelerometer", a), ("Gyroscope", w)):
            rows.append({"sensor": name, "time": str(n), "seconds_elapsed": str((n - m.start) / 1e9),
                         **{k: str(x) for k, x in zip("zyx", v[::-1])}})
        rows.append({"sensor": "Location", "time": str(n), "latitude": "0.0"})
    return json.dumps(rows)


def sensor_logger(m):
    return "time,seconds_elapsed,z,y,x\n" + m.rows(
        "{},{:.6f},{:.7f},{:.7f},{:.7f}", m.ns, m.s, *xyz(m.w)[::-1])


def phyphox(m, delimiter=",", comma=False):
    names = ["Time (s)", *(f"Gyroscope {k} (rad/s)" for k in "xyz"), "Absolute (rad/s)"]
    form = delimiter.join(["{:.9E}"] * 5)
    body = m.rows(form, m.ns * 1e-9, *xyz(m.w), np.linalg.norm(m.w, axis=1))
    return delimiter.join(f'"{n}"' for n in names) + "\n" + (body.replace(".", ",") if comma else body)


def physics_toolbox(m):
    body = m.rows("{:.4f};{:.4f};{:.4f};{:.4f}", m.ns * 1e-9, *xyz(m.w))
    return "\ntime;wx;wy;wz\n" + body.replace(".", ",").replace("-", "−")


def shimmer(m, delimiter=","):
    names = ["Timestamp_Unix_CAL", *(f"Accel_WR_{k}_CAL" for k in "XYZ"), *(f"Gyro_{k}_CAL" for k in "XYZ")]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]
    lines = [f'"sep={delimiter}"', delimiter.join(f"Shimmer_AAAA_{n}" for n in names) + delimiter, delimiter.join(units) + delimiter]
    form = delimiter.join(["{:.6f}"] + ["{:.6f}"] * 6) + delimiter
    return head(*lines) + m.rows(form, m.ns / 1e6, *xyz(m.acc), *xyz(m.deg))


def delsys(m):
    names = []
    for sensor, unit in (("ACC", "g"), ("GYRO", "deg/s")):
        for k in "XYZ":
            names += ["X[s]", f"Avanti sensor 1: {sensor}.{k} 1 ({unit})"]
    fast = m.again(rate=2 * m.rate)
    lines = [",".join(names)]
    for k, (n, a) in enumerate(zip(fast.ns.tolist(), fast.acc.tolist())):
        row = [x for v in a for x in (f"{n * 1e-9:.7f}", f"{v / 9.81:.6f}")]
        row += [x for v in m.deg[k] for x in (f"{m.ns[k] * 1e-9:.7f}", f"{v:.6f}")] if k < len(m.ns) else [""] * 6
        lines.append(",".join(row))
    return head(*lines)


def gopro_csv(m):
    m = m.again(noise=2e-3)
    gps = [i + "Z" for i in m.iso(3)]
    # The satellites' time steps.
    return '"cts","date","Gyroscope (z) [rad/s]","Gyroscope (x) [rad/s]","Gyroscope (y) [rad/s]","temperature [°C]"\n' + m.rows(
        "{:.5f},{},{:.6f},{:.6f},{:.6f},{}", m.ns / 1e6, gps, m.w[:, 2], m.w[:, 0], m.w[:, 1], ["41.3", *[""] * (len(m.ns) - 1)])


def gcsv(m):
    lines = ["GYROFLOW IMU LOG", "version,1.3", "id,custom_logger", "orientation,YxZ", "tscale,0.000001", "gscale,0.00122173047",
             "ascale,0.00048828125", "t,gx,gy,gz,ax,ay,az"]
    counts = np.round(m.w / 0.00122173047).astype(int)
    return head(*lines) + m.rows("{},{},{},{},{},{},{}", m.ns // 1000, *xyz(counts), *xyz(np.round(m.acc * 200).astype(int)))


def arduino(m, bits=32, unit=1000, ahead=5.0, cut=True):
    """A counter that wraps after some seconds, and whose last line is cut."""
    ticks = m.ns // unit
    begin = 2**bits - int(ahead * 1e9 / unit)
    own = (ticks - ticks[0] + begin) % 2**bits
    name = {1000: "micros", 10**6: "millis", 10**5: "ticks"}[unit]
    boot = ["ets Jul 29 2019 12:21:46", "", "rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)", "MPU6050 ok, 500 dps"]
    text = head(*boot, f"{name},gx_dps,gy_dps,gz_dps") + m.rows("{},{:.3f},{:.3f},{:.3f}", own, *xyz(m.deg))
    return text[:-12].replace("\n", "\r\n") if cut else text


def reboot(m):
    half = len(m.ns) // 2
    lines = m.rows("{:.3f},{:.6f},{:.6f},{:.6f}", np.r_[m.ns[:half], m.ns[half:] - m.ns[half] + 412 * 10**6] / 1e6, *xyz(m.w)).splitlines()
    return head("t_ms,gx,gy,gz", *lines[:half], "t_ms,gx,gy,gz", *lines[half:])


def polar(m):
    arrived = [str(np.datetime64(int(n) // 10**9 * 10**9 + k % 100 * 10**6, "ns"))[:23] for k, n in enumerate(m.ns)]
    own = m.ns - 946_684_800 * 10**9
    return "Phone timestamp;sensor timestamp [ns];X [dps];Y [dps];Z [dps]\n" + m.rows("{};{};{:.6f};{:.6f};{:.6f}", arrived, own, *xyz(m.deg))


def ipin(m):
    lines = ["% LogFile created by the app", "%", "% LogFile Data format:",
             "% Accelerometer data: \t'ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2);Accuracy(integer)'",
             "% Gyroscope data:     \t'GYRO;AppTimestamp(s);SensorTimestamp(s);Gyr_X(rad/s);Gyr_Y(rad/s);Gyr_Z(rad/s);Accuracy(integer)'", "%"]
    for k, (n, w, a) in enumerate(zip((m.ns * 1e-9).tolist(), m.w.tolist(), m.acc.tolist())):
        app = f"{n + 0.03 + 0.02 * (k % 3):.3f}"
        lines.append(f"ACCE;{app};{n:.3f};{a[0]:.5f};{a[1]:.5f};{a[2]:.5f};3")
        lines.append(f"GYRO;{app};{n:.3f};{w[0]:.5f};{w[1]:.5f};{w[2]:.5f};3")
        if k % 50 == 0:
            lines += [f"PRES;{app};{n:.3f};1013.2500;0", f"WIFI;{app};{n:.3f};net;00:00:00:00:00:01;2437;-60"]
    return head(*lines)


def head_motion(m):
    m = m.again(jitter=3e-4)
    lines = ["epoch_ms,elapsed_ms,sensor,x,y,z"]
    for n, w, a in zip(m.ns.tolist(), m.deg.tolist(), m.acc.tolist()):
        begin = f"{(EPOCH + n) // 10**6},{n / 1e6:.3f}"
        lines.append(f"{begin},accel_g,{a[0] / 9.81:.4f},{a[1] / 9.81:.4f},{a[2] / 9.81:.4f}")
        lines.append(f"{begin},gyro_dps,{w[0]:.4f},{w[1]:.4f},{w[2]:.4f}")
    return head(*lines)


def ros2_echo(m):
    zeros = ",".join(["0.0"] * 9)
    return m.rows("{},{},imu_link,0.0,0.0,0.0,1.0," + zeros + ",{},{},{}," + zeros + ",{},{},{}," + zeros,
                  m.ns // 10**9, m.ns % 10**9, *xyz(m.w), *xyz(m.acc))


def motive(m, rotation="Quaternion"):
    m = m.again(rate=120.0)
    q = m.q[:, [1, 2, 3, 0]] if rotation == "Quaternion" else Rotation.from_quat(m.q[:, [1, 2, 3, 0]]).as_euler(rotation, degrees=True)
    width = q.shape[1] + 4
    ids = ",".join(['"0000000000000000"'] * width)
    kinds = ",".join(["Rotation"] * q.shape[1] + ["Position"] * 3 + ["Mean Marker Error"])
    lines = [f"Format Version,1.23,Take Name,Take 001,Take Notes,,Capture Frame Rate,120.000000,Export Frame Rate,120.000000,Capture Start Time,"
             f"2026-03-08 10.00.00.000 AM,Capture Start Frame,0,Total Frames in Take,{len(q)},Total Exported Frames,{len(q)},Rotation Type,"
             f"{rotation},Length Units,Meters,Coordinate Space,Global", "", ",Type" + ",Rigid Body" * width, ",Name" + ",rig" * width, ",ID," + ids,
             ",," + kinds, "Frame,Time (Seconds)," + ("X,Y,Z,W" if rotation == "Quaternion" else "X,Y,Z") + ",X,Y,Z,"]
    for k, (n, o) in enumerate(zip(m.ns.tolist(), q.tolist())):
        # The body leaves the view for 21 frames, and its markers are taken for others for one.
        o = [] if 700 <= k < 721 else [-x for x in o] if k == 300 and rotation == "Quaternion" else o
        lines.append(f"{k},{n * 1e-9:.6f}," + (",".join(f"{x:.6f}" for x in o) + ",0.1,0.2,1.1,0.0003" if o else "," * (width - 1)))
    return head(*lines)


def stray_poses(m):
    m = m.again(rate=60.0)
    return "timestamp, frame, x, y, z, qx, qy, qz, qw\n" + m.rows(
        "{:.9f}, {:06d}, {:.7f}, {:.7f}, {:.7f}, {:.8f}, {:.8f}, {:.8f}, {:.8f}", m.ns * 1e-9, np.arange(len(m.ns)),
        *xyz(np.cumsum(m.acc, axis=0) * 1e-3), *m.q[:, [1, 2, 3, 0]].T)


def stray_imu(m):
    return "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n" + m.rows(
        "{:.9f}, {:.8f}, {:.8f}, {:.8f}, {:.8f}, {:.8f}, {:.8f}", m.ns * 1e-9, *xyz(m.acc / 9.81), *xyz(m.w))


def realsense(m):
    lines = ["Configuration:", "Stream Type,Stream Name,Format,FPS,Width,Height", "Gyro,Gyro,MOTION_XYZ32F,400", "Accel,Accel,MOTION_XYZ32F,63", "", ""]
    for word, values in (("Gyro", m.w), ("Accel", m.acc)):
        lines += ["Stream Type,Index,F#,HW Timestamp (ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z", ""]
        lines += [f"{word},0,{k + 1},{n / 1e6:.3f},{4 + (k % 7) + (n - m.start) / 1e6:.3f},{v[0]:.3f},{v[1]:.3f},{v[2]:.3f}"
                  for k, (n, v) in enumerate(zip(m.ns.tolist(), values.tolist()))]
        lines += ["", ""]
    return head(*lines)


def mcap_json(m):
    from mcap.writer import Writer

    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    schema = writer.register_schema("sensor_msgs/msg/Imu", "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/imu", "json", schema)
    for n, w, a in zip(m.ns.tolist(), m.w.tolist(), m.acc.tolist()):
        one = {"header": {"stamp": {"sec": n // 10**9, "nsec": n % 10**9}, "frame_id": "imu"},
               "angular_velocity": dict(zip("xyz", w)), "linear_acceleration": dict(zip("xyz", a))}
        writer.add_message(channel, n + 3_000_000, json.dumps(one).encode(), n + 3_000_000)
    writer.finish()
    return out.getvalue()


def mcap_protobuf(m):
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap_protobuf.writer import Writer

    own = descriptor_pb2.FileDescriptorProto(name="imu.proto", package="rig", syntax="proto3", dependency=["google/protobuf/timestamp.proto"])
    vector = own.message_type.add(name="Vector")
    for k, axis in enumerate("xyz", 1):
        vector.field.add(name=axis, number=k, type=1, label=1)
    imu = own.message_type.add(name="Imu")
    imu.field.add(name="timestamp", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp")
    imu.field.add(name="angular_velocity", number=2, type=11, label=1, type_name=".rig.Vector")
    imu.field.add(name="linear_acceleration", number=3, type=11, label=1, type_name=".rig.Vector")
    pool = descriptor_pool.DescriptorPool()
    stamps = descriptor_pb2.FileDescriptorProto()
    Timestamp.DESCRIPTOR.file.CopyToProto(stamps)
    pool.Add(stamps)
    pool.Add(own)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("rig.Imu"))
    out = io.BytesIO()
    with Writer(out) as writer:
        for n, w, a in zip(m.ns.tolist(), m.w.tolist(), m.acc.tolist()):
            one = kind()
            one.timestamp.seconds, one.timestamp.nanos = divmod(n, 10**9)
            for name, values in (("angular_velocity", w), ("linear_acceleration", a)):
                for axis, value in zip("xyz", values):
                    setattr(getattr(one, name), axis, value)
            writer.write_message("/imu", one, n + 10**6, n + 10**6)
    return out.getvalue()


def spreadsheet(m):
    lines = ["Time,Accel-X (g),Accel-Y (g),Accel-Z (g),Gyro-X (d/s),Gyro-Y (d/s),Gyro-Z (d/s)"]
    for n, a, w in zip(m.ns.tolist(), (m.acc / 9.81).tolist(), m.deg.tolist()):
        lines.append(f"{n // 60_000_000_000 % 60:02}:{n % 60_000_000_000 / 1e9:04.1f}," + ",".join(f"{x:.6f}" for x in (*a, *w)))
    return head(*lines)


def klv(key, kind, size, repeat, body):
    return struct.pack(">4scBH", key, kind, size, repeat) + body + bytes(-len(body) % 4)


def gpmf(m, stamps=True):
    out, per = b"", 198
    for first in range(0, len(m.ns) - per + 1, per):
        counts = np.round(m.w[first : first + per][:, [2, 0, 1]] * 939).astype(">i2").tobytes()
        parts = klv(b"TSMP", b"L", 4, 1, struct.pack(">L", first + per)) + klv(b"STNM", b"c", 1, 17, b"Gyroscope (z,x,y)")
        parts += klv(b"SIUN", b"c", 5, 1, b"rad/s") + klv(b"SCAL", b"s", 2, 1, struct.pack(">h", 939)) + klv(b"GYRO", b"s", 6, per, counts)
        if stamps:
            parts = klv(b"STMP", b"J", 8, 1, struct.pack(">Q", m.ns[first] // 1000)) + parts
        stream = klv(b"STRM", b"\0", 1, len(parts), parts)
        inside = klv(b"DVID", b"L", 4, 1, struct.pack(">L", 1)) + klv(b"DVNM", b"c", 1, 6, b"Camera") + stream
        out += klv(b"DEVC", b"\0", 1, len(inside), inside)
    return out


def apdm(m):
    lines = ["Test Name:,Trial,,,,,", f"Sample Rate:,{m.rate:g},Hz,,,,", "Time," + ",".join(f"{s}/Angular Velocity/{k}" for s in ("Upper", "Lower") for k in "XYZ"),
             "s" + ",rad/s" * 6]
    return head(*lines) + m.rows("{:.3f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f}", m.ns * 1e-9, *xyz(m.w), *xyz(-m.w))


def mt_manager(m, empty=""):
    lines = ["// Start Time: Unknown", f"// Update Rate: {m.rate:.1f}Hz", "// Filter Profile: human (46.1)",
             "PacketCounter\tSampleTimeFine\tYear\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"]
    counter = (np.arange(len(m.ns)) + 65000) % 65536
    return head(*lines) + m.rows("{:05d}\t" + empty + "\t" + empty + "\t{:.4f}\t{:.4f}\t{:.4f}\t{:.6f}\t{:.6f}\t{:.6f}", counter, *xyz(m.acc), *xyz(m.w))


def dot(m):
    lines = ["DeviceTag:,Xsens DOT", "FirmwareVersion:,2.0.0", "SyncStatus:,Synced", f"OutputRate:,{m.rate:g}Hz", "",
             "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"]
    return head(*lines) + m.rows("{},{},0,0,0,{:.4f},{:.4f},{:.4f},{:.4f},{:.4f},{:.4f}", np.arange(len(m.ns)), m.ns // 1000, *xyz(m.acc), *xyz(m.deg))


def picoquake(m):
    lines = ["# PLab PicoQuake Data", "# Time: 2024-04-21 15:54:46.333682, Device: D4E9 (E6632891E36F2029)", "# Num. samples: 10000, Duration: 5.0 s",
             f"# Config: data_rate = {m.rate} Hz, filter = 488 Hz, acc_range = 4 g, gyro_range = 250.0 dps", "# Integrity: True, Skipped samples: 0",
             "count,a_x,a_y,a_z,g_x,g_y,g_z"]
    return head(*lines) + m.rows("{},{:.4f},{:.4f},{:.4f},{:.4f},{:.4f},{:.4f}", np.arange(1, len(m.ns) + 1), *xyz(m.acc / 9.81), *xyz(m.deg))


def qualisys(m):
    lines = [f"NO_OF_FRAMES\t{len(m.ns)}", "NO_OF_CAMERAS\t4", "NO_OF_BODIES\t1", f"FREQUENCY\t{m.rate:g}", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--",
             "TIME_STAMP\t2020-01-22, 17:47:17\t22107.99179716", "DATA_INCLUDED\t6D", "BODY_NAMES\tPSVH",
             "\t".join(["Frame", "Time", "PSVH X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))])]
    columns = m.matrix.reshape(-1, 3, 3).transpose(0, 2, 1).reshape(-1, 9)
    return head(*lines) + m.rows("\t".join(["{}", "{:.5f}", *["{:.5f}"] * 16]), np.arange(len(m.ns)), m.ns * 1e-9, *xyz(m.acc), *xyz(m.acc), m.s * 0, *columns.T)


def xlsx(m):
    from openpyxl import Workbook

    book = Workbook()
    book.active.title = "About"
    book.active.append(["Experiment", "Gyroscope"])
    sheet = book.create_sheet("Raw Data")
    sheet.append(["Time (s)", *(f"Gyroscope {k} (rad/s)" for k in "xyz")])
    for n, w in zip((m.ns * 1e-9).tolist(), m.w.tolist()):
        sheet.append([n, *w])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def npy(m, names=True):
    out = io.BytesIO()
    if names:
        kind = [("t", "f8"), *((f"gyro_{k}", "f4") for k in "xyz")]
        np.save(out, np.array([(n * 1e-9, *w) for n, w in zip(m.ns.tolist(), m.w.tolist())], dtype=kind))
    else:
        np.save(out, np.column_stack([m.ns * 1e-9, m.w]))
    return out.getvalue()


def npz(m, quaternion=False):
    out = io.BytesIO()
    if quaternion:
        np.savez(out, timestamps=m.ns * 1e-9, rotations=m.matrix.reshape(-1, 3, 3))
    else:
        np.savez(out, time=m.ns, gyro=m.w, acc=m.acc)
    return out.getvalue()


def mat(m):
    from scipy.io import savemat

    out = io.BytesIO()
    savemat(out, {"imu": {"t": m.ns * 1e-9, "gyr": m.w.T, "acc": m.acc.T}, "note": "of a lab"})
    return out.getvalue()


def ulg(m, topic="sensor_combined"):
    """By <https://docs.px4.io/main/en/dev_log/ulog_file_format>, of messages as in
    <https://github.com/PX4/PX4-Autopilot/tree/main/msg>."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    columns = {
        "sensor_combined": b"float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2;",
        "sensor_gyro": b"uint32_t device_id;float x;float y;float z;float temperature;uint32_t error_count;",
    }
    out += message("F", topic.encode() + b":uint64_t timestamp;" + columns[topic])
    out += message("A", struct.pack("<BH", 0, 0) + topic.encode())
    for n, w, a in zip(m.ns.tolist(), m.w.tolist(), m.acc.tolist()):
        if topic == "sensor_gyro":
            sample = struct.pack("<HQI4fI", 0, n // 1000, 2490378, *w, 31.5, 0)
        else:
            sample = struct.pack("<HQfffIfff", 0, n // 1000, *w, 5000, *a)
        out += message("D", sample)
    return out


def ardupilot(m):
    """By libraries/AP_Logger/LogStructure.h of <https://github.com/ArduPilot/ardupilot>."""

    def formatted(number, size, name, form, columns):
        return struct.pack("<3B2B4s16s64s", 0xA3, 0x95, 128, number, size, name, form, columns)

    out = formatted(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    out += formatted(130, 3 + 8 + 1 + 24, b"IMU", b"QBffffff", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for n, w, a in zip(m.ns.tolist(), m.w.tolist(), m.acc.tolist()):
        for instance in (0, 1) if m.seed == 77 else (0,):
            out += struct.pack("<3BQB6f", 0xA3, 0x95, 130, n // 1000, instance, *w, *a)
    return out


def zipped(**files):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


def app_zip(m):
    return zipped(**{"Gyroscope.csv": sensor_logger(m), "Accelerometer.csv": sensor_logger(m.again(seed=9)), "Metadata.csv": "a,b\n1,2\n"})


def gopro_json(m):
    samples = [{"value": [w[2], w[0], w[1]], "cts": n / 1e6, "date": i + "Z"} for n, w, i in zip(m.ns.tolist(), m.w.tolist(), m.iso(3))]
    acc = [{"value": [a[2], a[0], a[1]], "cts": n / 1e6} for n, a in zip(m.ns.tolist(), m.acc.tolist())]
    streams = {"ACCL": {"samples": acc, "name": "Accelerometer (z,x,y)", "units": "m/s2"}, "GYRO": {"samples": samples, "name": "Gyroscope (z,x,y)", "units": "rad/s"}}
    return json.dumps({"1": {"streams": streams, "device name": "Hero7 Black"}, "frames/second": 59.94})


def json_lines(m):
    rows = [{"header": {"stamp": {"secs": n // 10**9, "nsecs": n % 10**9}}, "angular_velocity": dict(zip("xyz", w)), "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
            for n, w in zip(m.ns.tolist(), m.w.tolist())]
    return "".join(json.dumps(row) + "\n" for row in rows)


def windows_orientation(m):
    rows = [{"quaternion": dict(zip("wxyz", q)), "rotationMatrix": {f"m{k // 3 + 1}{k % 3 + 1}": v for k, v in enumerate(r)}, "timestamp": i + "Z"}
            for q, r, i in zip(m.q.tolist(), m.matrix.tolist(), m.iso(9))]
    return json.dumps(rows)


def json_columns(m):
    return json.dumps({"device": "x", "gyroscope": {"t_us": (m.ns // 1000).tolist(), "x": m.w[:, 0].tolist(), "y": m.w[:, 1].tolist(), "z": m.w[:, 2].tolist()}})


def sensors_by_number(m, ids=("4", "1")):
    """Rows of two bodies, which a number distinguishes."""
    rows = []
    for n, w in zip(m.ns.tolist(), m.w.tolist()):
        rows += [f"{n // 1000},1,{w[0]:.5f},{w[1]:.5f},{w[2]:.5f}", f"{n // 1000},2,{-w[1]:.5f},{w[0]:.5f},{w[2]:.5f}"]
    return head("timestamp_us,sensor_id,gx_rad_s,gy_rad_s,gz_rad_s", *rows)


def mavlink(m):
    return "timestamp,mavlink_raw_imu_t.xgyro [mrad/s],mavlink_raw_imu_t.ygyro [mrad/s],mavlink_raw_imu_t.zgyro [mrad/s]\n" + m.rows(
        "{},{:.0f},{:.0f},{:.0f}", [i.replace("T", " ") for i in m.iso(6)], *xyz(m.w * 1e3))


def two_bodies(m):
    lines = ["Format Version,1.25,Take Name,T,Rotation Type,Quaternion,Length Units,Millimeters", "", ",Type" + ",Rigid Body" * 16,
             ",Name" + ",left" * 8 + ",right" * 8, ",ID" + ',"AB12"' * 8 + ',"CD34"' * 8, ",Parent" + "," * 16,
             ",," + ",".join((["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]) * 2), "Frame,Time (Seconds)" + ",X,Y,Z,W,X,Y,Z," * 2]
    body = [*m.q[:, [1, 2, 3, 0]].T, *xyz(m.acc), m.s * 0]
    other = [*m.q[:, [2, 3, 1, 0]].T, *xyz(m.acc), m.s * 0]
    return head(*lines) + table("", np.arange(len(m.s)), m.ns * 1e-9, *body, *other)


def faulty_cells(m):
    """Errors of a spreadsheet and of C in the middle, and a row of words."""
    lines = table("t (s),gx (deg/s),gy (deg/s),gz (deg/s)", m.ns * 1e-9, *xyz(m.deg)).splitlines()
    return head(*lines[:300], "8.5401,-1.#IND,1.#QNAN,nan(ind)", "8.5402,#VALUE!,#DIV/0!,1.0", "sensor,lost,lost,lost", *lines[300:])


def labels(m):
    return head(*(f"t:{n // 1000},gx:{w[0]:.4f},gy:{w[1]:.4f},gz:{w[2]:.4f}" for n, w in zip(m.ns.tolist(), m.deg.tolist())))


def echoed(m):
    return "".join(f"header: \n  seq: {k}\n  stamp: \n    secs: {n // 10**9}\n    nsecs: {n % 10**9}\n  frame_id: \"imu\"\norientation: \n  x: 0.0\n  y: 0.0\n"
                   f"  z: 0.0\n  w: 1.0\norientation_covariance: [0.0, 0.0, 0.0]\nangular_velocity: \n  x: {w[0]}\n  y: {w[1]}\n  z: {w[2]}\n---\n"
                   for k, (n, w) in enumerate(zip(m.ns.tolist(), m.w.tolist())))


def edge_impulse(m):
    sensors = [{"name": f"{s}{k}", "units": u} for s, u in (("acc", "m/s2"), ("gyr", "d/s")) for k in "XYZ"]
    payload = {"device_type": "X", "interval_ms": 5, "sensors": sensors, "values": np.column_stack([m.acc, m.deg]).tolist()}
    return json.dumps({"protected": {"ver": "v1", "alg": "none"}, "signature": "0", "payload": payload})


def windows_text(m):
    return ("﻿" + phyphox(m, "\t")).encode("utf-16")


@dataclass
class Layout:
    kind: str
    name: str
    source: str
    make: object
    said: str = ""
    suffix: str = ".csv"
    start: int = 7 * 10**9
    topic: str = ""
    options: dict = field(default_factory=dict)
    #: Of the largest difference of rates, rad/s.
    off: float = 0.02
    #: Times from the first sample instead of those of a clock.
    counted: bool = False


_ROS = EPOCH
LAYOUTS = [
    Layout("numbers", "phyphox, semicolons and commas", "https://phyphox.org/wiki: the export dialog's five CSV forms", lambda m: phyphox(m, ";", True), "decimal commas"),
    Layout("numbers", "phyphox, tabs and commas", "https://phyphox.org/wiki: the export dialog's five CSV forms", lambda m: phyphox(m, "\t", True), "decimal commas"),
    Layout("numbers", "phyphox, tabs", "https://phyphox.org/wiki: the export dialog's five CSV forms", lambda m: phyphox(m, "\t"), "tabs"),
    Layout("numbers", "phyphox, commas", "https://phyphox.org/wiki: the export dialog's five CSV forms", phyphox, "in rad/s (named)"),
    Layout("numbers", "Physics Toolbox, U+2212", "github.com/openbci/OpenBCI_Processing#49 (locale)", physics_toolbox, "Physics Toolbox"),
    Layout("numbers", "quoted decimal commas", "RFC 4180 with a German locale", lambda m: '"t (s)","gyro x (deg/s)","gyro y (deg/s)","gyro z (deg/s)"\n'
           + m.rows('"{:.6f}","{:.4f}","{:.4f}","{:.4f}"', m.ns * 1e-9, *xyz(m.deg)).replace(".", ","), "decimal commas"),
    Layout("numbers", "thousands in times", "Excel's number format #,##0", lambda m: "time (us);gx (rad/s);gy (rad/s);gz (rad/s)\n" + m.rows("{:,};{:.5f};{:.5f};{:.5f}", m.ns // 1000, *xyz(m.w))),
    Layout("numbers", "UTF-16 of Windows", "PowerShell's > before version 6", windows_text, "tabs"),
    Layout("headers", "AndroSensor", "play.google.com AndroSensor, as quoted by github.com/AdrianEddy/telemetry-parser", lambda m: "sep=;\n" + ";".join(
        [f"{s} {k} ({u})" for s, u in (("ACCELEROMETER", "m/s²"), ("GYROSCOPE", "rad/s")) for k in "XYZ"] + ["Time since start in ms "]) + "\n"
        + m.rows("{:.4f};{:.4f};{:.4f};{:.6f};{:.6f};{:.6f};{:.3f}", *xyz(m.acc), *xyz(m.w), m.ns / 1e6), "in ms (named)"),
    Layout("headers", "Shimmer, commas", "github.com/ShimmerResearch/ShimmerAndroidAPI#18", shimmer, "in deg/s (named)", start=_ROS),
    Layout("headers", "Shimmer, tabs", "github.com/bachlab/PsPM#109", lambda m: shimmer(m, "\t"), "in deg/s (named)", start=_ROS),
    Layout("headers", "APDM, names over units", "support.apdm.com: CSV export of Mobility Lab", apdm, "Upper", topic="upper"),
    Layout("headers", "EuRoC", "github.com/ethz-asl/kalibr/wiki/bag-format", lambda m: "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
        + m.rows("{},{},{},{},{},{},{}", m.ns, *xyz(m.w), *xyz(m.acc)), "in ns (named)", start=_ROS),
    Layout("headers", "names in a comment", "github.com/chenxiao86/TUM-RGBD-GT2IMU trajWrite.m", lambda m: "# timestamp wx wy wz ax ay az \n"
        + m.rows("{:.6f} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f}", m.ns * 1e-9, *xyz(m.w), *xyz(m.acc)), "white space"),
    Layout("headers", "Delsys, a time for each channel", "github.com/opensim-org/opensim-core#3264", delsys, "GYRO.X"),
    Layout("headers", "GoPro telemetry CSV", "github.com/JuanIrache/gopro-telemetry: toCsv", gopro_csv, "'cts' in ms"),
    Layout("headers", "SensorLog of iOS", "sensorlog.berndthomas.net, columns as in public loaders", lambda m: "loggingTime(txt),accelerometerAccelerationX(G),accelerometerAccelerationY(G),accelerometerAccelerationZ(G),"
        "gyroTimestamp_sinceReboot(s),gyroRotationX(rad/s),gyroRotationY(rad/s),gyroRotationZ(rad/s),motionRotationRateX(rad/s),motionRotationRateY(rad/s),motionRotationRateZ(rad/s)\n"
        + m.rows("{},0.1,0.2,1.0,{:.6f},{:.6f},{:.6f},{:.6f},{:.6f},{:.6f},{:.6f}", m.iso(3), m.ns * 1e-9, *xyz(m.w), *xyz(m.w - 0.01)), "sinceReboot"),
    Layout("headers", "IMU logger of x-io", "x-io.co.uk NGIMU, sensors.csv", lambda m: "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n"
        + m.rows("{:.6f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f}", m.ns * 1e-9, *xyz(m.deg), *xyz(m.acc / 9.81)), "'Gyroscope X (deg/s)'"),
    Layout("headers", "spanned names", "a spreadsheet's merged cells, saved as CSV", lambda m: "Time (s),Gyroscope,,,Accelerometer,,\n,x (deg/s),y (deg/s),z (deg/s),x (g),y (g),z (g)\n"
        + m.rows("{:.6f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f}", m.ns * 1e-9, *xyz(m.deg), *xyz(m.acc / 9.81)), "Gyroscope x (deg/s)"),
    Layout("headers", "WitMotion", "github.com/AdrianEddy/telemetry-parser src/witmotion/txt.rs", lambda m: "Time(s)\tChipTime\tax(g)\tay(g)\taz(g)\twx(deg/s)\twy(deg/s)\twz(deg/s)\tAngleX(deg)\tAngleY(deg)\tAngleZ(deg)\n"
        + m.rows("{:.3f}\t{}\t{:.4f}\t{:.4f}\t{:.4f}\t{:.4f}\t{:.4f}\t{:.4f}\t0.0\t0.0\t0.0", m.ns * 1e-9, m.iso(3), *xyz(m.acc / 9.81), *xyz(m.deg)), "'wx(deg/s)'", ".txt"),
    Layout("time", "Polar, the sensor's ns", "github.com/polarofficial/polar-ble-sdk#674", polar, "'sensor timestamp [ns]'", ".txt", start=EPOCH),
    Layout("time", "MetaWear", "github.com/mbientlab MetaBase: epoch (ms),time,elapsed (s),x-axis (deg/s)", lambda m: "epoch (ms),time (01:00),elapsed (s),x-axis (deg/s),y-axis (deg/s),z-axis (deg/s)\n"
        + m.rows("{},{},{:.3f},{:.3f},{:.3f},{:.3f}", m.ns // 10**6, [i.replace(":", "-") for i in m.iso(3)], m.s, *xyz(m.deg)), "'epoch (ms)'", start=EPOCH),
    Layout("time", "rostopic echo -p", "wiki.ros.org/rostopic: -p", lambda m: "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.orientation.x,field.orientation.y,field.orientation.z,field.orientation.w,"
        "field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z\n"
        + m.rows("{},1,{},imu,0,0,0,1,{},{},{},{},{},{}", m.ns + np.arange(len(m.ns)) % 7 * 10**6, m.ns, *xyz(m.w), *xyz(m.acc)), "header.stamp", start=_ROS),
    Layout("time", "bagpy, seconds and nanoseconds", "github.com/jmscslgroup/bagpy message_by_topic", lambda m: "Time,header.seq,header.stamp.secs,header.stamp.nsecs,angular_velocity.x,angular_velocity.y,angular_velocity.z\n"
        + m.rows("{},0,{},{},{},{},{}", m.ns * 1e-9 + 0.01, m.ns // 10**9, m.ns % 10**9, *xyz(m.w)), "header.stamp.secs", start=_ROS),
    Layout("time", "ROS columns of a data set", "huggingface.co/datasets/humanoidVik/rosbag-resurrector-demo", lambda m: "timestamp_ns,header.stamp_sec,header.stamp_nsec,orientation.x,orientation.y,orientation.z,orientation.w,"
        "angular_velocity.x,angular_velocity.y,angular_velocity.z\n" + m.rows("{},{},{},0,0,0,1,{},{},{}", m.ns + 4_000_000, m.ns // 10**9, m.ns % 10**9, *xyz(m.w)), "stamp_nsec", start=_ROS),
    Layout("time", "ros2 topic echo --csv", "github.com/ros2/rosidl_runtime_py convert.py", ros2_echo, "rad/s (named)", start=_ROS),
    Layout("time", "micros of 32 bits", "github.com/NVlabs/FPSci#318", arduino, "wraps at 4294967296", ".txt", counted=True),
    Layout("time", "millis of 16 bits", "a uint16_t of millis()", lambda m: arduino(m, 16, 10**6, cut=False), "wraps at 65536", counted=True, off=0.05),
    Layout("time", "ticks of 24 bits", "a counter of 0.1 ms in three bytes, its rate in the header", lambda m: f"# Sample Rate: {m.rate:g} Hz\n"
        + arduino(m, 24, 10**5, cut=False).split("\n", 4)[4], "wraps at 16777216", counted=True),
    Layout("time", "MT Manager, a counter and a rate", "base.xsens.com: MT Manager's text export", mt_manager, "PacketCounter", ".txt", counted=True),
    Layout("time", "MT Manager with NaN", "base.xsens.com: MT Manager 2022, SampleTimeFine NaN", lambda m: mt_manager(m, "NaN"), "as MT Manager", ".txt", counted=True),
    Layout("time", "Xsens DOT", "github.com/ansfl/Quadrotor-Dead-Reckoning-with-Multiple-Inertial-Sensors", dot, "as Xsens DOT"),
    Layout("time", "PicoQuake", "github.com/PLab-SI/PicoQuake docs/acquisition_data.md", picoquake, "stated in the file", counted=True),
    Layout("time", "no time at all, --rate", "arrays of numbers: the commonest of public recordings", lambda m: "gyro_x,gyro_y,gyro_z\n" + m.rows("{:.6f},{:.6f},{:.6f}", *xyz(m.w)), "at 200 Hz (given)",
           options={"rate": 200.0}, counted=True),
    Layout("time", "ISO", "github.com/kazumakano/pdr.py log/README.md", lambda m: "timestamp,gyro_x,gyro_y,gyro_z\n" + m.rows("{},{},{},{}", [i.replace("T", " ") for i in m.iso(6)], *xyz(m.w)), "dates", start=_ROS),
    Layout("time", "HH:MM:SS:mmm", "Physics Toolbox and others with a colon before the milliseconds", lambda m: "time;gyro x (rad/s);gyro y (rad/s);gyro z (rad/s)\n" + m.rows(
        "{};{:.6f};{:.6f};{:.6f}", [i[11:19] + ":" + i[20:23] for i in m.iso(3)], *xyz(m.w)), "times of day", start=3600 * 10**9),
    Layout("time", "date and time, month first", "OpenLog Artemis: rtcDate, rtcTime of sparkfun/OpenLog_Artemis", lambda m: "rtcDate,rtcTime,aX,aY,aZ,gX,gY,gZ,imu_degC\n" + m.rows(
        "{},{},{:.2f},{:.2f},{:.2f},{:.2f},{:.2f},{:.2f},31.0", ["03/08/2026"] * len(m.ns), [i[11:23] for i in m.iso(3)], *xyz(m.acc * 100), *xyz(m.deg)), "rtcTime", start=3600 * 10**9),
    Layout("rows", "IPIN's log, a row a sensor", "gitlab.com/getsensordatasuite: GetSensorData", ipin, "GYRO", ".txt"),
    Layout("rows", "a word in a column", "HeadMotion: epoch_ms,elapsed_ms,sensor,x,y,z", head_motion, "gyro_dps"),
    Layout("rows", "RealSense, two tables", "github.com/realsenseai/librealsense tools/data-collect", realsense, "Gyro", start=1_607_580_000 * 10**9),
    Layout("rows", "a number in a column", "loggers with several IMUs on one bus", sensors_by_number, "1,", topic="1"),
    Layout("rows", "cells missing", "telemetry-parser's and other joined tables: rows of the slower sensor are empty", lambda m: "time (s),gx (rad/s),gy (rad/s),gz (rad/s),lat\n"
        + "".join(f"{n * 1e-9:.6f},{w[0]:.6f},{w[1]:.6f},{w[2]:.6f},\n{n * 1e-9 + 1e-3:.6f},,,,47.0\n" for n, w in zip(m.ns.tolist(), m.w.tolist())), "named"),
    Layout("rates", "Stray Scanner, alpha", "github.com/strayrobots/scanner IMUEncoder.swift", stray_imu, "as Stray Scanner"),
    Layout("rates", "gcsv, counts with a scale", "docs.gyroflow.xyz/app/technical-details/gcsv-format", gcsv, "0.00122173 rad/s", ".gcsv"),
    Layout("rates", "MAVLink's RAW_IMU", "github.com/ArduPilot/MissionPlanner: tlog to CSV", mavlink, "mrad/s", start=_ROS),
    Layout("rates", "Unitree, rates beside quaternions", "a public UnitreeLowStateIMULogger", lambda m: "timestamp,quat_w,quat_x,quat_y,quat_z,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n"
        + m.rows(",".join(["{:.6f}"] * 11), m.ns * 1e-9, *m.q.T, *xyz(m.w), *xyz(m.acc)), "'gyro_x'"),
    Layout("rates", "PX4's ulog2csv", "github.com/PX4/pyulog ulog2csv", lambda m: "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]\n"
        + m.rows("{},{},{},{},2000,{},{},{}", m.ns // 1000, *xyz(m.w), *xyz(m.acc)), "'gyro_rad[0]'"),
    Layout("rates", "Betaflight's blackbox_decode", "github.com/betaflight/blackbox-tools", lambda m: "loopIteration,time (us),accSmooth[0],accSmooth[1],accSmooth[2],gyroADC[0],gyroADC[1],gyroADC[2]\n"
        + m.rows("{},{},{:.0f},{:.0f},{:.0f},{:.4f},{:.4f},{:.4f}", np.arange(len(m.ns)), m.ns // 1000, *xyz(m.acc * 208), *xyz(m.deg)), "Betaflight"),
    Layout("rates", "slow, deg/s by gravity", "loggers that name gx, gy, gz and no unit", lambda m: "time_s,ax,ay,az,gx,gy,gz\n"
        + m.rows("{:.5f},{:.4f},{:.4f},{:.4f},{:.5f},{:.5f},{:.5f}", m.ns * 1e-9, *xyz(m.acc), *xyz(m.deg * 0 + np.degrees(m.w))), "gravity"),
    Layout("rates", "counts, their size given", "MPU-6050's registers at 500 dps: 65.5 LSB", lambda m: "time_ms,gx,gy,gz\n" + m.rows("{:.2f},{:.0f},{:.0f},{:.0f}", m.ns / 1e6, *xyz(m.deg * 65.5)), "0.0152672 deg/s",
           options={"unit": "0.01526717557deg/s"}),
    Layout("orientations", "Motive, quaternions", "docs.optitrack.com/motive/data-export/data-export-csv", motive, "quaternions", off=0.06),
    Layout("orientations", "Motive, Euler angles", "docs.optitrack.com/motive/data-export/data-export-csv: Rotation Type", lambda m: motive(m, "XYZ"), "turned about XYZ", off=0.06),
    Layout("orientations", "Qualisys, rotation matrices", "github.com/shiplab/dt_cv data/basin/raw (QTM's 6D TSV)", qualisys, "rotation matrices", ".tsv", off=0.3),
    Layout("orientations", "Stray Scanner, poses", "github.com/strayrobots/scanner OdometryEncoder.swift", stray_poses, "quaternions", off=0.06),
    Layout("orientations", "TUM", "cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats", lambda m: "# timestamp tx ty tz qx qy qz qw\n" + m.rows(" ".join(["{:.9f}"] * 8), m.ns * 1e-9, *xyz(m.acc), *m.q[:, [1, 2, 3, 0]].T),
           "quaternions", ".txt", off=0.06),
    Layout("orientations", "TUM without names", "cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats", lambda m: m.rows(" ".join(["{:.9f}"] * 8), m.ns * 1e-9, *xyz(m.acc), *m.q[:, [1, 2, 3, 0]].T), "quaternions", ".txt", off=0.06),
    Layout("orientations", "ARKit Data Logger", "github.com/PyojinKim/ARKit-Data-Logger README", lambda m: m.rows("{} " + " ".join(["{:.8f}"] * 12), m.ns,
           *[c for r in range(3) for c in (*m.matrix[:, 3 * r : 3 * r + 3].T, m.acc[:, r])]), "rotation matrices", ".txt", off=0.06),
    Layout("orientations", "EuRoC's ground truth", "projects.asl.ethz.ch/datasets: state_groundtruth_estimate0", lambda m: "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [],"
        " v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1]\n"
        + m.rows("{}," + ",".join(["{:.7f}"] * 13), m.ns, *xyz(m.acc), *m.q.T, *xyz(m.acc), *xyz(m.w * 0 + 0.01)), "quaternions", start=_ROS, off=0.06),
    Layout("orientations", "KITTI's odometry, --rate", "cvlibs.net/datasets/kitti/eval_odometry.php", lambda m: m.rows(" ".join(["{:.9e}"] * 12),
           *[c for r in range(3) for c in (*m.matrix[:, 3 * r : 3 * r + 3].T, m.acc[:, r])]), "rotation matrices", ".txt", off=0.06, options={"rate": 200.0}, counted=True),
    Layout("orientations", "quaternions of an app", "quaternion columns W, X, Y, Z without another word", lambda m: "Time (s),W,X,Y,Z\n" + m.rows(",".join(["{:.7f}"] * 5), m.ns * 1e-9, *m.q.T), "quaternions", off=0.06),
    Layout("orientations", "orientations of Windows", "JSON schema of Windows' OrientationReading", windows_orientation, "quaternions", ".json", start=_ROS, off=0.06),
    Layout("containers", "Sensor Logger JSON", "github.com/tszheichoi/awesome-sensor-logger README", sensor_logger_json, "JSON: Gyroscope", ".json", start=EPOCH),
    Layout("containers", "Sensor Logger JSON, packed", "github.com/tszheichoi/awesome-sensor-logger README", lambda m: gzip.compress(sensor_logger_json(m).encode()), "JSON: Gyroscope", ".json.gz", start=EPOCH),
    Layout("containers", "an app's zip", "github.com/tszheichoi/awesome-sensor-logger README", app_zip, "as Sensor Logger", ".zip", start=EPOCH),
    Layout("containers", "GoPro telemetry JSON", "github.com/JuanIrache/gopro-telemetry", gopro_json, "Gyroscope", ".json"),
    Layout("containers", "JSON lines of ROS", "wiki.ros.org rosbridge: messages as JSON", json_lines, "JSON lines", ".jsonl", start=_ROS),
    Layout("containers", "JSON of columns", "phone loggers that keep arrays", json_columns, "JSON", ".json"),
    Layout("containers", "MCAP of JSON", "mcap.dev/spec: jsonschema", mcap_json, "MCAP of json", ".mcap", start=_ROS),
    Layout("containers", "MCAP of protobuf", "mcap.dev/spec: protobuf", mcap_protobuf, "MCAP of protobuf", ".mcap", start=_ROS),
    Layout("containers", "GPMF without its video", "github.com/gopro/gpmf-parser README", gpmf, "GPMF", ".bin", start=550 * 10**6),
    Layout("containers", "numpy's records", "numpy.org/doc: structured arrays", npy, "npy", ".npy"),
    Layout("containers", "numpy's matrix", "numpy.org/doc: numpy.save", lambda m: npy(m, False), "npy", ".npy"),
    Layout("containers", "numpy's arrays", "numpy.org/doc: numpy.savez", npz, "npz", ".npz"),
    Layout("containers", "rotations in numpy", "poses of public SLAM code, (n, 3, 3)", lambda m: npz(m, True), "rotation matrices", ".npz", off=0.06),
    Layout("containers", "MAT-file", "mathworks.com MAT-file level 5", mat, "MAT-file", ".mat"),
    Layout("containers", "PX4 ULog", "docs.px4.io/main/en/dev_log/ulog_file_format", ulg, "sensor_combined", ".ulg"),
    Layout("containers", "PX4 ULog of sensor_gyro", "github.com/PX4/PX4-Autopilot msg/SensorGyro.msg", lambda m: ulg(m, "sensor_gyro"), "sensor_gyro", ".ulg"),
    Layout("containers", "ArduPilot's binary log", "github.com/ArduPilot/ardupilot AP_Logger/LogStructure.h", ardupilot, "IMU 0", ".bin"),
    Layout("numbers", "faulty cells", "Microsoft's C runtime (1.#IND), Excel (#VALUE!)", faulty_cells, "line 301 and 2 more"),
    Layout("headers", "psql", "postgresql.org/docs/current/app-psql: aligned output", lambda m: table(" ts | gx | gy | gz \n----+----+----+----",
           [i.replace("T", " ") + "+00" for i in m.iso(6)], *xyz(m.w), between=" | ") + f"({len(m.s)} rows)\n", "with bars", ".txt", start=_ROS),
    Layout("headers", "Motive, two bodies", "docs.optitrack.com/motive/data-export/data-export-csv", two_bodies, "Rigid Body left", topic="left", off=0.06),
    Layout("headers", "WitMotion in Chinese", "wit-motion.com: the Chinese program's export", lambda m: table("时间\t角速度X(°/s)\t角速度Y(°/s)\t角速度Z(°/s)",
           [i.replace("T", " ") for i in m.iso(3)], *xyz(m.deg), between="\t"), "'时间', dates", ".txt", start=_ROS),
    Layout("headers", "units in a comment", "loggers that state them once, above the names", lambda m: table("# units: time [ms], gyro [deg/s]\ntime,gx,gy,gz", m.ns / 1e6, *xyz(m.deg)),
           "deg/s (said above)"),
    Layout("time", "MATLAB's timetable", "mathworks.com/help/matlab/ref/writetimetable.html", lambda m: table("Timestamp,X,Y,Z", [
        n.astype("M8[ms]").item().strftime("%d-%b-%Y %H:%M:%S.%f") for n in m.ns.astype("M8[ns]")], *xyz(m.w)), "dates", start=_ROS),
    Layout("time", "twelve hours", "dates of the United States: month first", lambda m: table("time,gx,gy,gz", [
        f"{int(i[5:7])}/{int(i[8:10])}/{i[:4]} {int(i[11:13]) % 12 or 12}:{i[14:23]} {'AP'[int(i[11:13]) > 11]}M" for i in m.iso(3)], *xyz(m.w)), "dates", start=_ROS),
    Layout("time", "two digits of a year", "Excel's short date in German", lambda m: table("Zeit;gyro x;gyro y;gyro z", [
        f"{i[8:10]}.{i[5:7]}.{i[2:4]} {i[11:23]}" for i in m.iso(3)], *xyz(m.w), between=";").replace(".", ",").replace("03,26 ", "03.26 ").replace("08,03.", "08.03."), "dates", start=_ROS),
    Layout("time", "a clock of whole seconds and milliseconds", "Arduino loggers with an RTC and millis() % 1000", lambda m: table("Time,Millis,gx,gy,gz", [
        i[11:19] for i in m.iso(3)], m.ns // 10**6 % 1000, *xyz(m.w)), "'Time' and 'Millis' in ms", start=3600 * 10**9),
    Layout("time", "gpmd2csv", "github.com/JuanIrache/gopro-utils: gpmd2csv", lambda m: table("Milliseconds,GyroX,GyroY,GyroZ", m.ns / 1e6, *xyz(m.w)), "in ms (named)"),
    Layout("time", "ticks with their length", "names of ROS 1 bridges and lidars, as in stamp_100us", lambda m: table("tick_100us,gx_dps,gy_dps,gz_dps", m.ns // 10**5 % 65536, *xyz(m.deg)),
           "in 100 us (named)", counted=True, off=0.05),
    Layout("time", "a counter of 8 bits", "packet counters of one byte", lambda m: table("packet_counter,gyro_x_dps,gyro_y_dps,gyro_z_dps", np.arange(len(m.s)) % 256, *xyz(m.deg)),
           "wraps at 256", options={"rate": 200.0}, counted=True),
    Layout("time", "a time for each sensor", "lidars: sys_ts, accel_ts, gyro_ts", lambda m: table("sys_ts,accel_ts,gyro_ts,lax,lay,laz,avx,avy,avz",
           m.ns + 10**9, m.ns - 10**6, m.ns, *xyz(m.acc), *xyz(m.deg)), "'gyro_ts' in ns"),
    Layout("time", "Arduino's monitor", "docs.arduino.cc: Serial Monitor, Show timestamp", lambda m: head(*(
        f"{i[11:23]} -> {n // 1000},{w[0]:.4f},{w[1]:.4f},{w[2]:.4f}" for i, n, w in zip(m.iso(3), m.ns.tolist(), m.deg.tolist()))), "'2' in us", ".txt"),
    Layout("rows", "letters for sensors", "rows A,t,x,y,z and G,t,x,y,z of small loggers", lambda m: head(*(line for n, a, w in zip(m.ns.tolist(), m.acc.tolist(), m.w.tolist()) for line in (
        f"A,{n / 1e6},{a[0]:.5f},{a[1]:.5f},{a[2]:.5f}", f"G,{n / 1e6},{w[0]:.6f},{w[1]:.6f},{w[2]:.6f}"))), "commas: G,", ".txt"),
    Layout("rows", "sentences of NMEA", "nmea.org: $, fields, * and a checksum", lambda m: head(*(
        f"$PIMU,{n // 1000},{w[0]:.5f},{w[1]:.5f},{w[2]:.5f}*{n % 256:02X}" for n, w in zip(m.ns.tolist(), m.w.tolist()))), "'2' in us", ".txt"),
    Layout("rates", "Kalibr, omega and alpha", "github.com/ethz-asl/kalibr wiki/bag-format", lambda m: table("timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z",
           m.ns, *xyz(m.w), *xyz(m.acc)), "'omega_x'", start=_ROS),
    Layout("rates", "Physics Toolbox, all sensors", "vieyrasoftware.net: Multi Record", lambda m: table("time,gFx,gFy,gFz,wx,wy,wz", m.ns * 1e-9, *xyz(m.acc / 9.81), *xyz(m.w)), "'wx'"),
    Layout("rates", "p, q, r", "rates of flight mechanics", lambda m: table("time (s),p (rad/s),q (rad/s),r (rad/s)", m.ns * 1e-9, *xyz(m.w)), "'p (rad/s)'"),
    Layout("rates", "tenths of a degree", "a unit with a factor", lambda m: table("t (s),gyro x (0.1 deg/s),gyro y (0.1 deg/s),gyro z (0.1 deg/s)", m.ns * 1e-9, *xyz(m.deg * 10)), "0.1 deg/s (named)"),
    Layout("rates", "PX4's vehicle_angular_velocity", "github.com/PX4/PX4-Autopilot msg/VehicleAngularVelocity.msg", lambda m: table(
        "timestamp,timestamp_sample,xyz[0],xyz[1],xyz[2],xyz_derivative[0],xyz_derivative[1],xyz_derivative[2]", m.ns // 1000 + 200, m.ns // 1000, *xyz(m.w), *xyz(m.acc)), "'timestamp_sample'"),
    Layout("orientations", "PX4's vehicle_attitude", "github.com/PX4/PX4-Autopilot msg/VehicleAttitude.msg", lambda m: table("timestamp,timestamp_sample,q[0],q[1],q[2],q[3],delta_q_reset[0]",
           m.ns // 1000 + 200, m.ns // 1000, *m.q.T, m.s * 0), "quaternions", off=0.06),
    Layout("orientations", "BNO085, i, j, k, real", "github.com/adafruit/Adafruit_BNO08x", lambda m: table("micros,quatI,quatJ,quatK,quatReal", m.ns // 1000, *m.q[:, [1, 2, 3, 0]].T), "quaternions", off=0.06),
    Layout("orientations", "MT Manager, matrices", "base.xsens.com: MT Manager's text export", lambda m: table("// Update Rate: 200.0Hz\nPacketCounter\t" + "\t".join(
        f"Mat[{r}][{c}]" for c in (1, 2, 3) for r in (1, 2, 3)), np.arange(len(m.s)), *(m.matrix[:, 3 * r + c] for c in range(3) for r in range(3)), between="\t"),
        "rotation matrices", ".txt", counted=True, off=0.06),
    Layout("orientations", "ros2 topic echo --csv of poses", "github.com/ros2/rosidl_runtime_py convert.py", lambda m: table("", m.ns // 10**9, m.ns % 10**9, ["map"] * len(m.s), *xyz(m.acc),
           *m.q[:, [1, 2, 3, 0]].T), "quaternions", start=_ROS, off=0.06),
    Layout("numbers", "degrees of Windows' code page", "units in code page 1252", lambda m: table("t [µs];wx [°/s];wy [°/s];wz [°/s]", m.ns // 1000, *xyz(m.deg), between=";").encode("cp1252"),
           "in us (named)"),
    Layout("numbers", "lists of Python", "print([t, x, y, z])", lambda m: head(*(f"[{n / 1e9}, {w[0]}, {w[1]}, {w[2]}]" for n, w in zip(m.ns.tolist(), m.w.tolist()))), "commas", ".txt"),
    Layout("headers", "a card filled with zeros", "files that loggers allot before they write", lambda m: table("t_us,gx_dps,gy_dps,gz_dps", m.ns // 1000, *xyz(m.deg)).encode() + bytes(4096), "in us (named)"),
    Layout("headers", "titles over equal names", "loggers that append a table of each sensor", lambda m: "[Accelerometer]\n" + table("time,x,y,z", m.ns * 1e-9, *xyz(m.acc)) + "\n[Gyroscope]\n"
           + table("time,x,y,z", m.ns * 1e-9, *xyz(m.w)), "commas: Gyroscope,"),
    Layout("time", "microseconds of 16 bits", "uint16_t of micros(): a wrap every 65 ms", lambda m: table("t_us,gx_dps,gy_dps,gz_dps", m.ns // 1000 % 65536, *xyz(m.deg)), "wraps at 65536", counted=True),
    Layout("time", "rates of two sensors", "headers that state the rate of each", lambda m: "# Accel ODR: 100 Hz\n# Gyro ODR: 200 Hz\n# baud rate: 9600\n" + table("n,gx,gy,gz", np.arange(len(m.s)), *xyz(m.deg)),
           "at 200 Hz", counted=True),
    Layout("time", "two stamps", "ROS tools that add the time of receipt", lambda m: table("recv.sec,recv.nanosec,header.sec,header.nanosec,gx,gy,gz", (m.ns + 10**7) // 10**9, (m.ns + 10**7) % 10**9,
           m.ns // 10**9, m.ns % 10**9, *xyz(m.w)), "'header.sec'", start=_ROS),
    Layout("rates", "ranges beside names", "loggers that state the range, not the unit", lambda m: "# gyro (2000 dps), acc (16 g)\n" + table(
        "t,gyro x (2000dps),gyro y (2000dps),gyro z (2000dps)", m.ns * 1e-9, *xyz(m.deg)), "in deg/s (by their size)"),
    Layout("rows", "words of a state", "loggers with True, False and a state in each row", lambda m: table("time,moving,state,gx,gy,gz", m.ns * 1e-9, ["True"] * len(m.s), ["RUN"] * len(m.s), *xyz(m.w)), "'gx'"),
    Layout("orientations", "rates of zero beside quaternions", "drivers without a gyroscope fill its fields with 0", lambda m: table("t,gyro_x,gyro_y,gyro_z,qw,qx,qy,qz", m.ns * 1e-9, *xyz(m.w * 0), *m.q.T),
           "quaternions", off=0.06),
    Layout("rates", "raw beside scaled", "loggers that keep counts and deg/s", lambda m: table("t,gx_raw,gy_raw,gz_raw,gx,gy,gz", m.ns * 1e-9, *xyz(np.round(m.deg * 131)), *xyz(m.deg)), "'gx'"),
    Layout("orientations", "transforms with times", "rows of a matrix (4, 4) after a time, as of hand-eye tools", lambda m: table("", m.ns * 1e-9, *[
        c for r in range(3) for c in (*m.matrix[:, 3 * r : 3 * r + 3].T, m.acc[:, r])], *(m.s * 0 + k for k in (0, 0, 0, 1)), between=" "), "rotation matrices", ".txt", off=0.06),
    Layout("containers", "labels", "docs.arduino.cc: Serial Plotter", labels, "text with labels", ".txt"),
    Layout("containers", "rostopic echo", "wiki.ros.org/rostopic: echo", echoed, "rostopic echo", ".txt", start=_ROS),
    Layout("containers", "phyphox's zip", "phyphox.org/wiki: export as zip, with meta/", lambda m: zipped(**{"Raw Data.csv": phyphox(m), "meta/device.csv": "a,b\n", "meta/time.csv": "a,b\n"}), "rad/s (named)", ".zip"),
    Layout("containers", "xz", "tukaani.org/xz", lambda m: lzma.compress(sensor_logger(m).encode()), "as Sensor Logger", ".csv.xz", start=EPOCH),
    Layout("containers", "Edge Impulse", "docs.edgeimpulse.com: data acquisition format", edge_impulse, "at 200 Hz", ".json", counted=True),
    Layout("containers", "JSON of times and rows", "arrays of numpy as JSON", lambda m: json.dumps({"gyro": {"t": (m.ns * 1e-9).tolist(), "values": m.w.tolist()}}), "JSON: gyro", ".json"),
    Layout("containers", "phyphox's Excel", "phyphox.org/wiki: export as Excel", xlsx, "Raw Data", ".xlsx"),
]  # fmt: skip
