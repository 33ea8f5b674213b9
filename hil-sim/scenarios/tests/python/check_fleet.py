"""Extracts twelve recordings on two nodes of Ray out of an S3 server and back into it. One
recording is damaged, one truncated, and a node is killed in the middle of an extraction.

usage: check_fleet.py RECORDING PROGRAM
"""

import os
import logging
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

SOURCES = Path(__file__).parents[4] / "host/data/smartdepthsync-data/src"
sys.path.insert(0, str(SOURCES))
# For the workers.
os.environ["PYTHONPATH"] = str(SOURCES)
os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
# Ray has its workers wait for every other program (niceness 15).
os.environ["RAY_worker_niceness"] = "0"

import boto3
import fsspec
import pyarrow.parquet as pq
from moto.server import ThreadedMotoServer
from ray.cluster_utils import Cluster

from smartdepthsync_data import Dataset
from smartdepthsync_data.fleet import fleet
from smartdepthsync_data.fleet.run import NotStarted

recording, program = map(Path, sys.argv[1:])
DAMAGED, TRUNCATED = "day1/walk3", "day2/walk8"

# Notes each extraction's start and end. The first on the node that is to be killed is never done
# by itself. One on the other node is killed alone, as by a system out of memory.
WRAPPER = """#!/bin/sh
[ "$1" = extract ] || exec {program} "$@"
name=$(basename "$2")
echo "start $name $FLEET_NODE" >> {noted}
if [ "$FLEET_NODE" = second ] && mkdir {folder}/caught 2>/dev/null; then
    echo $$ > {folder}/caught/pid
    exec sleep 3600
fi
if [ "$name" = walk5 ] && mkdir {folder}/shot 2>/dev/null; then kill -KILL $$; fi
{program} "$@"
code=$?
echo "end $name" >> {noted}
exit $code
"""


def notes(noted):
    return noted.read_text().splitlines() if noted.exists() else []


def main(folder):
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    keys = {"key": "any", "secret": "thing", "client_kwargs": {"endpoint_url": f"http://{host}:{port}"}}
    client = boto3.client("s3", endpoint_url=f"http://{host}:{port}", aws_access_key_id="any",
                          aws_secret_access_key="thing", region_name="us-east-1")
    client.create_bucket(Bucket="rig")
    source, out = "s3://rig/recordings", "s3://rig/datasets"
    store = fsspec.filesystem("s3", **keys)
    for number in range(12):
        name = f"day{number // 6 + 1}/walk{number}"
        own = folder / "one"
        shutil.copytree(recording, own)
        board = own / "recording.mcap"
        if name == DAMAGED:
            # Nothing of it can be read: a head alone would be skipped.
            board.write_bytes(b"\x55" * board.stat().st_size)
        if name == TRUNCATED:
            os.truncate(board, board.stat().st_size * 9 // 10)
        for file in own.rglob("*"):
            if file.is_file():
                store.put_file(str(file), f"rig/recordings/{name}/{file.relative_to(own)}")
        shutil.rmtree(own)

    noted, wrapper, scratch = folder / "noted", folder / "program", folder / "scratch"
    scratch.mkdir()
    wrapper.write_text(WRAPPER.format(program=program, noted=noted, folder=folder))
    wrapper.chmod(0o755)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "env_vars": {"FLEET_NODE": "first"}})
    second = cluster.add_node(num_cpus=1, env_vars={"FLEET_NODE": "second"})
    cluster.wait_for_nodes()
    said, result = [], []

    def run():
        result.append(fleet(source, out, address=cluster.address, program=str(wrapper),
                            scratch=str(scratch), storage=keys, say=said.append))

    runner = threading.Thread(target=run)
    runner.start()
    pid = folder / "caught/pid"
    while not pid.exists() or not pid.read_text().endswith("\n"):
        assert runner.is_alive(), said
        time.sleep(0.1)
    cluster.remove_node(second, allow_graceful=False)
    # The node's own end would have taken it along.
    os.kill(int(pid.read_text()), signal.SIGKILL)
    runner.join()
    (rows,) = result

    # Eleven data sets, one honest failure; one is named as having lost something.
    verdicts = {row["name"]: row["verdict"] for row in rows}
    assert len(rows) == 12 and verdicts.pop(DAMAGED) == "failed", rows
    assert verdicts.pop(TRUNCATED) == "loss" and set(verdicts.values()) == {"good"}, verdicts
    assert [row["verdict"] for row in rows[:3]] == ["failed", "loss", "good"]
    assert "recording.mcap" in rows[0]["message"] and rows[1]["lost"], rows[:2]
    assert any("failed" in line for line in said) and any("left" in line for line in said)
    # Nothing done twice, but for the two that were killed.
    starts = Counter(line.split()[1] for line in notes(noted) if line.startswith("start"))
    ends = Counter(line.split()[1] for line in notes(noted) if line.startswith("end"))
    assert set(ends.values()) == {1} and len(ends) == 12, ends
    assert sorted(starts.values()) == [1] * 10 + [2] * 2, starts
    # Whole objects, no other ones, and no upload left open.
    kept = {path.removeprefix("rig/datasets/") for path in store.find("rig/datasets")}
    names = [row["name"] for row in rows]
    wanted = {f"{name}{end}" for name in names for end in [".tar", ".log", ".json"]}
    assert kept == (wanted - {f"{DAMAGED}.tar"}) | {"index.parquet", "index.html"}, kept
    assert not client.list_multipart_uploads(Bucket="rig").get("Uploads")
    for row in rows[1:]:
        local = folder / "data.tar"
        store.get_file(f"rig/datasets/{row['name']}.tar", str(local))
        assert len(Dataset(local)) == row["pairs"] > 100, row
        assert local.stat().st_size == row["bytes_out"]
    store.get_file("rig/datasets/index.parquet", str(folder / "index.parquet"))
    assert pq.read_table(folder / "index.parquet")["name"].to_pylist() == names

    # Again: only what failed is tried.
    before = notes(noted)
    again = fleet(source, out, address=cluster.address, program=str(wrapper), scratch=str(scratch),
                  storage=keys, say=said.append)
    assert [line.split()[:2] for line in notes(noted)[len(before):]] == [["start", "walk3"], ["end", "walk3"]]
    assert {row["name"]: row["verdict"] for row in again} == {row["name"]: row["verdict"] for row in rows}
    # A fleet leaves nothing on a node that lives.
    left = [path for path in scratch.iterdir()]
    assert len(left) <= 1, left
    address = cluster.address
    cluster.shutdown()
    # Nobody listens there any more.
    try:
        fleet(source, out, address=address, storage=keys)
    except NotStarted as error:
        assert "check --address" in str(error), error
    else:
        raise AssertionError("a cluster that has ended took recordings")
    server.stop()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(Path(folder))
    print("ok")
