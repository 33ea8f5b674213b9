"""Reads the gyroscope of any recording; the first bytes of a file select its reader.

Text is read here; all else by a process of its own with limits, since bytes of a file reach
libraries that may hang, crash or take all memory.
"""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import json
import lzma
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from . import held, text
from ._recording import Recording, Unreadable, mean_step
from .tables import Asked
from .tables import read as read_tables

#: Longest time, s, and most memory, bytes, of a reader in another process; and those of a small
#: file, with what each of its bytes adds.
LIMIT_S, SMALL_S, S_A_BYTE = 600.0, 40.0, 2e-6
LIMIT_BYTES, SMALL_BYTES, BYTES_A_BYTE = 8 << 30, 256 << 20, 60
#: Most bytes that an archive may hold, unpacked; and those of a small one, with what each of its bytes
#: adds: text of numbers is packed to a tenth.
LARGEST, SMALL_LARGEST, LARGEST_A_BYTE = 4 << 30, 16 << 20, 30
#: Most samples of a small file, and those that each of its bytes adds.
SMALL_SAMPLES, SAMPLES_A_BYTE = 250_000, 1
#: Mean distance of samples that no gyroscope's exceeds, s.
LARGEST_STEP_S = 0.2
#: Text up to this size is read in this process, bytes.
SMALL_TEXT = 256 << 20

_CHILD = """import sys
sys.path[:] = filter(None, sys.path)
from twist_sync.files import _child
_child()"""

#: Files that a folder which is not a bag, or an archive, may contain, the best first.
_IN_FOLDERS = (
    ("recording.mcap",),
    ("*Gyroscope.csv", "*gyroscope.csv", "*Gyroscope.txt"),
    ("*imu0/data.csv",),
    ("*gyro*.csv", "*Gyro*.csv"),
    ("*.mcap", "*.mkv", "*.bag", "*.db3"),
    ("Raw Data.csv",),
    ("*.csv", "*.txt", "*.json", "*.npy", "*.npz", "*.csv.gz"),
    ("*.mp4", "*.insv", "*.MP4"),
)

#: Files that are packed alone, and the function that opens each.
PACKED = {"gzip": gzip.open, "bzip2": bz2.open, "xz": lzma.open}
#: Files that are refused, by their first bytes: what they are, and what to give.
_REFUSED = (
    (rb"\x89HDF\r\n", "a file of HDF5, which is not read: save its arrays as .npz, .mat (-v7) or CSV"),
    (rb"PAR1|ARROW1", "a table of Parquet or Arrow, which is not read: save it as CSV"),
    (rb"\xd0\xcf\x11\xe0", "an old spreadsheet (.xls), which is not read: save it as CSV or .xlsx"),
    (rb"TDSm|XDF:|VisionRe", "a recording of LabVIEW (TDMS), LSL (XDF) or Aria (VRS), which is not read: export it as CSV"),
    (rb"[\x02-\x06]\x50", "a file of C3D, which is not read: export its bodies as CSV"),
    (rb"7z\xbc\xaf|\x28\xb5\x2f\xfd|Rar!|.{257}ustar", "an archive that is not unpacked: unpack it, or use zip or gzip"),
    (rb"\s*<", "XML or HTML, which is not read: export it as CSV"),
    (rb"%PDF|\xff\xd8\xff|\x89PNG|\x80\x04\x95", "a document, a picture or a pickle: give a recording"),
    (rb"version https://git-lfs", "a pointer of Git LFS in place of the file: fetch it with git lfs pull"),
)

#: Kinds of files by their first bytes, else by the end of their names; others are text.
_BY_BYTES = (
    ("mcap", rb"\x89MCAP0\r\n"),
    ("bag", rb"#ROSBAG V|SQLite format 3\0"),
    ("yaml", rb"(---\s+)?header: *\r?\n"),
    ("matroska", rb"\x1a\x45\xdf\xa3"),
    ("video", rb"....(ftyp|wide|mdat|moov|RED1|RED2)|\x06\x0e\x2b\x34|H Product:Blackb"),
    ("npy", rb"\x93NUMPY"),
    *zip(PACKED, (rb"\x1f\x8b", rb"BZh[1-9]", rb"\xfd7zXZ\0"), strict=True),
    ("ulg", rb"ULog\x01\x12\x35"),
    ("ardupilot", rb"\xa3\x95\x80|FMT, "),
    ("gpmf", rb"DEVC\0"),
    ("mat", rb"MATLAB [57]\.\d MAT-file"),
    ("json", rb"(\xef\xbb\xbf)?\s*(\{|\[\s*[\[{])"),
)


