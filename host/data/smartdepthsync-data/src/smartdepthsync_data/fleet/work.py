"""What is done with one recording, on whichever node. Nothing here needs Ray.

In the store, beside each other: ``NAME.tar`` (the data set, not compressed), ``NAME.log`` (what
the extraction said), ``NAME.json`` (the row of the table). The row is written last: with it a
recording is finished. Each object is there whole or not at all.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import subprocess
import tempfile
import uuid
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from time import monotonic
from typing import Any

import fsspec
from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

#: Ends of the names of objects that are being written, where a store shows those.
PART = ".part"
#: Exit codes of ``smartdepthsync extract`` with a data set.
VERDICTS = {0: "good", 4: "loss"}
FAILED = "failed"
#: Its exit code after a signal that it heard.
INTERRUPTED = 130
BLOCK = 1 << 20


class Stopped(Exception):
    """The extraction was killed or interrupted, which says nothing about the recording."""


@dataclass(frozen=True)
class Job:
    """One recording, and what to do with it."""

    #: Its folder below the source, which is also its name below ``out``.
    name: str
    #: Its files: path below its folder, size in bytes, and what the store knows of its version.
    files: tuple[tuple[str, int, str], ...]
    source: str
    out: str
    program: str
    options: tuple[str, ...] = ()
    threads: int = 1
    scratch: str | None = None
    storage: dict[str, Any] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(size for _, size, _ in self.files)

    @property
    def state(self) -> str:
        """A digest of what the store lists, which changes when a file does: no file is read."""
        return hashlib.sha256(json.dumps(self.files).encode()).hexdigest()

    def is_finished_by(self, row: dict[str, Any] | None, version: str, **same: str) -> bool:
        """Whether an earlier row is of this recording in the state or of the digest given."""
        return (
            row is not None
            and row.get("verdict") in VERDICTS.values()
            and row.get("version") == version
            and row.get("options") == list(self.options)
            and all(row.get(key) == value for key, value in same.items())
        )


def version_of(program: str) -> str:
    """What the program says of its version."""
    told = subprocess.run([program, "--version"], capture_output=True, text=True, check=True)
    return told.stdout.strip()


def extract(job: Job) -> dict[str, Any]:
    """Extracts a recording, puts result and log into the store, and returns the row.

    A recording that cannot be extracted gives a row too. Raises what the store raises, and
    :class:`Stopped`.
    """
    begin = monotonic()
    store, root = url_to_fs(job.out, **job.storage)
    target = f"{root}/{job.name}"
    earlier = None
    with suppress(FileNotFoundError):
        earlier = parsed_row(store.cat_file(f"{target}.json"))
    version = version_of(job.program)
    if job.is_finished_by(earlier, version, state=job.state):
        # By an attempt whose node was lost after all was written.
        return earlier
    with (
        tempfile.TemporaryDirectory(prefix="smartdepthsync-", dir=job.scratch) as folder,
        ThreadPoolExecutor(1) as beside,
    ):
        scratch = Path(folder)
        recording = _fetched(job, scratch)
        fetched = monotonic()
        # While it is extracted: both read the same bytes, from the disk once.
        digest = beside.submit(_digest, recording, job)
        row: dict[str, Any] = {
            "name": job.name, "state": job.state, "version": version,
            "options": list(job.options), "bytes_in": job.size, "node": platform.node(),
        }  # fmt: skip
        if earlier and job.is_finished_by(earlier, version, digest=digest.result()):
            row = {**earlier, "state": job.state}
        else:
            log = scratch / "log"
            row |= _recorder(recording) | _run(job, recording, scratch / "data", log)
            row["fetch_s"], row["extract_s"] = fetched - begin, monotonic() - fetched
            fetched = monotonic()
            tar, row["bytes_out"] = scratch / "data.tar", 0
            if row["verdict"] == FAILED:
                with suppress(FileNotFoundError):
                    store.rm(f"{target}.tar")
            else:
                # Python's own takes four times as long for thousands of small images. In blocks
                # of 1 MiB.
                pack = ["tar", "-b", "2048", "-C", str(scratch / "data"), "-cf", str(tar)]
                subprocess.run([*pack, *os.listdir(scratch / "data")], check=True)
                row["bytes_out"] = tar.stat().st_size
                put(store, tar, f"{target}.tar")
            put(store, log, f"{target}.log")
            row["store_s"] = monotonic() - fetched
        row["digest"] = digest.result()
        row["finished"] = datetime.now(timezone.utc).isoformat(timespec="seconds")
        last = scratch / "row"
        last.write_text(json.dumps(row, indent=2))
        put(store, last, f"{target}.json")
    return row


def parsed_row(text: bytes) -> dict[str, Any] | None:
    """A row out of its file; None if it is not one."""
    with suppress(ValueError):
        found = json.loads(text)
        return found if isinstance(found, dict) else None
    return None


def put(store: fsspec.AbstractFileSystem, file: Path, target: str) -> None:
    """Moves a file into a store, whole or not at all."""
    store.makedirs(store._parent(target), exist_ok=True)
    if isinstance(store, LocalFileSystem):
        part = f"{target}.{uuid.uuid4().hex}{PART}"
        shutil.move(file, part)
        os.replace(part, target)
    else:
        # An object appears when all of it has come.
        store.put_file(str(file), target)


def _fetched(job: Job, scratch: Path) -> Path:
    """The recording's folder on this node: a local one as it is, for it is only read."""
    store, root = url_to_fs(job.source, **job.storage)
    folder = f"{root}/{job.name}"
    if isinstance(store, LocalFileSystem):
        return Path(folder)
    # The name of the folder is the recording's name in its report.
    local = scratch / Path(job.name).name
    paths = [path for path, _, _ in job.files]
    store.get([f"{folder}/{path}" for path in paths], [str(local / path) for path in paths])
    return local


