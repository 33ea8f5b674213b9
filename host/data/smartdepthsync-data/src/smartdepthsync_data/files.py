"""Files of a data set: in a folder, or in the tar file that the fleet makes of it."""

from __future__ import annotations

import tarfile
from pathlib import Path, PurePosixPath

#: Longest file that is read at once, bytes. An hour of samples at 1 kHz takes a third of it.
MAX_LENGTH = 1 << 30


class DatasetError(Exception):
    """A folder is not a readable data set. The message says why, and what to do."""


def is_below(name: str) -> bool:
    """Returns True if a path stays below the folder that it begins in."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


class Files:
    """Reads files by their path in a data set. Can be pickled for the workers of a loader."""

    def __init__(self, path: Path):
        self.path = path
        self._places: dict[str, tuple[int, int]] | None = None
        if not path.is_dir():
            # Uncompressed, so each file can be read from its offset.
            with tarfile.open(path, "r:") as tar:
                members = [member for member in tar if member.isfile()]
            self._places = {m.name: (m.offset_data, m.size) for m in members}

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
            return file.read(size)