def _best(names: list[str], of: str) -> str:
    """Returns the one of a folder's or an archive's files that is its recording."""
    for patterns in _IN_FOLDERS:
        found = sorted({n for p in patterns for n in names if Path(n).match(p)})
        if len(found) == 1:
            return found[0]
        if found:
            raise Unreadable(f"several recordings in the {of}: {', '.join(found[:9])}; name one")
    raise Unreadable(f"a{'n' * (of[0] == 'a')} {of} without a bag (metadata.yaml), MCAP, Matroska, video or Gyroscope.csv")


def _only(folder: Path) -> Path:
    if (folder / "data.csv").is_file() and folder.name.startswith("imu"):
        return folder / "data.csv"
    deep = [p for p in (folder / "imu0/data.csv", folder / "mav0/imu0/data.csv") if p.is_file()]
    names = [str(p.relative_to(folder)) for p in [*folder.iterdir(), *deep] if p.is_file()]
    return folder / _best(names, "folder")


def kind(path: Path) -> str:
    """Selects the reader of a file by its first bytes."""
    if path.is_dir():
        return "bag"
    # A pipe would be waited for, and cannot be read twice.
    if path.exists() and not path.is_file():
        raise Unreadable("not a regular file: write it into one first")
    with path.open("rb") as file:
        first = file.read(512)
    if said := next((said for form, said in _REFUSED if re.match(form, first, re.DOTALL)), None):
        raise Unreadable(said)
    if first.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
        if "xl/workbook.xml" in names:
            return "xlsx"
        if "content.xml" in names:
            raise Unreadable("a spreadsheet of OpenDocument, which is not read: save it as CSV or .xlsx")
        return "npz" if all(name.endswith(".npy") for name in names) else "zip"
    return next((k for k, form in _BY_BYTES if re.match(form, first, re.DOTALL)), "text")


def unpacked(file: Path, how: str, topic: str | None, folder: Path) -> tuple[Path, str]:
    """Unpacks the recording of an archive, or the one that `topic` names; returns its file, and
    its name in the archive."""
    folder.mkdir(exist_ok=True)
    source: Any = None
    if how in PACKED:
        name, source = re.sub(r"\.(gz|bz2|xz)$", "", file.name), PACKED[how](file)
    else:
        archive = zipfile.ZipFile(file)
        names = [n for n in archive.namelist() if not n.endswith("/") and "__MACOSX" not in n]
        named = [n for n in names if topic and topic.lower() in (n.lower(), Path(n).stem.lower(), Path(n).name.lower())]
        name = named[0] if len(named) == 1 else _best(names, "archive")
        source = archive.open(name)
    out = folder / Path(name).name
    most = min(LARGEST, SMALL_LARGEST + LARGEST_A_BYTE * file.stat().st_size)
    with source, out.open("wb") as copy:
        while block := source.read(1 << 20):
            copy.write(block)
            if copy.tell() > most:
                raise Unreadable(f"an archive that holds more than {most >> 20} MiB: unpack it")
    return out, name


