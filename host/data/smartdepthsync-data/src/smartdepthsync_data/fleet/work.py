"""Extraction of one recording on a node. It does not need Ray.

The store gets ``NAME.tar`` (the data set, not compressed), ``NAME.log`` (the messages of
the extraction) and ``NAME.json`` (the row of the table). The row is written last: it marks the
recording as finished. Each object appears only when it is complete.
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

#: End of the name of an object that is being written, in stores that show it.
PART = ".part"
#: Verdicts by the exit codes of ``smartdepthsync extract`` that mean a data set.
VERDICTS = {0: "good", 4: "loss"}
FAILED = "failed"
#: Exit code after a handled signal.
INTERRUPTED = 130
BLOCK = 1 << 20


class Stopped(Exception):
    """The extraction was killed or interrupted, which says nothing about the recording."""


@dataclass(frozen=True)
class Job:
    """Extraction of one recording."""

    #: Folder below ``source``, and name below ``out``.
    name: str
    #: Files: path below the folder, size in bytes, and the store's mark of the version.
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
        """Size of all files, bytes."""
        return sum(size for _, size, _ in self.files)

    @property
    def state(self) -> str:
        """Digest of the store's listing, which changes when a file does. No file is read."""
        return hashlib.sha256(json.dumps(self.files).encode()).hexdigest()

    def is_finished_by(self, row: dict[str, Any] | None, version: str, **same: str) -> bool:
        """Returns True if an earlier row is a result of this job with the same ``state`` or
        ``digest``."""
        return (
            row is not None
            and row.get("verdict") in VERDICTS.values()
            and row.get("version") == version
            and row.get("options") == list(self.options)
            and all(row.get(key) == value for key, value in same.items())
        )


def version_of(program: str) -> str:
    """Returns the version that the program prints."""
    printed = subprocess.run([program, "--version"], capture_output=True, text=True, check=True)
    return printed.stdout.strip()


def extract(job: Job) -> dict[str, Any]:
    """Extracts a recording, puts result and log into the store, and returns the row.

    There is a row also if the extraction fails. Raises the errors of the store, and
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
        # Finished by an attempt whose node was lost after writing everything.
        return earlier
    with (
        tempfile.TemporaryDirectory(prefix="smartdepthsync-", dir=job.scratch) as folder,
        ThreadPoolExecutor(1) as beside,
    ):
        scratch = Path(folder)
        recording = _fetched(job, scratch)
        fetched = monotonic()
        # Beside the extraction, so that both read the same bytes from the disk once.
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
                # Python's tarfile takes four times as long for thousands of small images.
                # Blocks are 1 MiB.
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
    """Parses a row; returns None if the text is not one."""
    with suppress(ValueError):
        found = json.loads(text)
        return found if isinstance(found, dict) else None
    return None


def put(store: fsspec.AbstractFileSystem, file: Path, target: str) -> None:
    """Moves a file into a store, where it appears only when it is complete."""
    store.makedirs(store._parent(target), exist_ok=True)
    if isinstance(store, LocalFileSystem):
        part = f"{target}.{uuid.uuid4().hex}{PART}"
        shutil.move(file, part)
        os.replace(part, target)
    else:
        # Such stores show an object only when it is complete.
        store.put_file(str(file), target)


def _fetched(job: Job, scratch: Path) -> Path:
    """Returns the recording's folder on this node. A local one is used in place, as it is only
    read."""
    store, root = url_to_fs(job.source, **job.storage)
    folder = f"{root}/{job.name}"
    if isinstance(store, LocalFileSystem):
        return Path(folder)
    # The report names the recording by its folder.
    local = scratch / Path(job.name).name
    paths = [path for path, _, _ in job.files]
    store.get([f"{folder}/{path}" for path in paths], [str(local / path) for path in paths])
    return local


def _digest(recording: Path, job: Job) -> str:
    """Returns the SHA-256 of names and contents of all files."""
    whole = hashlib.sha256()
    for path, _, _ in sorted(job.files):
        one = hashlib.sha256()
        with open(recording / path, "rb") as file:
            while block := file.read(BLOCK):
                one.update(block)
        whole.update(f"{path}\0{one.hexdigest()}\n".encode())
    return whole.hexdigest()


def _run(job: Job, recording: Path, out: Path, log: Path) -> dict[str, Any]:
    """Runs the extraction, and returns its part of the row."""
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
    losses = [loss["what"] for loss in report.get("losses", [])]
    # The reason of every verdict but a good one.
    message = message or "; ".join(losses)
    if not message and verdict != "good":
        message = "the recording itself lacks something; `smartdepthsync verify` names it"
    with open(log, "ab") as messages:
        messages.write(message.encode())
    pairs, clock = report.get("pairs") or {}, report.get("clock") or {}
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
    """Returns the versions of program and firmware that made the recording."""
    session: dict[str, Any] = {}
    with suppress(OSError, json.JSONDecodeError):
        session = json.loads((recording / "session.json").read_text())
    return {
        "recorded_by": session.get("program"),
        "firmware": (session.get("board") or {}).get("firmware"),
    }
