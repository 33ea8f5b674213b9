"""The recording that a file contains."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


class Unreadable(Exception):
    """A file without a readable gyroscope; the message says what was expected and what to do."""


def mean_step(t: np.ndarray) -> float:
    """Returns the mean distance of times, in their unit; wild stamps at either end do not count."""
    known = t[np.isfinite(t)].astype(np.float64)
    if len(known) < 2:
        return 0.0
    low, high = np.quantile(known, (0.1, 0.9))
    return float(high - low) / (0.8 * (len(known) - 1))


@dataclass(eq=False)
class Recording:
    """A gyroscope's recording.

    Attributes:
        path: The file or folder.
        form: Its format, and the columns or topic that were read, in words.
        t: Times of the device's own clock, integer nanoseconds, shape (n,).
        w: Angular rates, rad/s, shape (n, 3).
        frames: Times of the frames of each video track by the track's name, integer nanoseconds.
        notes: Remarks about parts that could not be read.
        topic: The topic that was read, for files with topics.
        unit_by: What says the unit of the rates, such as "given", "named" or "by their size".
        doubts: What nothing in the file settles, in words: warnings of each relation.
        member: Name of the file within an archive.
        open_s: 1-sigma of the times that nothing in the file settles, s.
    """

    path: Path
    form: str
    t: np.ndarray
    w: np.ndarray
    frames: dict[str, np.ndarray] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    topic: str | None = None
    unit_by: str = ""
    open_s: float = 0.0
    doubts: list[str] = field(default_factory=list)
    member: str = ""
    layout: Any = None

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @property
    def seconds(self) -> float:
        """Time from the first sample to the last, s."""
        return float(self.t[-1] - self.t[0]) * 1e-9 if len(self.t) else 0.0

    def __repr__(self) -> str:
        return f"Recording({self.name!r}, {len(self.t)} samples, {self.seconds:.2f} s)"
