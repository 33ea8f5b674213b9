"""Recordings of a store, and their extraction on a cluster."""

from __future__ import annotations

import re
import socket
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path, PurePosixPath
from threading import Timer
from time import monotonic
from typing import Any

import fsspec
from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from . import table, work
from .work import FAILED, PART, Job

#: File that makes a folder a recording.
RECORDING = "recording.mcap"
#: Time between two lines of progress while nothing is finished, s.
QUIET = 30.0
#: Longest wait for the address of a cluster, s.
ANSWER = 10.0
#: Time after which a start is late, s.
LATE = 60.0
#: Largest number of tasks submitted to the cluster at a time.
AT_A_TIME = 1000


def fleet(
    source: str,
    out: str,
    *,
    address: str | None = None,
    program: str = "smartdepthsync",
    options: Iterable[str] = (),
    threads: int = 1,
    retries: int = 3,
    scratch: str | None = None,
    storage: dict[str, Any] | None = None,
    say: Callable[[str], None] = lambda line: print(line, file=sys.stderr),
) -> list[dict[str, Any]]:
    """Extracts every recording below ``source`` into ``out``; both are URLs of fsspec.

    Returns a row per recording (:data:`table.SCHEMA`), the worst first, and writes the rows to
    ``index.parquet`` and ``index.html`` in ``out``. A recording that has a row for the same
    files, version and options is skipped; one that failed is tried again.

    ``address`` is that of a Ray cluster (None: this computer), on whose nodes ``program`` and this
    package are installed. ``options`` are passed to ``smartdepthsync extract``, ``storage`` to
    fsspec. Each recording uses ``threads`` processors and the folder ``scratch``, and is tried
    again up to ``retries`` times when its node is lost or its extraction is killed.
    """
    import ray

    # The nodes' working directories differ from this one.
    source, out = (_whole(url, storage or {}) for url in (source, out))
    store, root = url_to_fs(out, **(storage or {}))
    more = {
        "program": program, "options": tuple(options), "threads": threads, "scratch": scratch,
        "storage": storage or {},
    }  # fmt: skip
    jobs = find(source, out, **more)
    if not jobs:
        raise ValueError(f"there is no {RECORDING} below {source}")
    own = not ray.is_initialized()
    if own:
        _start(address, say)
    try:
        version = ray.get(ray.remote(num_cpus=0)(work.version_of).remote(program))
        earlier = _rows(store, [f"{root}/{job.name}.json" for job in jobs])
        rows = []
        for job in list(jobs):
            row = earlier.get(f"{root}/{job.name}.json")
            if job.is_finished_by(row, version, state=job.state):
                rows.append(row)
                jobs.remove(job)
        say(f"{len(rows)} recordings are finished, {len(jobs)} to do, by {version}")
        rows += _run(jobs, threads, retries, say)
    finally:
        if own:
            ray.shutdown()
    # Left by attempts whose node was lost.
    for left in [path for path in store.find(root) if path.endswith(PART)]:
        store.rm(left)
    rows.sort(key=table.worst_first)
    with tempfile.TemporaryDirectory() as folder:
        for name, write in {"index.parquet": table.parquet, "index.html": table.html}.items():
            write(rows, Path(folder) / name)
            work.put(store, Path(folder) / name, f"{root}/{name}")
    return rows


class NotStarted(Exception):
    """Ray did not start, or its cluster did not answer."""


_STEP = (
    "run it again, with RAY_raylet_start_wait_time_s=120 in the environment if this computer is busy "
    "(`ray stop --force` ends what is left of the first try), or check --address"
)


