"""The relation of two clocks from two gyroscopes on one rigid body.

Convention: ``b = a + offset + skew * (a - reference)``, in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _twist_sync

__all__ = [
    "Clock",
    "Course",
    "Estimate",
    "Fault",
    "Gate",
    "LeftOut",
    "Refused",
    "Report",
    "course",
    "estimate",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Clock:
    """The relation of the clocks with its uncertainty."""

    #: Time of clock a at which the offset holds, s.
    reference: float
    #: Clock b minus clock a at the reference, s.
    offset: float
    #: Rate of clock b relative to clock a, minus one.
    skew: float
    #: Covariance of (offset, skew): s², s; s, 1.
    covariance: Floats

    @property
    def offset_sigma(self) -> float:
        """1-sigma of the offset at the reference, s."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def skew_sigma(self) -> float:
        """1-sigma of the skew."""
        return float(np.sqrt(self.covariance[1, 1]))

    def a_to_b(self, a: ArrayLike) -> Floats:
        """Times of clock b at times of clock a, s."""
        a = np.asarray(a, dtype=np.float64)
        return a + (self.offset + self.skew * (a - self.reference))

    def b_to_a(self, b: ArrayLike) -> Floats:
        """Times of clock a at times of clock b, s."""
        b = np.asarray(b, dtype=np.float64)
        return self.reference + (b - self.reference - self.offset) / (1 + self.skew)


@dataclass(frozen=True)
class Fault:
    """What is wrong with a stream."""

    #: "a" or "b".
    stream: str
    kind: str
    #: Number of samples; of a sawtooth of the timestamps, of its jumps.
    count: int
    #: After how many samples it recurs.
    period: float | None
    #: By how much the timestamp is later than the content, s.
    displacement: float | None
    #: "left_out", "corrected" or "noted".
    action: str
    #: Indices of the samples.
    samples: list[int]


@dataclass(frozen=True)
class LeftOut:
    """A stretch of both recordings that was left out."""

    #: Begin and end, seconds from the first sample of a.
    start: float
    end: float
    #: "apart", "slipped" or "time_step".
    why: str
    text: str


@dataclass(frozen=True)
class Gate:
    """What an estimate must pass."""

    name: str
    passed: bool
    value: float
    limit: float
    unit: str
    text: str


@dataclass(frozen=True)
class Report:
    """What an estimate or a refusal is based on."""

    #: Rms of the residual in band, rad/s.
    residual_rms: float | None
    #: Rms of the motion, rad/s.
    motion_rms: float | None
    #: Time in common that was used, s.
    overlap: float | None
    #: Stretches in which the two moved as one body, seconds from the first sample of a.
    together: list[tuple[float, float]]
    faults: list[Fault]
    left_out: list[LeftOut]
    gates: list[Gate]
    warnings: list[str]


@dataclass(frozen=True)
class Estimate:
    """An accepted estimate."""

    clock: Clock
    #: Rate of b = calibration @ rate of a + bias: rotation, scale and cross-axis errors.
    calibration: Floats
    #: rad/s, in the axes of b.
    bias: Floats
    report: Report

    @property
    def offset(self) -> float:
        """Clock b minus clock a at the reference, s."""
        return self.clock.offset

    @property
    def skew(self) -> float:
        """Rate of clock b relative to clock a, minus one."""
        return self.clock.skew

    @property
    def covariance(self) -> Floats:
        """Of (offset, skew)."""
        return self.clock.covariance

    @property
    def reference(self) -> float:
        """Time of clock a at which the offset holds, s."""
        return self.clock.reference

    @property
    def faults(self) -> list[Fault]:
        """Of both streams."""
        return self.report.faults

    @property
    def gates(self) -> list[Gate]:
        """All of them; each is passed."""
        return self.report.gates

    @property
    def rotation(self) -> Floats:
        """The rotation from the axes of a to those of b that is nearest to the calibration."""
        u, _, vt = np.linalg.svd(self.calibration)
        sign = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
        return u @ sign @ vt


class Refused(Exception):
    """The recordings do not give a trustworthy relation; the message says why."""

    def __init__(self, reason: str, report: Report | None = None):
        super().__init__(reason)
        #: What was measured; at least one gate is not passed. None of a course.
        self.report = report


def _clock(found: dict[str, Any]) -> Clock:
    return Clock(**{**found, "covariance": np.array(found["covariance"])})


