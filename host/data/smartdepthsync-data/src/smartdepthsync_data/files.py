"""Files of a data set: in a folder, or in the tar file that the fleet makes of it."""

from __future__ import annotations

import json
import tarfile
import zlib
from pathlib import Path, PurePosixPath

#: Longest file that is read at once, bytes. An hour of samples at 1 kHz takes a third of it.
MAX_LENGTH = 1 << 30

#: The file that lists size and checksum of every other.
CONTENTS = "contents.json"

#: Version of its form that is read.
VERSION = 1


class DatasetError(Exception):
    """A folder is not a readable data set. The message says why, and what to do."""


def is_below(name: str) -> bool:
    """Returns True if a path stays below the folder that it begins in."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


class Files:
    """Reads files by their path in a data set, and compares each with what was extracted. Can be
    pickled for the workers of a loader."""

    def __init__(self, path: Path):
        self.path = path
        self._places: dict[str, tuple[int, int]] | None = None
        if not path.is_dir():
            # Uncompressed, so each file can be read from its offset.
            with tarfile.open(path, "r:") as tar:
                members = [member for member in tar if member.isfile()]
            self._places = {m.name: (m.offset_data, m.size) for m in members}
        self._held: dict[str, tuple[int, int]] = {}
        contents = json.loads(self.read(CONTENTS))
        if contents["version"] != VERSION:
            raise DatasetError(
                f"{CONTENTS} in {path} has version {contents['version']}; this package reads {VERSION}: "
                "use the one of the program that extracted it"
            )
        held = contents["files"]
        self._held = {name: (int(one["bytes"]), int(one["checksum"])) for name, one in held.items()}
        self._compare()

    def _compare(self) -> None:
        """Compares tables and other short files with what was extracted, and the sizes of all. Images are
        compared when they are read."""
        for name, (size, _) in self._held.items():
            if name not in self:
                raise DatasetError(f"{name} is missing in {self.path}; extract it again")
            found = (self.path / name).stat().st_size if self._places is None else self._places[name][1]
            if found != size:
                raise self._changed(name)
            if not name.endswith((".png", ".jpg")):
                self.read(name)

    def _changed(self, name: str) -> DatasetError:
        return DatasetError(
            f"{name} in {self.path} has other bytes than when it was extracted; copy or extract it again"
        )

    def __contains__(self, name: str) -> bool:
        if not is_below(name):
            return False
        return (self.path / name).is_file() if self._places is None else name in self._places

    def read(self, name: str) -> bytes:
        """Returns the content of a regular file below the data set. Raises FileNotFoundError if there
        is none."""
        if name not in self:
            raise FileNotFoundError(f"{name} in {self.path}")
        at, size = (0, 0) if self._places is None else self._places[name]
        place = self.path / name if self._places is None else self.path
        size = place.stat().st_size if self._places is None else size
        if size > MAX_LENGTH:
            raise DatasetError(
                f"{name} in {self.path} has {size} bytes; files of a data set have up to {MAX_LENGTH}"
            )
        with open(place, "rb") as file:
            file.seek(at)
            content = file.read(size)
        # Only what the list is read from is not in it.
        held = self._held.get(name) if name != CONTENTS else (size, zlib.crc32(content))
        if held != (len(content), zlib.crc32(content)):
            raise self._changed(name)
        return content