def _start(address: str | None, say: Callable[[str], None]) -> None:
    import ray

    late = Timer(LATE, say, [f"Ray has not started after {LATE:.0f} s; Ctrl-C ends it, then {_STEP}"])
    late.daemon = True
    late.start()
    try:
        # Ray itself tries again for minutes where nobody listens.
        if place := re.fullmatch(r"(?:ray://)?\[?([^/]+?)]?:(\d+)", address or ""):
            socket.create_connection((place[1], int(place[2])), timeout=ANSWER).close()
        dashboard = False if address is None else None
        ray.init(address=address, include_dashboard=dashboard, log_to_driver=False)
    # A start that takes too long is a plain Exception of Ray's.
    except Exception as error:
        reason = str(error).strip().splitlines() or [type(error).__name__]
        raise NotStarted(f"Ray did not start: {reason[0]}; {_STEP}") from error
    finally:
        late.cancel()


def _whole(url: str, storage: dict[str, Any]) -> str:
    store, root = url_to_fs(url, **storage)
    return store.unstrip_protocol(root) if isinstance(store, LocalFileSystem) else url


def find(source: str, out: str, **more: Any) -> list[Job]:
    """Returns the recordings below ``source``, the largest first."""
    store, root = url_to_fs(source, **more.get("storage", {}))
    found = store.find(root, detail=True)
    folders = {str(PurePosixPath(path).parent) for path in found if path.endswith(f"/{RECORDING}")}
    if root in folders:
        raise ValueError(f"{source} is a recording itself; give the folder that it is in")
    files: dict[str, list[tuple[str, int, str]]] = {folder: [] for folder in folders}
    for path, info in found.items():
        # A file belongs to the innermost recording around it.
        parents = (str(parent) for parent in PurePosixPath(path).parents)
        if folder := next((parent for parent in parents if parent in folders), None):
            known = info.get("ETag") or info.get("mtime") or info.get("last_modified")
            files[folder].append((path[len(folder) + 1 :], info["size"], str(known)))
    jobs = [
        Job(folder[len(root) + 1 :], tuple(sorted(listed)), source, out, **more)
        for folder, listed in files.items()
    ]
    return sorted(jobs, key=lambda job: (-job.size, job.name))


def _rows(store: fsspec.AbstractFileSystem, paths: list[str]) -> dict[str, Any]:
    """Returns the existing rows, read many at a time."""
    store.invalidate_cache()
    there = store.cat(paths, on_error="omit", recursive=False)
    return {path: work.parsed_row(text) for path, text in there.items()}


def _run(
    jobs: list[Job], threads: int, retries: int, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    import ray

    # Repeated after a lost node or worker; any other error is a result.
    task = ray.remote(num_cpus=threads, max_retries=retries, retry_exceptions=[work.Stopped])
    task = task(work.extract)
    todo, running, rows = list(reversed(jobs)), {}, []
    begin, done, whole = monotonic(), 0, sum(job.size for job in jobs)
    try:
        while todo or running:
            while todo and len(running) < AT_A_TIME:
                job = todo.pop()
                running[task.options(name=job.name).remote(job)] = job
            ready, _ = ray.wait(list(running), timeout=QUIET)
            for reference in ready:
                job = running.pop(reference)
                done += job.size
                try:
                    rows.append(ray.get(reference))
                except Exception as error:
                    rows.append(_failed(job, error))
                if rows[-1]["verdict"] == FAILED:
                    say(f"{job.name} failed: {rows[-1]['message']}")
            past = monotonic() - begin
            left = f"{past * (whole - done) / done:.0f} s left" if done else "no estimate yet"
            failed, lossy = (
                sum(row["verdict"] == kind for row in rows) for kind in (FAILED, "loss")
            )
            counts = f"{failed} failed, {lossy} with loss"
            say(f"{len(rows)} of {len(jobs)} done, {counts}, {past:.0f} s, {left}")
    finally:
        for reference in running:
            ray.cancel(reference)
    return rows


def _failed(job: Job, error: Exception) -> dict[str, Any]:
    """Returns the row of a recording without a result: the store or every node was unreachable."""
    reason = str(getattr(error, "cause", None) or error).strip().splitlines()
    return {
        "name": job.name,
        "verdict": FAILED,
        "message": f"{type(error).__name__}: {reason[-1] if reason else ''}",
        "bytes_in": job.size,
        "options": list(job.options),
    }
