"""Reads the gyroscope of any recording; the first bytes of a file select its reader.

Text is read here; all else by a process of its own with limits, since bytes of a file reach
libraries that may hang, crash or take all memory.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from . import text
from ._recording import Recording, Unreadable

#: Longest time, s, and most memory, bytes, of a reader in another process.
LIMIT_S = 600
LIMIT_BYTES = 8 << 30
#: Text up to this size is read in this process, bytes.
SMALL_TEXT = 256 << 20

_CHILD = """import sys
sys.path[:] = filter(None, sys.path)
from twist_sync.files import _child
_child()"""

#: Files that a folder which is not a bag may contain, the best first.
_IN_FOLDERS = (
    ("recording.mcap",),
    ("Gyroscope.csv", "gyroscope.csv", "Gyroscope.txt"),
    ("imu0/data.csv", "mav0/imu0/data.csv"),
    ("*gyro.csv",),
    ("*.mcap", "*.mkv", "*.bag", "*.db3"),
    ("*.csv",),
    ("*.mp4", "*.insv"),
)


def _only(folder: Path) -> Path:
    if (folder / "data.csv").is_file() and folder.name.startswith("imu"):
        return folder / "data.csv"
    for patterns in _IN_FOLDERS:
        found = sorted({path for pattern in patterns for path in folder.glob(pattern)})
        if len(found) == 1:
            return found[0]
        if found:
            raise Unreadable(
                f"several recordings in the folder: {', '.join(p.name for p in found[:9])}; name one"
            )
    raise Unreadable(
        "a folder without a bag (metadata.yaml), MCAP, Matroska, video or Gyroscope.csv"
    )


def kind(path: Path) -> str:
    """Selects the reader of a file: text, npz, mcap, bag, matroska or video."""
    if path.is_dir():
        return "bag"
    with path.open("rb") as file:
        first = file.read(16)
    if first.startswith(b"\x89MCAP0\r\n"):
        return "mcap"
    if first.startswith((b"#ROSBAG V", b"SQLite format 3\0")):
        return "bag"
    if first.startswith(b"\x1a\x45\xdf\xa3"):
        return "matroska"
    if first.startswith(b"PK\x03\x04"):
        return "npz"
    logs = (b"\x06\x0e\x2b\x34", b"GYROFLOW IMU LOG", b"H Product:Blackb")
    if first[4:8] in (b"ftyp", b"wide", b"mdat", b"moov", b"RED1", b"RED2") or first.startswith(
        logs
    ):
        return "video"
    return "text"


def read(
    path: str | os.PathLike[str],
    *,
    topic: str | None = None,
    columns: list[str] | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
) -> Recording:
    """Reads the gyroscope of a recording.

    Args:
        path: A file or folder; ``FILE@TOPIC`` names one of several gyroscopes in it.
        topic: The topic by itself, if it is not part of ``path``.
        columns: Names, or numbers from 1, of the columns of time, x, y, z of a text file.
        unit: Unit of the rates of a text file: rad/s, mrad/s, deg/s, mdps or rpm.
        time_unit: Unit of the times of a text file: s, ms, us or ns.

    Returns:
        A :class:`Recording` with times in ns and rates in rad/s; ``form`` says what was found.

    Raises:
        Unreadable: The file gives no gyroscope, or several.
    """
    file = Path(path)
    if topic is None and not file.exists() and "@" in file.as_posix():
        name, _, topic = os.fspath(path).rpartition("@")
        # A topic begins with a slash, which is a separator of paths too.
        if not Path(name).exists() and "@" in name:
            name, _, more = name.partition("@")
            topic = f"{more}@{topic}"
        file = Path(name)
    try:
        if file.is_dir() and not (file / "metadata.yaml").is_file():
            file = _only(file)
        how = kind(file)
        if how == "text" and file.stat().st_size <= SMALL_TEXT:
            found = text.read(file, topic, columns, unit, time_unit)
        else:
            found = _in_process(file, how, [topic, columns, unit, time_unit])
    except OSError as error:
        raise Unreadable(f"{file}: {error.strerror or error}") from None
    except Unreadable as error:
        raise Unreadable(f"{file}: {error}") from None
    finite = np.isfinite(found.w).all(axis=1)
    if not finite.all():
        found.notes.append(f"{len(finite) - finite.sum()} samples are no numbers and are left out")
        found.t, found.w = found.t[finite], found.w[finite]
    if len(found.t) < 2:
        raise Unreadable(f"{file}: {found.form}: no samples of a gyroscope")
    return found


def _in_process(path: Path, how: str, more: list[Any]) -> Recording:
    arguments = json.dumps([os.fspath(path.absolute()), how, more, LIMIT_S, LIMIT_BYTES])
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        timeout=LIMIT_S + 60,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    if done.returncode == -signal.SIGINT:
        raise KeyboardInterrupt
    head, _, body = done.stdout.partition(b"\n")
    if done.returncode or not head:
        said = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        said = "".join(c for c in said if c.isprintable())[:200]
        raise Unreadable(
            f"its reader ended with {done.returncode} ({said or 'no word'}); it may take {LIMIT_S} s "
            f"and {LIMIT_BYTES / 2**30:.3g} GB of memory"
        )
    found = json.loads(head)
    if "error" in found:
        raise Unreadable(found["error"])
    arrays = io.BytesIO(body)
    t, w, *frames = (np.load(arrays, allow_pickle=False) for _ in range(2 + len(found["frames"])))
    layout = text.Layout(**found["layout"]) if found["layout"] else None
    of_frames = dict(zip(found["frames"], frames, strict=True))
    return Recording(
        path, found["form"], t, w, of_frames, found["notes"], found["topic"], found["guess"], layout
    )


def _child() -> None:
    path, how, more, seconds, memory = json.loads(sys.argv[1])
    # Libraries may print to the standard output.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    if os.name == "posix":
        import resource

        # The system ends it, even within a long call, and even if its parent has gone.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.alarm(seconds)
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        memory = memory if hard == resource.RLIM_INFINITY else min(memory, hard)
        resource.setrlimit(resource.RLIMIT_AS, (memory, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        found = _read_here(Path(path), how, *more)
        head = {
            "form": found.form,
            "notes": found.notes,
            "topic": found.topic,
            "frames": list(found.frames),
            "guess": found.unit_is_guess,
            "layout": vars(found.layout) if found.layout else None,
        }
        arrays = [found.t, found.w, *found.frames.values()]
    # A panic of Rust is no Exception.
    except BaseException as error:
        said = str(error) if isinstance(error, Unreadable) else f"{type(error).__name__}: {error}"
        head, arrays = {"error": "".join(c for c in said if c.isprintable())[:1000]}, []
    out.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        # Not to the pipe itself: numpy asks a file for its position.
        buffer = io.BytesIO()
        np.save(buffer, array)
        out.write(buffer.getbuffer())
    out.close()


def _read_here(
    path: Path,
    how: str,
    topic: str | None,
    columns: list[str] | None,
    unit: str | None,
    time_unit: str | None,
) -> Recording:
    if how in ("mcap", "bag"):
        from . import bags

        return bags.read(path, topic)
    if how == "matroska":
        from . import matroska

        return matroska.read(path)
    if how == "video":
        from . import video

        return video.read(path)
    if how == "npz":
        return _npz(path)
    return text.read(path, topic, columns, unit, time_unit)


def _npz(path: Path) -> Recording:
    with np.load(path, allow_pickle=False) as file:
        if not all(name.endswith(".npy") for name in file.zip.namelist()):
            raise Unreadable("an archive: unpack it and name its file or folder")
        arrays = {name: file[name] for name in file.files}
    tables = {
        k: a for k, a in arrays.items() if a.ndim == 2 and a.shape[1] == 3 and a.dtype.kind in "fiu"
    }
    named = [
        k
        for k in tables
        if k.lower() in ("w", "rates", "omega") or "gyr" in k.lower() or "ang" in k.lower()
    ]
    choice = named or list(tables)
    lines = [k for k, a in arrays.items() if a.ndim == 1 and a.dtype.kind in "fiuM"]
    if len(choice) != 1:
        there = ", ".join(f"{k} {a.shape}" for k, a in arrays.items())
        raise Unreadable(f"expected one array of rates of shape (n, 3), found {there[:300]}")
    rates = tables[choice[0]]
    times = [k for k in lines if len(arrays[k]) == len(rates)]
    times = [
        k for k in times if k.lower() == "t" or "time" in k.lower() or "stamp" in k.lower()
    ] or times
    if len(times) != 1 or len(rates) < 2:
        raise Unreadable(
            f"expected one array of times as long as {choice[0]} {rates.shape}, found {times}"
        )
    t = arrays[times[0]]
    if t.dtype.kind == "M":
        unit, nanos = "ns", t.astype("M8[ns]").astype(np.int64)
    else:
        unit = text.plausible_time(t)
        nanos = text.to_nanos(t, unit)
    rate_unit = text.plausible_rate(rates)
    return Recording(
        path,
        f"npz: times of {times[0]!r} in {unit} (by their distance), rates of {choice[0]!r} in {rate_unit} (by their size)",
        nanos,
        rates * text.RATE_UNITS[rate_unit],
        topic=times[0],
        unit_is_guess=True,
    )