def _digest(recording: Path, job: Job) -> str:
    """SHA-256 of the names and the content of all files."""
    whole = hashlib.sha256()
    for path, _, _ in sorted(job.files):
        one = hashlib.sha256()
        with open(recording / path, "rb") as file:
            while block := file.read(BLOCK):
                one.update(block)
        whole.update(f"{path}\0{one.hexdigest()}\n".encode())
    return whole.hexdigest()


def _run(job: Job, recording: Path, out: Path, log: Path) -> dict[str, Any]:
    """Runs the extraction; the part of the row that it decides."""
    command = [job.program, "extract", str(recording), "--json", "--out", str(out), *job.options]
    environment = {**os.environ, "RAYON_NUM_THREADS": str(job.threads)}
    with open(log, "wb") as messages:
        ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=messages, env=environment)
    if ended.returncode < 0 or ended.returncode == INTERRUPTED:
        raise Stopped(f"the extraction was stopped ({ended.returncode}); was the memory full?")
    try:
        report = json.loads(ended.stdout)
    except json.JSONDecodeError:
        report = {}
    verdict = VERDICTS.get(ended.returncode, FAILED)
    error = report.get("error") or {}
    message = "; ".join(filter(None, [error.get("message"), error.get("next_step")]))
    if verdict == FAILED and not message:
        message = f"it ended with {ended.returncode} and without a report; its log may say why"
    with open(log, "ab") as messages:
        messages.write(message.encode())
    pairs, clock = report.get("pairs") or {}, report.get("clock") or {}
    losses = [loss["what"] for loss in report.get("losses", [])]
    return {
        "verdict": verdict,
        "exit_code": ended.returncode,
        "message": message,
        "pairs": (pairs.get("spread") or {}).get("count", 0),
        "phase_offset_us": (report.get("grid") or {}).get("offset_us"),
        "phase_sigma_us": pairs.get("sigma_us"),
        "clock_sigma_us": (clock.get("sigma_us") or [None, None])[1],
        "losses": len(losses),
        "lost": losses,
    }


def _recorder(recording: Path) -> dict[str, Any]:
    """Versions of program and firmware that recorded it."""
    session: dict[str, Any] = {}
    with suppress(OSError, json.JSONDecodeError):
        session = json.loads((recording / "session.json").read_text())
    return {
        "recorded_by": session.get("program"),
        "firmware": (session.get("board") or {}).get("firmware"),
    }
