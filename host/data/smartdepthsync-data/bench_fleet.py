"""Benchmark of the fleet: speed-up from one to two workers, and overhead of an extraction.

usage: bench_fleet.py RECORDING PROGRAM [COUNT]

It needs the packages of xtask/readers/fleet.txt and two idle cores. Ray and its
workers are started before the measurement.
"""

import os
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import monotonic

SOURCES = Path(__file__).parent / "src"
sys.path.insert(0, str(SOURCES))
os.environ["PYTHONPATH"] = str(SOURCES)  # for the workers
os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
os.environ["RAY_worker_niceness"] = "0"

import ray

from smartdepthsync_data.fleet import fleet


def seconds(source, folder, program, workers):
    """Returns the time of the whole fleet, s, and each recording's overhead relative to its
    extraction."""
    ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)

    def warm():
        import smartdepthsync_data.fleet.work  # noqa: F401

        return os.getpid()

    ray.get([ray.remote(num_cpus=1)(warm).remote() for _ in range(4 * workers)])
    begin = monotonic()
    rows = fleet(source, f"{folder}/{workers}", program=program, say=lambda line: None)
    past = monotonic() - begin
    ray.shutdown()
    assert all(row["verdict"] in ("good", "loss") for row in rows), rows
    around = [(row["fetch_s"] + row["store_s"]) / row["extract_s"] for row in rows]
    return past, around


def main(recording, program, count=12):
    # On the recording's file system, so that its files can be linked.
    with tempfile.TemporaryDirectory(dir=Path(recording).resolve().parent) as folder:
        source = Path(folder) / "recordings"
        for number in range(int(count)):
            own = source / f"walk{number}"
            own.mkdir(parents=True)
            for file in Path(recording).iterdir():
                (own / file.name).hardlink_to(file)
        one, around = seconds(str(source), folder, program, 1)
        two, _ = seconds(str(source), folder, program, 2)
    print(f"{count} recordings: {one:.1f} s with one worker, {two:.1f} s with two, "
          f"{one / two:.2f} times as fast")
    print(f"around an extraction: {100 * median(around):.1f} % of it (median), one worker")


if __name__ == "__main__":
    main(*sys.argv[1:])
