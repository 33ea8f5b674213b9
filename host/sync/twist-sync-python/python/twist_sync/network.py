"""Two or more recordings on one clock.

Of ``n`` recordings each pair is related, and any three form a loop: from the first to the second,
on to the third and back one must arrive where one started. By how much one does not is the loop's
closure. At a time of the first recording the offsets are the least squares over all pairs, each
weighted by its variance. The sigma of each is that of the best chain of pairs from the first, not
that of the least squares: pairs share recordings, so their errors are not independent.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import Clock, Course, Estimate, Floats, Refused, Report, _Relation, course, estimate, files
from ._recording import Recording, Unreadable
from .tables import BY_SIZE, NAMELESS, typical_rate

#: Largest error over sigma, rms, of a loop that counts as closed. Three devices alone have one
#: loop, and a Gaussian is beyond three sigmas once in 370.
OPEN_SIGMAS = 3.0
#: Number of times in a recording at which loops and clocks are evaluated.
LOOKS = 61

#: Longest recording that is treated as one twist, s, and longest other recording beside it, s.
LONGEST_TWIST_S = 60.0
LONGEST_WITH_TWIST_S = 600.0


@dataclass(frozen=True)
class Pair:
    """Two of the recordings.

    Attributes:
        a: Number of the first, from 0.
        b: Number of the second.
        found: Their relation, with times in s from the first sample of each; None if refused.
        refused: The refusal, if there is no relation.
        doubts: What in the files may be the cause of a refusal, in words.
    """

    a: int
    b: int
    found: Estimate | Course | None
    refused: Refused | None
    doubts: list[str] = field(default_factory=list)

    @property
    def relation(self) -> Clock | Course:
        """Relation of the clocks, with times in s from the first sample of each."""
        if self.found is None:
            raise self.refused or Refused("no relation")
        return self.found.clock if isinstance(self.found, Estimate) else self.found

    @property
    def report(self) -> Report | None:
        """Report of a twist or its refusal; None for whole recordings."""
        if isinstance(self.found, Estimate):
            return self.found.report
        return self.refused.report if self.refused else None


class Network:
    """The clocks of several devices against that of the first, number 0.

    Args:
        devices: Number of devices.
        pairs: Relations of devices a < b by their numbers.

    Raises:
        Refused: No chain of relations leads from the first to one of them, or a loop is open by
            more than :data:`OPEN_SIGMAS`; the message names the pairs that can break it.
    """

    def __init__(self, devices: int, pairs: dict[tuple[int, int], Clock | Course]):
        self.devices = devices
        self.pairs = pairs
        joined = {0}
        for _ in range(devices):
            joined |= {k for pair in pairs if joined & set(pair) for k in pair}
        if apart := [str(k + 1) for k in range(devices) if k not in joined]:
            raise Refused(
                f"no chain of relations leads from the first recording to number {', '.join(apart)}"
            )
        self._check_loops()

    def _informed(self, pair: tuple[int, int]) -> Floats:
        """Returns times of the first device at which a relation has data."""
        relation = self.pairs[pair]
        if isinstance(relation, Course):
            own = np.linspace(*relation.span, LOOKS)
        else:
            own = np.atleast_1d(np.asarray(relation.reference, dtype=np.float64))
        first = own
        # The offset changes by the skew, at most 1e-3, times the error before.
        for _ in range(4):
            first = own - self._chains(first)[0][pair[0]]
        return first

    def _check_loops(self) -> None:
        """Refuses a network with an open loop. The sigma of a loop is at most that of three
        independent pairs, since what belongs to one recording cancels in it."""
        worst, closed = {}, set()
        if len(self.pairs) < self.devices:
            return
        informed = {pair: self._informed(pair) for pair in self.pairs}
        for i, j, k in itertools.combinations(range(self.devices), 3):
            loop = ((i, j), (j, k), (i, k))
            if not set(loop) <= self.pairs.keys():
                continue
            looks = np.concatenate([informed[pair] for pair in loop])
            error, sigma = self._closure((i, j, k), looks)
            if np.sqrt(np.mean((error / sigma) ** 2)) <= OPEN_SIGMAS:
                closed |= set(loop)
            else:
                most = np.argmax(np.abs(error / sigma))
                worst[loop] = (abs(error[most]), sigma[most])
        if not worst:
            return
        loop, (error, sigma) = max(worst.items(), key=lambda own: own[1][0] / own[1][1])
        names = ", ".join(str(k + 1) for k in sorted({k for pair in loop for k in pair}))
        breakers = _breakers(list(worst), closed)
        if len(breakers) == 1:
            text = " and ".join(f"{i + 1}–{j + 1}" for i, j in breakers[0])
            one = len(breakers[0]) == 1
            why = f"the relation{'' if one else 's'} of {text} {'breaks it' if one else 'break them'}"
        else:
            pairs = sorted({pair for own in worst for pair in own})
            each = ", ".join(f"{i + 1}–{j + 1}" for i, j in pairs)
            why = f"one or more of the relations {each} are wrong, and the loops do not say which"
        raise Refused(
            f"{len(worst)} loops are open, the worst that of recordings {names}: by "
            f"{error * 1e6:.1f} µs, where its sigmas say {sigma * 1e6:.1f} µs; {why}"
        )

    def _chains(self, a: Floats) -> tuple[Floats, Floats]:
        """Finds the chain of pairs with the least variance to each device (Bellman and Ford);
        returns offsets and variances along it."""
        value = np.zeros((self.devices, len(a)))
        variance = np.full_like(value, np.inf)
        variance[0] = 0
        for _ in range(1, self.devices):
            for (i, j), relation in self.pairs.items():
                for start, end, sign in ((i, j, 1), (j, i, -1)):
                    if end == 0 or not np.isfinite(variance[start]).any():
                        continue
                    t = a + value[start]
                    there = relation.at(t if sign > 0 else relation._b_to_a(t))
                    of_end = variance[start] + there.covariance[..., 0, 0]
                    better = of_end < variance[end]
                    value[end] = np.where(better, value[start] + sign * there.offset, value[end])
                    variance[end] = np.where(better, of_end, variance[end])
        return value, variance

    def offsets(self, a: ArrayLike) -> tuple[Floats, Floats]:
        """Returns the clock of each device minus that of the first, s, and its 1-sigma, s, at
        times of the first, s: arrays of shape (devices, n)."""
        a = np.atleast_1d(np.asarray(a, dtype=np.float64))
        value, variance = self._chains(a)
        if len(self.pairs) >= self.devices:
            normal = np.zeros((len(a), self.devices, self.devices))
            right = np.zeros((len(a), self.devices))
            for (i, j), relation in self.pairs.items():
                there = relation.at(a + value[i])
                weight = 1 / np.maximum(there.covariance[..., 0, 0], 1e-300)
                # The pair's offset relative to the chains', so that no digits are lost.
                more = weight * (there.offset - (value[j] - value[i]))
                normal[:, i, i] += weight
                normal[:, j, j] += weight
                normal[:, i, j] -= weight
                normal[:, j, i] -= weight
                right[:, i] -= more
                right[:, j] += more
            value[1:] += np.linalg.solve(normal[:, 1:, 1:], right[:, 1:, None])[..., 0].T
        return value, np.sqrt(variance)

    def closures(self, a: ArrayLike) -> dict[tuple[int, int, int], tuple[Floats, Floats]]:
        """Returns, for each three devices whose pairs are all related, the error by which the
        loop fails to close at times of the first, s, and its 1-sigma from the pairs, s."""
        a = np.atleast_1d(np.asarray(a, dtype=np.float64))
        value, _ = self.offsets(a)
        out = {}
        for i, j, k in itertools.combinations(range(self.devices), 3):
            if not {(i, j), (j, k), (i, k)} <= self.pairs.keys():
                continue
            out[i, j, k] = self._closure((i, j, k), a, value)
        return out

    def _closure(
        self, of: tuple[int, int, int], a: Floats, value: Floats | None = None
    ) -> tuple[Floats, Floats]:
        i, j, k = of
        value = self.offsets(a)[0] if value is None else value
        each = [self.pairs[p].at(a + value[p[0]]) for p in ((i, j), (j, k), (i, k))]
        error = each[0].offset + each[1].offset - each[2].offset
        return error, np.sqrt(sum(r.covariance[..., 0, 0] for r in each))


def _breakers(
    worst: list[tuple[tuple[int, int], ...]], closed: set[tuple[int, int]]
) -> list[tuple[tuple[int, int], ...]]:
    """Returns the smallest sets of pairs, of one or two, without which no loop is open; a pair of
    a closed loop is in none."""
    suspects = sorted({pair for loop in worst for pair in loop} - closed)
    for size in (1, 2):
        sets = itertools.combinations(suspects, size)
        if found := [own for own in sets if all(set(own) & set(loop) for loop in worst)]:
            return found
    return []


class DeviceClock(_Relation):
    """The clock of a recording, b, against that of the first one, a."""

    def __init__(self, network: Network, device: int, first_ns: tuple[int, int]):
        self._network = network
        self._device = device
        self._first_ns = first_ns

    def _offsets(self, a: Floats) -> Floats:
        a = np.asarray(a)
        return self._network.offsets(a.ravel())[0][self._device].reshape(a.shape)

    def _b_to_a(self, b: Floats) -> Floats:
        if self._network.devices == 2:
            return self._network.pairs[0, 1]._b_to_a(b)
        # The offset changes by the skew, at most 1e-3, times the error before.
        a = b
        for _ in range(4):
            a = b - self._offsets(a)
        return a

    def offset(self, a: ArrayLike) -> tuple[Floats, Floats]:
        """Returns the offset b - a and its 1-sigma, s, at times of clock a in integer ns."""
        local = (np.atleast_1d(np.asarray(a, dtype=np.int64)) - self._first_ns[0]) * 1e-9
        value, sigma = self._network.offsets(local)
        return value[self._device] + (self._first_ns[1] - self._first_ns[0]) * 1e-9, sigma[
            self._device
        ]

    def _exact(self, t: ArrayLike, to_b: bool) -> Any:
        """Converts by times from the first sample of each, so that no digits are lost."""
        t = np.asarray(t)
        if t.dtype.kind == "M":
            return self._exact(t.astype("M8[ns]").astype(np.int64), to_b).astype("M8[ns]")
        if t.dtype.kind in "iu":
            own, other = self._first_ns if to_b else self._first_ns[::-1]
            local = t.astype(np.int64) - own
            moved = super().a_to_b(local) if to_b else super().b_to_a(local)
            return moved + other
        nanos = np.round(t * 1e9).astype(np.int64)
        return t + (self._exact(nanos, to_b) - nanos) * 1e-9

    def a_to_b(self, a: ArrayLike) -> Any:
        return self._exact(a, True)

    def b_to_a(self, b: ArrayLike) -> Any:
        return self._exact(b, False)


@dataclass(frozen=True)
class Synchronized:
    """Recordings on one clock.

    Attributes:
        recordings: The recordings as they were read.
        pairs: All pairs of them.
        network: The solution that fits all; None if it is refused.
        refused: The refusal, if there is no solution.
    """

    recordings: list[Recording]
    pairs: list[Pair]
    network: Network | None
    refused: Refused | None

    def clock(self, number: int) -> DeviceClock:
        """Returns the clock of a recording (counted from 0) as b, against that of the first as
        a."""
        if self.network is None:
            of_pairs = (f"{self.recordings[p.a].name} and {self.recordings[p.b].name}: {p.refused}" for p in self.pairs if p.refused)
            raise Refused("; ".join([str(self.refused), *of_pairs]))
        first = self.recordings[0].t, self.recordings[number].t
        return DeviceClock(self.network, number, (int(first[0][0]), int(first[1][0])))


#: Ratios of units that are taken for each other.
_RATIOS = {"rad/s and deg/s": 180 / np.pi, "deg/s and mdps": 1e3, "rad/s and mdps": 180e3 / np.pi}


def _in_one_unit(recordings: list[Recording]) -> list[Recording]:
    """Corrects rates in a wrong unit, where no unit is named: gyroscopes on one body turn at the
    same rate, so a ratio near 57 or 1000 is one of units."""
    typical = [typical_rate(r.w) for r in recordings]
    known = [t for t, r in zip(typical, recordings, strict=True) if r.unit_by != BY_SIZE] or [min(typical)]
    out = []
    for own, recording in zip(typical, recordings, strict=True):
        factors = [f for f in _RATIOS.values() if 0.5 < own / max(known[0], 1e-9) / f < 2]
        if factors and recording.unit_by == BY_SIZE:
            note = f"its rates are {own / known[0]:.0f} times those of the others: divided by {factors[0]:.5g}"
            recording = replace(recording, w=recording.w / factors[0], notes=[*recording.notes, note])
        out.append(recording)
    return out


def _doubts(a: Recording, b: Recording, refused: Refused) -> list[str]:
    """Returns what makes a relation of two recordings fail before the estimator sees it, as a user
    can change it: units that cannot be, coarse times, values that are held."""
    out = []
    rates = [typical_rate(r.w) for r in (a, b)]
    fast, slow = (a, b) if rates[0] > rates[1] else (b, a)
    for units, ratio in _RATIOS.items():
        if min(rates) > 0 and 0.7 < max(rates) / min(rates) / ratio < 1.4:
            said = " and ".join(f"{r.name} ({r.unit_by or 'by its format'})" for r in (fast, slow))
            out.append(
                f"{fast.name} turns {max(rates) / min(rates):.0f} times as fast as {slow.name}, as if {units} were "
                f"taken for each other, so the unit of {said} is doubted; give it with --unit"
            )
    failed = [gate.name for gate in refused.report.gates if not gate.passed] if refused.report else ["sigma"]
    for r, rate in zip((a, b), rates, strict=True) if "motion" in failed else ():
        if r.unit_by == "given":
            out.append(
                f"{r.name} hardly turns, by {rate:.2g} rad/s in the unit that was given, so that unit is doubted; "
                "give it with --unit"
            )
    if {"explained", "unique_peak", "residual"} & set(failed):
        for r in (a, b):
            if NAMELESS in r.form and (named := re.search(r"rates of ('.*?') in ", r.form)):
                out.append(f"nothing says that {named[1]} of {r.name} are rates; give the gyroscope's columns with --columns TIME,X,Y,Z")
    for r in (a, b) if "sigma" in failed else ():
        if max(step := _step(r.t), r.open_s * 1e9) > 150_000:
            why, remedy = f"the times of {r.name} have steps of {step * 1e-6:.3g} ms", "with more digits"
            if step < r.open_s * 1e9:
                why, remedy = f"the values of {r.name} are held", "with each sample once"
            sigma_us = max(step / 2e3, r.open_s * 1e6)
            out.append(
                f"{why}, which leaves {sigma_us:.0f} µs (1 sigma) open; export it {remedy}, or accept it with "
                f"--max-sigma-us {1.2 * sigma_us:.0f}"
            )
    return out


def _step(t: np.ndarray) -> int:
    """Returns the step of times, ns: the largest power of ten that divides their distances."""
    apart = np.diff(t[: 1 << 16])
    return next((step for step in (10**8, 10**7, 10**6, 10**5) if np.ptp(apart) and not (apart % step).any()), 1)


def relate(
    a: Recording, b: Recording, whole: bool | None = None, **settings: Any
) -> Estimate | Course:
    """Relates two recordings, with times in s from the first sample of each.

    Args:
        a: The first.
        b: The second.
        whole: Window by window (True) or as one twist (False); None: by their length.
        settings: Those of :func:`twist_sync.estimate`.
    """
    if whole is None:
        lengths = sorted((a.seconds, b.seconds))
        whole = lengths[0] > LONGEST_TWIST_S or lengths[1] > LONGEST_WITH_TWIST_S
    how = course if whole else estimate
    found = how(a.t - a.t[0], a.w, b.t - b.t[0], b.w, **settings)
    open_s = float(np.hypot(a.open_s, b.open_s))
    limit = settings.get("sigma_limit") or (1e-3 if whole else 100e-6)
    if open_s > limit:
        raise Refused(f"the 1-sigma of the offset is too large: {open_s * 1e6:.0f} µs (limit {limit * 1e6:.0f} µs)")
    return found._opened(open_s) if open_s else found


def sync(
    recordings: Sequence[str | os.PathLike[str] | Recording],
    *,
    whole: bool | None = None,
    delays: Sequence[float] = (),
    **settings: Any,
) -> Synchronized:
    """Puts two or more recordings of one rigid body on one clock.

    Args:
        recordings: Files, folders, or results of :func:`twist_sync.read`.
        whole: Window by window (True) or as one twist (False); None: by their length.
        delays: Delay of each gyroscope's low-pass filter, s, in their order.
        settings: Those of :func:`twist_sync.estimate`.

    Returns:
        The relation of each pair, and one solution; ``clock(1).b_to_a(t)`` puts times of the
        second recording on the clock of the first.

    Raises:
        Unreadable: A file gives no gyroscope.
    """
    if len(recordings) < 2 or (delays and len(delays) != len(recordings)):
        raise ValueError(
            f"{len(recordings)} recordings and {len(delays)} delays; expected two or more, and as many"
        )
    read = _in_one_unit([r if isinstance(r, Recording) else files.read(r) for r in recordings])
    for recording in read:
        if recording.seconds <= 0:
            raise Unreadable(
                f"{recording.path}: its times do not rise; give --columns and --time-unit"
            )
    pairs = []
    for a, b in itertools.combinations(range(len(read)), 2):
        of_pair = {"a_delay": delays[a], "b_delay": delays[b]} if delays else {}
        try:
            pairs.append(Pair(a, b, relate(read[a], read[b], whole, **of_pair, **settings), None))
        except Refused as refused:
            pairs.append(Pair(a, b, None, refused, _doubts(read[a], read[b], refused)))
    try:
        network = Network(len(read), {(p.a, p.b): p.relation for p in pairs if p.found})
        return Synchronized(read, pairs, network, None)
    except Refused as refused:
        return Synchronized(read, pairs, None, refused)
