"""Prints what telemetry-parser calls a recording's camera, then its gyroscope as CSV.

Arguments: the file, the seconds and the bytes of memory that this may take. Exit codes: 3
without the package, 4 if it cannot read the file; the first line then says why."""

import sys

# Nothing is imported from the folder that this runs in: the recordings may lie there.
sys.path[:] = filter(None, sys.path)

import math
import resource
import signal

path, seconds, memory = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
# Ended by the system, whatever it is busy with, and also if nobody waits for it any more.
signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.signal(signal.SIGALRM, signal.SIG_DFL)
signal.alarm(seconds)
hard = resource.getrlimit(resource.RLIMIT_AS)[1]
memory = memory if hard == resource.RLIM_INFINITY else min(memory, hard)
resource.setrlimit(resource.RLIMIT_AS, (memory, hard))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def line(text):
    shown = "".join(c for c in text if c.isprintable())
    # With its end not longer than MAX_LINE of telemetry.rs.
    return shown.encode(errors="replace")[:499].decode(errors="ignore")


def gyroscope(parser):
    for sample in parser.normalized_imu():
        if sample["gyro"]:
            yield sample["timestamp_ms"], *sample["gyro"]


def orientations(parser):
    for sample in parser.telemetry():
        for data in sample.get("Quaternion", {}).get("Data", []):
            yield data["t"], data["v"]


def turning(samples):
    """The rates that turn each orientation into the next, in the middle between them."""
    last = None
    for t, q in samples:
        if last and t > last[0]:
            t0, p = last
            w = p["w"] * q["w"] + p["x"] * q["x"] + p["y"] * q["y"] + p["z"] * q["z"]
            x = p["w"] * q["x"] - p["x"] * q["w"] - p["y"] * q["z"] + p["z"] * q["y"]
            y = p["w"] * q["y"] + p["x"] * q["z"] - p["y"] * q["w"] - p["z"] * q["x"]
            z = p["w"] * q["z"] - p["x"] * q["y"] + p["y"] * q["x"] - p["z"] * q["w"]
            sine = math.sqrt(x * x + y * y + z * z)
            # An orientation and its negative are the same.
            angle = 2 * math.degrees(math.atan2(math.copysign(sine, w), abs(w)))
            rate = angle / (t - t0) * 1e3 / sine if sine else 0
            yield (t0 + t) / 2, x * rate, y * rate, z * rate
        last = t, q


try:
    from telemetry_parser import Parser
except ImportError as error:
    print(line(str(error)))
    sys.exit(3)
try:
    parser = Parser(path)
    what = f"{parser.camera} ({parser.model or 'no model'})"
    rows = list(gyroscope(parser))
    if not rows:
        what += ", rates of its orientation"
        rows = list(turning(orientations(parser)))
# A panic of Rust is no Exception.
except BaseException as error:
    print(line(f"{type(error).__name__}: {error}"))
    sys.exit(4)
print(line(what))
print("time_ms,x_deg,y_deg,z_deg")
sys.stdout.writelines("%r,%r,%r,%r\n" % row for row in rows)