def read(
    path: str | os.PathLike[str],
    *,
    topic: str | None = None,
    columns: list[str] | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
    rate: float | None = None,
) -> Recording:
    """Reads the gyroscope of a recording, or the orientation of one that has none.

    Args:
        path: A file or folder; ``FILE@NAME`` names one of several gyroscopes in it, a file of an
            archive, or ``part 2`` of a file whose clock started again.
        topic: The name by itself, if it is not part of ``path``.
        columns: Names, or numbers from 1, of the columns of time and x, y, z; of time and w, x,
            y, z; or of time and a matrix. Time may be SECONDS+NANOSECONDS, or - with ``rate``.
        unit: Unit of the rates: rad/s, mrad/s, deg/s, mdps or rpm, after a factor if need be, as
            0.061deg/s; of angles deg or rad with the order of their axes, as deg:ZYX; or
            world-to-body for quaternions of that direction.
        time_unit: Unit of the times: s, ms, us or ns, after a factor if need be, as 30.5us.
        rate: Samples a second, Hz, of a file whose times are a counter or none.

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
        with tempfile.TemporaryDirectory() as folder:
            own, how = file, kind(file)
            member = ""
            while how in (*PACKED, "zip"):
                own, name = unpacked(own, how, topic, Path(folder))
                member = name if not member else "?"
                if topic and topic.lower() in (name.lower(), Path(name).stem.lower(), Path(name).name.lower()):
                    topic = None
                how = kind(own)
            asked = Asked(topic, columns, unit, time_unit, rate)
            if how == "text" and own.stat().st_size <= SMALL_TEXT:
                found = _read_here(own, how, asked)
            else:
                found = _in_process(own, how, asked)
        if own != file:
            found.notes.insert(0, f"unpacked: {own.name}")
        found.path, found.member = file, member
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, lzma.LZMAError) as error:
        raise Unreadable(f"{file}: {getattr(error, 'strerror', None) or error}") from None
    except Unreadable as error:
        raise Unreadable(f"{file}: {error}") from None
    # Of bytes that no reader expects.
    except (ValueError, LookupError, ArithmeticError, RuntimeError, MemoryError, subprocess.TimeoutExpired) as error:
        raise Unreadable(f"{file}: cannot be read: {type(error).__name__}: {error}") from None
    finite = np.isfinite(found.w).all(axis=1)
    if not finite.all():
        found.notes.append(f"{len(finite) - finite.sum()} samples are no numbers and are left out")
        found.t, found.w = found.t[finite], found.w[finite]
    if len(found.t) < 2:
        raise Unreadable(f"{file}: {found.form}: no samples of a gyroscope")
    step = mean_step(found.t) * 1e-9
    if not 0 < step < LARGEST_STEP_S:
        raise Unreadable(
            f"{file}: {found.form}: its samples are {step:.3g} s apart, which no gyroscope's are: give "
            "--columns and --time-unit, or --rate"
        )
    if own_samples := held.samples(found.t, found.w):
        found.t, found.w = own_samples.t, found.w[own_samples.rows]
        found.open_s = own_samples.open_s
        (found.doubts if own_samples.is_doubtful else found.notes).append(own_samples.note)
    return found


def _size(path: Path) -> int:
    """Returns the length of a file, or of all files of a folder, bytes."""
    return sum(one.stat().st_size for one in (path.rglob("*") if path.is_dir() else [path]) if one.is_file())


def _in_process(path: Path, how: str, asked: Asked) -> Recording:
    size = _size(path)
    seconds = math.ceil(min(LIMIT_S, SMALL_S + S_A_BYTE * size))
    memory = min(LIMIT_BYTES, SMALL_BYTES + BYTES_A_BYTE * size)
    samples = SMALL_SAMPLES + SAMPLES_A_BYTE * size
    arguments = json.dumps([os.fspath(path.absolute()), how, vars(asked), seconds, memory, samples])
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        timeout=seconds + 20,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    if done.returncode == -signal.SIGINT:
        raise KeyboardInterrupt
    head, _, body = done.stdout.partition(b"\n")
    if done.returncode or not head:
        said = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        said = "".join(c for c in said if c.isprintable())[:200]
        raise Unreadable(
            f"its reader ended with {done.returncode} ({said or 'no word'}); it may take {seconds} s "
            f"and {memory / 2**30:.3g} GiB of memory for a file of {size} bytes"
        )
    found = json.loads(head)
    if "error" in found:
        raise Unreadable(found["error"])
    arrays = io.BytesIO(body)
    t, w, *frames = (np.load(arrays, allow_pickle=False) for _ in range(2 + len(found["frames"])))
    of_frames = dict(zip(found.pop("frames"), frames, strict=True))
    return Recording(path, t=t, w=w, frames=of_frames, **found)


def _child() -> None:
    path, how, asked, seconds, memory, samples = json.loads(sys.argv[1])
    # Libraries may print to the standard output.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    if os.name == "posix":
        import resource

        # The system ends it, even within a long call, and even if its parent has gone.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.alarm(seconds)
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        memory = memory if hard == resource.RLIM_INFINITY else min(memory, hard)
        # Of what is allocated: libraries and threads map far more than they use. macOS refuses some limits.
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_DATA, (memory, hard))
    try:
        found = _read_here(Path(path), how, Asked(**asked))
        if len(found.t) > samples:
            raise Unreadable(f"{len(found.t)} samples; a file of its size holds up to {samples}: unpack it")
        head = {name: getattr(found, name) for name in ("form", "notes", "topic", "unit_by", "layout")}
        head["frames"] = list(found.frames)
        arrays = [found.t, found.w, *found.frames.values()]
    # A panic of Rust is no Exception.
    except BaseException as error:
        said = str(error) if isinstance(error, Unreadable) else f"{type(error).__name__}: {error}"
        if isinstance(error, MemoryError):
            said = f"more than {memory / 2**30:.3g} GiB of memory would be needed for it"
        head, arrays = {"error": "".join(c for c in said if c.isprintable())[:1000]}, []
    out.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        # Not to the pipe itself: numpy asks a file for its position.
        buffer = io.BytesIO()
        np.save(buffer, array)
        out.write(buffer.getbuffer())
    out.close()


def _read_here(path: Path, how: str, asked: Asked) -> Recording:
    if how in ("mcap", "bag"):
        from . import bags

        return bags.read(path, asked)
    if how == "matroska":
        from . import matroska

        return matroska.read(path)
    if how == "video":
        from . import video

        return video.read(path)
    notes: list[str] = []
    if how == "text":
        form, found = text.read_tables(path, notes)
    else:
        from . import containers

        form, found = containers.READERS[how](path)
    return read_tables(found, path, form, asked, notes)