def _report(found: dict[str, Any]) -> Report:
    return Report(
        **{
            **found,
            "faults": [Fault(**fault) for fault in found["faults"]],
            "left_out": [LeftOut(**stretch) for stretch in found["left_out"]],
            "gates": [Gate(**gate) for gate in found["gates"]],
        }
    )


def _stream(t: ArrayLike, w: ArrayLike, name: str) -> tuple[bytes, bytes, bool]:
    t = np.asarray(t)
    w = np.asarray(w, dtype="<f8")
    if t.ndim != 1 or w.shape != (len(t), 3):
        raise ValueError(
            f"t_{name} has shape {t.shape} and w_{name} {w.shape}; expected (n,) and (n, 3)"
        )
    nanos = np.issubdtype(t.dtype, np.integer)
    return t.astype("<i8" if nanos else "<f8").tobytes(), w.tobytes(), bool(nanos)


def estimate(
    t_a: ArrayLike,
    w_a: ArrayLike,
    t_b: ArrayLike,
    w_b: ArrayLike,
    *,
    a_delay: float = 0.0,
    b_delay: float = 0.0,
    sigma_limit: float | None = None,
    low_pass_hz: float | None = None,
    min_overlap: float | None = None,
    handle_faults: bool = True,
    wander_ppm: float | None = None,
    search: tuple[float, float] | None = None,
) -> Estimate:
    """Relate the clocks of two recordings of one twist.

    ``t`` are times in seconds (floats) or nanoseconds (integers), ``w`` angular rates
    of shape (n, 3) in rad/s. ``a_delay`` and ``b_delay`` are the delays of the low-pass
    filters in seconds; ``search`` is the expected offset and the half-width to look in.
    What is None is the default of the crate.

    Raises :class:`Refused` with the reasons.
    """
    settings = {k: v for k, v in locals().items() if k[:2] not in ("t_", "w_")}
    a, b = _stream(t_a, w_a, "a"), _stream(t_b, w_b, "b")
    found, reasons, report = _twist_sync.estimate(a, b, settings)
    if found is None:
        raise Refused(reasons, _report(report))
    clock, calibration, bias = found
    return Estimate(_clock(clock), np.array(calibration), np.array(bias), _report(report))


class Course:
    """The relation of two clocks over whole recordings."""

    def __init__(self, found: Any):
        self._found = found
        #: The estimates of the windows.
        self.estimates: list[Clock] = [_clock(e) for e in found.estimates()]
        #: Windows of a that were looked at, used, and left out as contradicting the rest.
        self.windows: int = found.windows()
        self.used: int = found.used()
        self.contradicting: int = found.contradicting()
        #: First and last time of clock a with data, s.
        self.span: tuple[float, float] = found.span()

    def at(self, a: float) -> Clock:
        """The relation at a time of clock a, s."""
        return _clock(self._found.at([float(a)])[0])

    def offsets(self, a: ArrayLike) -> tuple[Floats, Floats]:
        """Offsets and their 1-sigma at times of clock a, s."""
        found = self._found.at(np.asarray(a, dtype=np.float64).tolist())
        sigmas = [e["covariance"][0][0] ** 0.5 for e in found]
        return np.array([e["offset"] for e in found]), np.array(sigmas)

    def b_to_a(self, b: Sequence[float] | Floats) -> Floats:
        """Times of clock a at times of clock b, s."""
        return np.array(self._found.b_to_a(np.asarray(b, dtype=np.float64).tolist()))


def course(
    t_a: ArrayLike,
    w_a: ArrayLike,
    t_b: ArrayLike,
    w_b: ArrayLike,
    *,
    a_delay: float = 0.0,
    b_delay: float = 0.0,
    sigma_limit: float | None = None,
    low_pass_hz: float | None = None,
    min_overlap: float | None = None,
    handle_faults: bool = True,
    wander_ppm: float | None = None,
    search: tuple[float, float] | None = None,
) -> Course:
    """Relate the clocks over whole recordings, by any motion in them.

    The arguments are those of :func:`estimate`; ``sigma_limit`` is of each window of 10 s.
    """
    settings = {k: v for k, v in locals().items() if k[:2] not in ("t_", "w_")}
    a, b = _stream(t_a, w_a, "a"), _stream(t_b, w_b, "b")
    found, reason = _twist_sync.course(a, b, settings)
    if found is None:
        raise Refused(reason)
    return Course(found)
