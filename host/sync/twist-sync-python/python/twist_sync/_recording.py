"""What a file gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


class Unreadable(Exception):
    """A file gives no gyroscope; the message says what was expected and what to do."""


@dataclass(eq=False)
class Recording:
    """A gyroscope's recording.

    Attributes:
        path: The file or folder.
        form: What it is and which columns or topic were taken, in words.
        t: Times of the device's own clock, integer nanoseconds, shape (n,).
        w: Angular rates, rad/s, shape (n, 3).
        frames: Times of the frames of each video track by its name, integer nanoseconds.
        notes: What could not be read of it.
        topic: The topic that was taken, of files with topics.
    """

    path: Path
    form: str
    t: np.ndarray
    w: np.ndarray
    frames: dict[str, np.ndarray] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    topic: str | None = None
    unit_is_guess: bool = False
    layout: Any = None

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @property
    def seconds(self) -> float:
        """From the first sample to the last, s."""
        return float(self.t[-1] - self.t[0]) * 1e-9 if len(self.t) else 0.0

    def __repr__(self) -> str:
        return f"Recording({self.name!r}, {len(self.t)} samples, {self.seconds:.2f} s)"
