"""The relation of two clocks from two gyroscopes on one rigid body.

Convention: ``b = a + offset + skew * (a - reference)``, in seconds.

* :func:`read` and :func:`sync` take files, :func:`estimate` and :func:`course` take arrays.
* Times are floats in seconds, integers in nanoseconds, or ``datetime64``; results are of the
  same kind.
* ``clock.b_to_a(t_b)`` converts times of clock b to clock a, of any array or number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _twist_sync
from ._recording import Recording, Unreadable, mean_step

__version__: str = _twist_sync.version
__all__ = [
    "Clock",
    "Course",
    "Estimate",
    "Fault",
    "Gate",
    "LeftOut",
    "Network",
    "Recording",
    "Refused",
    "Report",
    "Step",
    "Unreadable",
    "course",
    "estimate",
    "read",
    "sync",
]

Floats = NDArray[np.float64]

#: Rms change of the relative rate of two clocks within one minute, ppm: two uncompensated crystals
#: at room temperature, with a margin; the crate's default.
WANDER_PPM = 0.05

#: Range of the distance between neighbouring samples of a gyroscope, s. Times beyond it are in
#: another unit.
_STEPS_S = (1e-6, 0.2)


def __getattr__(name: str) -> Any:
    # The modules that read files are loaded on first use.
    if name == "read":
        from .files import read

        return read
    if name in ("sync", "Network"):
        from . import network

        return getattr(network, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class _Value:
    """Base of values with array fields, which adds equality."""

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        return all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)

    __hash__ = None  # type: ignore[assignment]


class _Relation:
    """Conversion of times between two clocks, for all kinds of times."""

    def _offsets(self, a: Floats) -> Floats:
        raise NotImplementedError

    def _b_to_a(self, b: Floats) -> Floats:
        raise NotImplementedError

    def a_to_b(self, a: ArrayLike) -> Any:
        """Converts times of clock a to clock b: seconds (floats), nanoseconds (integers) or
        ``datetime64``, one or an array, to the same kind and shape.

        Raises:
            TypeError: They are of another kind.
        """
        return _moved(a, self._offsets)

    def b_to_a(self, b: ArrayLike) -> Any:
        """Converts times of clock b to clock a: seconds (floats), nanoseconds (integers) or
        ``datetime64``, one or an array, to the same kind and shape.

        Raises:
            TypeError: They are of another kind.
        """
        return _moved(b, lambda t: -self._offsets(self._b_to_a(t)))


def _times(t: ArrayLike) -> NDArray[Any]:
    """Returns times as float seconds or as int64 nanoseconds.

    Raises:
        TypeError: They are neither, nor ``datetime64``.
    """
    t = np.asarray(t)
    if t.dtype.kind == "M":
        return t.astype("M8[ns]").astype(np.int64)
    if t.dtype.kind in "iu":
        return t.astype(np.int64)
    if t.dtype.kind != "f":
        raise TypeError(
            f"times of type {t.dtype}; expected seconds (floats), nanoseconds (integers) or datetime64"
        )
    return t.astype(np.float64)


def _seconds(t: ArrayLike) -> Floats:
    """Returns times of any kind in seconds."""
    times = _times(t)
    return times * 1e-9 if times.dtype.kind == "i" else times


def _moved(t: ArrayLike, by_seconds: Callable[[Floats], Floats]) -> Any:
    times = _times(t)
    by = by_seconds(_seconds(times))
    if times.dtype.kind == "i":
        moved = times + np.round(by * 1e9).astype(np.int64)
        return (moved.astype("M8[ns]") if np.asarray(t).dtype.kind == "M" else moved)[()]
    return (times + by)[()]


@dataclass(frozen=True, eq=False, repr=False)
class Clock(_Value, _Relation):
    """The relation of two clocks with its uncertainty: ``b = a + offset + skew * (a - reference)``.

    Attributes:
        reference: Time of clock a at which the offset holds, s.
        offset: Clock b minus clock a at the reference, s.
        skew: Rate of clock b relative to clock a, minus one.
        covariance: Covariance of (offset, skew), shape (2, 2): s², s; s, 1.
        wander_ppm: Rms change of the clocks' relative rate within one minute, ppm: the sigmas grow
            by it away from the reference.

    :meth:`Course.at` with several times returns a clock whose fields are arrays, one row for
    each time.
    """

    reference: float
    offset: float
    skew: float
    covariance: Floats
    wander_ppm: float = WANDER_PPM

    @property
    def offset_sigma(self) -> Any:
        """1-sigma of the offset at the reference, s."""
        return np.sqrt(self.covariance[..., 0, 0])

    @property
    def skew_sigma(self) -> Any:
        """1-sigma of the skew."""
        return np.sqrt(self.covariance[..., 1, 1])

    def at(self, a: ArrayLike) -> Clock:
        """Moves the reference.

        Args:
            a: Time of clock a: seconds (floats), nanoseconds (integers) or ``datetime64``, one or
                an array.

        Returns:
            The same relation with its reference there, in seconds; of several times its fields are
            arrays. The covariance grows by the wander over the distance.

        Raises:
            TypeError: The times are of another kind.
        """
        a = _seconds(a)
        dt = a - self.reference
        span, diffusion = np.abs(dt), (self.wander_ppm * 1e-6) ** 2 / 60
        move = np.zeros((*dt.shape, 2, 2))
        move[..., 0, 0] = move[..., 1, 1] = 1
        move[..., 0, 1] = dt
        covariance = move @ self.covariance @ np.swapaxes(move, -1, -2)
        covariance[..., 0, 0] += diffusion * span**3 / 3
        covariance[..., 0, 1] += diffusion * span * dt / 2
        covariance[..., 1, 0] += diffusion * span * dt / 2
        covariance[..., 1, 1] += diffusion * span
        offset, skew = self.offset + self.skew * dt, self.skew + 0 * dt
        return Clock(a[()], offset, skew, covariance, self.wander_ppm)

    def _offsets(self, a: Floats) -> Floats:
        return self.offset + self.skew * (a - self.reference)

    def _b_to_a(self, b: Floats) -> Floats:
        return self.reference + (b - self.reference - self.offset) / (1 + self.skew)

    def __repr__(self) -> str:
        if np.ndim(self.offset):
            return f"Clock({np.size(self.offset)} times)"
        return (
            f"Clock(offset {self.offset:.6f} s ± {self.offset_sigma * 1e6:.2f} µs at {self.reference:.3f} s, "
            f"skew {self.skew * 1e6:+.2f} ± {self.skew_sigma * 1e6:.2f} ppm)"
        )


@dataclass(frozen=True)
class Fault:
    """A fault of a stream.

    Attributes:
        stream: "a" or "b".
        kind: Kind of fault, such as "gap", "clipped", "copied_sample", "timestamp_outlier".
        count: Number of affected samples; for a sawtooth of the timestamps, number of its jumps.
        period: Period in samples, if it recurs.
        displacement: Lateness of the timestamps against the content, s, if it has one.
        action: "left_out", "corrected" or "noted".
        samples: Indices of the affected samples.
    """

    stream: str
    kind: str
    count: int
    period: float | None
    displacement: float | None
    action: str
    samples: list[int]

    def __repr__(self) -> str:
        return f"Fault({self.stream}: {self.count} {self.kind}, {self.action})"


@dataclass(frozen=True)
class LeftOut:
    """A stretch of both recordings that was left out.

    Attributes:
        start: Begin, s from the first sample of a.
        end: End, s from the first sample of a.
        why: "apart" (not one body) or "time_step" (another offset of the clocks).
        text: Description in words.
    """

    start: float
    end: float
    why: str
    text: str


@dataclass(frozen=True)
class Gate:
    """A quality gate that an estimate must pass.

    Attributes:
        name: Short stable name, such as "unique_peak".
        passed: True if the value is within the limit.
        value: Measured value, in ``unit``.
        limit: Limit of the value, in ``unit``.
        unit: Unit of value and limit.
        text: Reason and figures in words.
    """

    name: str
    passed: bool
    value: float
    limit: float
    unit: str
    text: str


@dataclass(frozen=True, repr=False)
class Report:
    """The basis of an estimate or a refusal.

    Attributes:
        residual_rms: Rms of the in-band residual, rad/s.
        motion_rms: Rms of the motion, rad/s.
        overlap: Time in common that was used, s.
        together: Stretches in which the two moved as one body, s from the first sample of a.
        faults: Faults of both streams.
        left_out: Stretches that were left out.
        gates: All judged gates, passed or not.
        warnings: Limitations of an accepted estimate, in words.
    """

    residual_rms: float | None
    motion_rms: float | None
    overlap: float | None
    together: list[tuple[float, float]]
    faults: list[Fault]
    left_out: list[LeftOut]
    gates: list[Gate]
    warnings: list[str]

    def __repr__(self) -> str:
        passed = sum(gate.passed for gate in self.gates)
        return f"Report({passed} of {len(self.gates)} gates passed, {len(self.faults)} faults)"


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(_Value):
    """An accepted estimate.

    Attributes:
        clock: The relation of the clocks.
        calibration: Rotation, scale and cross-axis errors, shape (3, 3):
            rate of b = calibration @ rate of a + bias.
        bias: Difference of the biases in the axes of b, rad/s, shape (3,).
        report: Figures, faults and gates on which the estimate is based.
    """

    clock: Clock
    calibration: Floats
    bias: Floats
    report: Report

    # Those of the clock and of the report, by themselves.
    offset = property(lambda self: self.clock.offset, doc="Clock b minus clock a at the reference, s.")
    skew = property(lambda self: self.clock.skew, doc="Rate of clock b relative to clock a, minus one.")
    covariance = property(lambda self: self.clock.covariance, doc="Covariance of (offset, skew): s², s; s, 1.")
    reference = property(lambda self: self.clock.reference, doc="Time of clock a at which the offset holds, s.")
    faults = property(lambda self: self.report.faults, doc="Faults of both streams.")
    gates = property(lambda self: self.report.gates, doc="All gates; each is passed.")

    @property
    def rotation(self) -> Floats | None:
        """The rotation from the axes of a to those of b that is nearest to the calibration; None if
        the axes of one are mirrored."""
        return None if self.mirrored else _rotation(self.calibration)

    @property
    def mirrored(self) -> bool:
        """True if the axes of one are left-handed: two are exchanged or one has the wrong sign."""
        sizes = np.linalg.svd(self.calibration)[1]
        return bool(np.linalg.det(self.calibration) < 0 and sizes[2] > 0.5 * sizes[0])

    def _moved(self, a_s: float, between_s: float) -> Estimate:
        """Returns the same for clocks that read less: a by the first, the offset by the second."""
        moved = replace(self.clock, reference=self.clock.reference - a_s, offset=self.clock.offset - between_s)
        return replace(self, clock=moved)

    def _opened(self, by_s: float) -> Estimate:
        """Returns the same with this 1-sigma of the times in addition, s."""
        covariance = self.clock.covariance + np.diag([by_s**2, 0])
        return replace(self, clock=replace(self.clock, covariance=covariance))

    def __repr__(self) -> str:
        return f"Estimate({self.clock!r}, {self.report!r})"


def _rotation(matrix: Floats) -> Floats:
    u, _, vt = np.linalg.svd(matrix)
    sign = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
    return u @ sign @ vt


class Refused(Exception):
    """The recordings do not give a trustworthy relation; the message says why.

    Attributes:
        report: Figures and gates, at least one of which is not passed; None for a course.
    """

    def __init__(self, reason: str, report: Report | None = None):
        super().__init__(reason)
        self.report = report


def _clock(found: tuple[Any, ...], wander_ppm: float | None) -> Clock:
    *numbers, covariance = found
    return Clock(*numbers, np.array(covariance), _wander(wander_ppm))


def _wander(ppm: float | None) -> float:
    if ppm is None:
        return WANDER_PPM
    if not 0 <= ppm < float("inf"):
        raise ValueError(f"wander_ppm is {ppm}; expected 0 or more")
    return float(ppm)


def _report(found: tuple[Any, ...]) -> Report:
    *numbers, faults, left_out, gates, warnings = found
    return Report(
        *numbers,
        [Fault(*fault) for fault in faults],
        [LeftOut(*stretch) for stretch in left_out],
        [Gate(*gate) for gate in gates],
        warnings,
    )


def _stream(t: ArrayLike, w: ArrayLike, name: str) -> tuple[bytes, bytes, bool]:
    try:
        t, w = _times(t), np.asarray(w, dtype="<f8")
    except TypeError as error:
        raise ValueError(f"t_{name} or w_{name}: {error}") from None
    if t.ndim != 1 or w.shape != (len(t), 3):
        raise ValueError(
            f"t_{name} has shape {t.shape} and w_{name} {w.shape}; expected (n,) and (n, 3)"
        )
    nanos = t.dtype.kind == "i"
    if len(t) > 1:
        step = mean_step(t) * (1e-9 if nanos else 1.0)
        if step and not _STEPS_S[0] < step < _STEPS_S[1]:
            unit = "integers are nanoseconds" if nanos else "floats are seconds"
            raise ValueError(
                f"the samples of t_{name} would be {step:.3g} s apart, which no gyroscope's are: {unit}; "
                "convert other units, as t * 1e-3 of milliseconds"
            )
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
    exact_stamps: bool = False,
    wander_ppm: float | None = None,
    search: tuple[float, float] | None = None,
) -> Estimate:
    """Relates the clocks of two recordings of one twist.

    Args:
        t_a: Times of the first: seconds (floats), nanoseconds (integers) or datetime64, shape (n,).
        w_a: Its angular rates, rad/s, shape (n, 3).
        t_b: Times of the second.
        w_b: Its angular rates.
        a_delay: Delay of the low-pass filter of a, s.
        b_delay: Delay of the low-pass filter of b, s.
        sigma_limit: Largest 1-sigma of an accepted offset, s; by default 100e-6.
        low_pass_hz: -3 dB frequency of the zero-phase low-pass, 5 to 100 Hz; by default 25.
        min_overlap: Least time in common, s; by default 1.5.
        handle_faults: Find faults of the streams and leave them out.
        exact_stamps: Times that are whole multiples of a decimal step are exact. Otherwise they count
            as cut or rounded to it, and half a step is in the sigma.
        wander_ppm: Rms change of the clocks' relative rate within one minute, ppm; by default
            0.05. The sigmas of :meth:`Clock.at` grow by it.
        search: Expected offset b - a and half-width of the search, s; by default unlimited.

    Returns:
        The relation of the clocks, and what it is based on.

    Raises:
        Refused: There is no trustworthy relation; with the reasons and the report.
        ValueError: Arrays have other shapes or units, or a setting is out of its range.
    """
    settings = {k: v for k, v in locals().items() if k[:2] not in ("t_", "w_")}
    a, b = _stream(t_a, w_a, "a"), _stream(t_b, w_b, "b")
    _wander(wander_ppm)
    found, reasons, report = _twist_sync.estimate(a, b, settings)
    if found is None:
        raise Refused(reasons, _report(report))
    clock, calibration, bias = found
    return Estimate(_clock(clock, wander_ppm), np.array(calibration), np.array(bias), _report(report))


@dataclass(frozen=True)
class Step:
    """A step of one clock against the other.

    Attributes:
        start: Earliest time of the step, s of clock a.
        end: Latest time of the step, s of clock a.
        by: Change of the offset b - a, s.
        sigma: 1-sigma of the change, s.
    """

    start: float
    end: float
    by: float
    sigma: float


class Course(_Relation):
    """The relation of two clocks over whole recordings.

    Attributes:
        estimates: Estimates of the windows; one may be of several windows.
        windows: Number of windows of a.
        used: Number of estimates that make the course.
        contradicting: Number of estimates that were left out because they contradict the rest.
        refusals: Gates that refused windows, with the figures of the first refused window and the
            number of windows.
        steps: Steps of one clock against the other.
        unsupported: Stretches of clock a, s, without a relation or with a contradicting one; the
            sigma grows within them.
        warnings: Warnings of the estimates, with the number of estimates.
        span: First and last time of clock a with data, s.
        wander_ppm: Rms change of the clocks' relative rate within one minute, ppm.
    """

    def __init__(self, found: _twist_sync.Course, wander_ppm: float | None = None):
        self._found, self._open_s = found, 0.0
        self.wander_ppm = _wander(wander_ppm)
        estimates, counts, refusals, steps, unsupported, warnings, span = found.details()
        self.estimates: list[Clock] = [_clock(e, wander_ppm) for e in estimates]
        self.windows, self.used, self.contradicting = counts
        self.refusals: list[tuple[Gate, int]] = [(Gate(*g), n) for g, n in refusals]
        self.steps: list[Step] = [Step(*step) for step in steps]
        self.unsupported: list[tuple[float, float]] = unsupported
        self.warnings: list[tuple[str, int]] = warnings
        self.span: tuple[float, float] = span

    @property
    def refused(self) -> int:
        """Number of windows that are in no estimate."""
        return sum(count for _, count in self.refusals)

    def _opened(self, by_s: float) -> Course:
        self._open_s = by_s
        return self

    def _table(self, a: Floats) -> Floats:
        there = np.frombuffer(self._found.at(a.astype("<f8").tobytes()), "<f8").reshape(*a.shape, 5)
        return there + [0, 0, self._open_s**2, 0, 0]

    def at(self, a: ArrayLike) -> Clock:
        """Returns the relation at times of clock a.

        Args:
            a: Seconds (floats), nanoseconds (integers) or ``datetime64``, one or an array.

        Returns:
            The relation with its reference there, in seconds; of several times its fields are
            arrays.

        Raises:
            TypeError: The times are of another kind.
        """
        a = _seconds(a)
        offset, skew, oo, os, ss = np.moveaxis(self._table(a), -1, 0)
        covariance = np.moveaxis(np.array([[oo, os], [os, ss]]), (0, 1), (-2, -1))
        return Clock(a[()], offset[()], skew[()], covariance, self.wander_ppm)

    def offsets(self, a: ArrayLike) -> tuple[Floats, Floats]:
        """Returns the offset b - a and its 1-sigma, s, at times of clock a: seconds (floats),
        nanoseconds (integers) or ``datetime64``.

        Raises:
            TypeError: The times are of another kind.
        """
        there = self.at(a)
        return there.offset, there.offset_sigma  # type: ignore[return-value]

    def _offsets(self, a: Floats) -> Floats:
        return self._table(np.asarray(a))[..., 0]

    def _b_to_a(self, b: Floats) -> Floats:
        b = np.asarray(b)
        return np.frombuffer(self._found.b_to_a(b.astype("<f8").tobytes()), "<f8").reshape(b.shape)

    def __repr__(self) -> str:
        first, last = self.span
        return f"Course({first:.3f} to {last:.3f} s, {self.windows} windows, {self.used} estimates used, {len(self.steps)} steps)"


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
    exact_stamps: bool = False,
    wander_ppm: float | None = None,
    search: tuple[float, float] | None = None,
) -> Course:
    """Relates the clocks over whole recordings, by any motion in them.

    The arguments are those of :func:`estimate`. ``sigma_limit`` applies to each window of 10 s and
    is 1e-3 s by default; ``wander_ppm`` also joins the windows.

    Returns:
        The relation at every time of them.

    Raises:
        Refused: No part of the recordings can be related.
        ValueError: Arrays have other shapes or units, or a setting is out of its range.
    """
    settings = {k: v for k, v in locals().items() if k[:2] not in ("t_", "w_")}
    a, b = _stream(t_a, w_a, "a"), _stream(t_b, w_b, "b")
    _wander(wander_ppm)
    found, reason = _twist_sync.course(a, b, settings)
    if found is None:
        raise Refused(reason)
    return Course(found, wander_ppm)
