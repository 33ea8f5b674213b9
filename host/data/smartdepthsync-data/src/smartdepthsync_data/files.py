"""The files of a data set: a folder, or the tar file that the fleet makes of one."""

from __future__ import annotations

import tarfile
from pathlib import Path


class Files:
    """Reads files by their path in a data set. Can be pickled, for workers of a loader."""

    def __init__(self, path: Path):
        self.path = path
        self._places: dict[str, tuple[int, int]] | None = None
        if not path.is_dir():
            # Uncompressed: each file is read from its place.
            with tarfile.open(path, "r:") as tar:
                members = [member for member in tar if member.isfile()]
            self._places = {m.name: (m.offset_data, m.size) for m in members}

    def __contains__(self, name: str) -> bool:
        return (self.path / name).is_file() if self._places is None else name in self._places

    def read(self, name: str) -> bytes:
        """The content of a file; raises FileNotFoundError."""
        if self._places is None:
            return (self.path / name).read_bytes()
        if name not in self._places:
            raise FileNotFoundError(f"{name} in {self.path}")
        at, size = self._places[name]
        with open(self.path, "rb") as tar:
            tar.seek(at)
            return tar.read(size)
