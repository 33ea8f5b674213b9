"""Files of a data set: in a folder, or in the tar file that the fleet makes of it."""

from __future__ import annotations

import tarfile
from pathlib import Path


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
        return (self.path / name).is_file() if self._places is None else name in self._places

    def read(self, name: str) -> bytes:
        """Returns the content of a file. Raises FileNotFoundError if there is none."""
        if self._places is None:
            return (self.path / name).read_bytes()
        if name not in self._places:
            raise FileNotFoundError(f"{name} in {self.path}")
        at, size = self._places[name]
        with open(self.path, "rb") as tar:
            tar.seek(at)
            return tar.read(size)
