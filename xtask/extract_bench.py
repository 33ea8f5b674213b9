"""Speed and memory of `extract` on simulated recordings, beside a plain Python reader of the same
file, as somebody writes it in five minutes. Run by `cargo xtask bench extract`.

usage: extract_bench.py TARGET [MINUTES]
TARGET is cargo's folder, which takes the recordings for the while, 1.3 GB for each of the
MINUTES of depth at full size. Memory is measured at two lengths: it must not grow with the
recording.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

# "Finished, with loss": parts are missing here on purpose.
GOOD = (0, 4)


def read(recording, out):
    """Decodes every IMU message and writes a EuRoC table."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(recording, "rb") as file, open(out, "w") as table:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages(topics=["/board/imu"]):
            stamp = message.header.stamp
            w, a = message.angular_velocity, message.linear_acceleration
            row = (stamp.sec * 10**9 + stamp.nanosec, w.x, w.y, w.z, a.x, a.y, a.z)
            print(*row, sep=",", file=table)


def measure(name, command, size):
    """Runs a command to its end, prints what it took, and gives the seconds."""
    begun = time.monotonic()
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    seconds = time.monotonic() - begun
    if os.waitstatus_to_exitcode(status) not in GOOD:
        sys.exit(f"{command} ended with {os.waitstatus_to_exitcode(status)}")
    memory = usage.ru_maxrss / 1024
    print(f"{name} ({size:.0f} MB): {seconds:.2f} s, {size / seconds:.0f} MB/s, {memory:.0f} MB of memory")
    return seconds


def main(programs, place, minutes):
    def made(name, seconds, *options):
        folder = place / name
        command = [programs / "examples/synthetic_recording", folder, str(seconds), *options]
        subprocess.run(command, check=True)
        files = [folder / "recording.mcap", folder / "depth.mkv"]
        return folder, sum(file.stat().st_size for file in files if file.exists()) / 1e6

    def extract(name, folder, size, layout):
        out = place / "out"
        command = [programs / "smartdepthsync", "extract", folder, "--out", out, "--format", layout]
        seconds = measure(name, command, size)
        shutil.rmtree(out)
        return seconds

    extract("board, 6 min", *made("six", 360), "euroc")
    hour, size = made("hour", 3600)
    ours = extract("board, 1 h", hour, size, "euroc")
    script = [sys.executable, __file__, "--read", hour / "recording.mcap", place / "python.csv"]
    theirs = measure("the same by plain Python", script, size)
    print(f"ratio {theirs / ours:.1f} (aim: 20)")
    for length in sorted({1, minutes}):
        depth = made(f"depth-{length}", 60 * length, "--depth", "640x576", "--phone")
        extract(f"board, phone and depth of 640 × 576, {length} min", *depth, "tum")
        shutil.rmtree(depth[0])


if sys.argv[1] == "--read":
    read(*sys.argv[2:])
else:
    target = pathlib.Path(sys.argv[1])
    with tempfile.TemporaryDirectory(dir=target) as place:
        main(target / "release", pathlib.Path(place), int((sys.argv[2:] or [10])[0]))
