"""What was found, as one object for programs and in words: a verdict first, details after."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import numpy as np

from . import Clock, Course, Estimate
from .network import LOOKS, Pair, Synchronized

#: Half-width of an interval that holds 95 % of a Gaussian, in sigmas.
SIGMAS_95 = 1.96
FAULTS = {
    "not_finite": "samples are no numbers",
    "timestamp_order": "times go back",
    "timestamp_outlier": "times are far off those around them",
    "timestamp_sawtooth": "times creep and jump back, as where batches of samples are stamped at once",
    "timestamp_step": "times jump: the recorder's clock was set",
    "timestamp_far": "times are of another day",
    "gap": "times without samples",
    "clipped": "samples are at the end of the sensor's range: it turned faster than the sensor can measure",
    "copied_sample": "samples repeat the one before",
    "displaced_class": "samples are regularly late or early",
    "outlier": "spikes",
    "not_one_body": "samples are of a time in which the two were not held together",
}
ACTIONS = {"left_out": "left out", "corrected": "corrected", "noted": "nothing done"}


def _seconds(nanos: int) -> str:
    whole, part = divmod(abs(nanos), 10**9)
    return f"{'-' if nanos < 0 else ''}{whole}.{part:09}"


def size(seconds: float) -> str:
    """Returns a short time in words, with two or three digits."""
    for one, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= one:
            return f"{seconds / one:.3g} {unit}"
    return f"{seconds * 1e6:.2g} µs" if seconds < 99.5e-6 else f"{seconds * 1e6:.0f} µs"


def supported(pair: Pair, solved: Synchronized) -> np.ndarray:
    """Returns times of a, s from its first sample, at which a relation has data."""
    a, b = solved.recordings[pair.a], solved.recordings[pair.b]
    found = pair.relation
    ends = found.b_to_a(np.array([0.0, b.seconds]))
    looks = np.linspace(max(0.0, ends[0]), min(a.seconds, ends[1]), LOOKS)
    if isinstance(found, Course):
        at = [e.reference for e in found.estimates]
        looks = np.sort(np.r_[looks, at])
        looks = looks[[not any(start <= t <= end for start, end in found.unsupported) for t in looks]]
        return looks if len(looks) else np.array(at)
    return looks


def _middle(pair: Pair, solved: Synchronized) -> Clock | None:
    if isinstance(pair.found, Course):
        looks = supported(pair, solved)
        return pair.found.at(looks[len(looks) // 2])
    return pair.found.clock if pair.found else None


def _agree(pair: Pair) -> str:
    if isinstance(pair.found, Course):
        many = pair.found.used + pair.found.contradicting
        return f"{pair.found.used} of {many} stretches agree"
    count = len(pair.report.together) if pair.report else 0
    return f"{max(count, 1)} stretch{'es' if count > 1 else ''} in one motion"


def _pair(pair: Pair, solved: Synchronized) -> dict[str, Any]:
    a, b = solved.recordings[pair.a], solved.recordings[pair.b]
    clock, report = _middle(pair, solved), pair.report
    first, between = int(a.t[0]), int(b.t[0]) - int(a.t[0])
    out: dict[str, Any] = {"a": a.name, "b": b.name, "accepted": clock is not None}
    names = "reference_s offset_s offset_sigma_s largest_95_s skew_ppm skew_sigma_ppm reference_ns offset_ns rotation mirrored"
    out |= dict.fromkeys(names.split())
    if clock is not None:
        reference_ns, offset_ns = first + round(clock.reference * 1e9), between + round(clock.offset * 1e9)
        out |= {
            "reference_s": reference_ns * 1e-9,
            "offset_s": offset_ns * 1e-9,
            "offset_sigma_s": float(clock.offset_sigma),
            "largest_95_s": SIGMAS_95 * float(np.max(pair.relation.at(supported(pair, solved)).offset_sigma)),
            "skew_ppm": float(clock.skew * 1e6),
            "skew_sigma_ppm": float(clock.skew_sigma * 1e6),
            "reference_ns": reference_ns,
            "offset_ns": offset_ns,
        }
    if isinstance(pair.found, Estimate):
        rotation = pair.found.rotation
        out |= {"rotation": None if rotation is None else rotation.tolist(), "mirrored": pair.found.mirrored}
    course = pair.found if isinstance(pair.found, Course) else None
    out["windows"] = course and {n: getattr(course, n) for n in ("windows", "used", "refused", "contradicting")}
    steps = [vars(step) for step in course.steps] if course else []
    out["steps"] = [step | {k: step[k] + first * 1e-9 for k in ("start", "end")} for step in steps]
    by_name = {"a": a.name, "b": b.name}

    def named(text: str) -> str:
        return re.sub(r"\bstream ([ab])\b", lambda found: by_name[found[1]], text)

    fault = ("kind", "count", "period", "displacement", "action")
    faults, left_out, gates, warnings = (getattr(report, n, []) for n in ("faults", "left_out", "gates", "warnings"))
    out["faults"] = [{"recording": by_name[f.stream], **{name: getattr(f, name) for name in fault}} for f in faults]
    out["left_out"] = [vars(part) for part in left_out]
    out["gates"] = [vars(gate) for gate in gates]
    out["warnings"] = [named(warning) for warning in warnings]
    out["agree"] = _agree(pair) if pair.found else None
    if course:
        out["refused_windows"] = [{**vars(gate), "windows": n} for gate, n in course.refusals]
        out["unsupported"] = [[s + first * 1e-9 for s in part] for part in course.unsupported]
        out["warnings"] = [f"{named(text)} ({n} estimates)" for text, n in course.warnings]
    out["warnings"] += [f"{r.name}: {doubt}" for r in (a, b) for doubt in r.doubts]
    if out["mirrored"]:
        out["warnings"].append(
            f"the axes of {a.name} and {b.name} are mirrored: in one of them two axes are exchanged or one has the "
            "wrong sign. The clocks are related all the same; there is no rotation between them"
        )
    failed = [gate.text for gate in gates if not gate.passed]
    out["reasons"] = [*pair.doubts, *map(named, failed or [str(pair.refused)])] if pair.refused else []
    return out


def _network(solved: Synchronized) -> dict[str, Any] | None:
    """Returns clocks and loops of three or more recordings."""
    if len(solved.recordings) < 3:
        return None
    if solved.network is None:
        return {"accepted": False, "reasons": [str(solved.refused)], "clocks": [], "loops": []}
    names = [r.name for r in solved.recordings]
    first, length = int(solved.recordings[0].t[0]), solved.recordings[0].seconds
    looks, middle = np.linspace(0, length, LOOKS), LOOKS // 2
    value, sigma = solved.network.offsets(looks)
    clocks = [
        {
            "recording": names[k],
            "reference_ns": first + round(length / 2 * 1e9),
            "offset_ns": int(solved.recordings[k].t[0]) - first + round(float(value[k, middle]) * 1e9),
            "offset_sigma_s": float(sigma[k, middle]),
            "largest_sigma_s": float(sigma[k].max()),
        }
        for k in range(1, len(names))
    ]
    loops = [
        {
            "recordings": [names[k] for k in of],
            "closure_rms_s": float(np.sqrt(np.mean(error**2))),
            "sigma_rms_s": float(np.sqrt(np.mean(of_sum**2))),
        }
        for of, (error, of_sum) in solved.network.closures(looks).items()
    ]
    return {"accepted": True, "reasons": [], "clocks": clocks, "loops": loops}


def object_of(solved: Synchronized) -> dict[str, Any]:
    """Returns all that was found as an object of JSON."""
    recordings = [
        {"file": str(r.path), "form": r.form, "samples": len(r.t), "duration_s": r.seconds, "notes": r.notes}
        for r in solved.recordings
    ]
    pairs = [_pair(pair, solved) for pair in solved.pairs]
    found = {"recordings": recordings, "pairs": pairs, "network": _network(solved)}
    return {"verdict": _verdict(solved, found), **found}


def _verdict(solved: Synchronized, found: dict[str, Any]) -> dict[str, Any]:
    """Returns if all are related, to ± what (95 %), what agrees and what to do next, in words."""
    pairs, network = found["pairs"], found["network"]
    names = " and ".join(r.name for r in solved.recordings) if len(solved.recordings) == 2 else f"{len(solved.recordings)} recordings"
    if solved.network is None:
        reasons = network["reasons"] if network else pairs[0]["reasons"]
        why, _, step = (reasons[0] if reasons else "no relation").partition("; ")
        if network:
            refused = [pair for pair in pairs if not pair["accepted"]]
            step = f"look at {refused[0]['a']} and {refused[0]['b']} alone: {refused[0]['reasons'][0]}" if refused else step
        return {"related": False, "to_95_s": None, "agree": None, "text": f"NOT RELATED: {names}: {why}", "next": step or "twist them again"}
    if network:
        to = SIGMAS_95 * max(clock["largest_sigma_s"] for clock in network["clocks"])
        good = sum(pair["accepted"] for pair in pairs)
        agree = f"{good} of {len(pairs)} pairs are related, {len(network['loops'])} loops close"
    else:
        to, agree = pairs[0]["largest_95_s"], pairs[0]["agree"]
    where = " where they were together" if any(pair.get("unsupported") for pair in pairs) else ""
    text = f"RELATED: {names}, to ± {size(to)} (95 %){where}; {agree}"
    count = sum(len(pair["warnings"]) for pair in pairs)
    step = f"mind the {f'{count} warnings' if count > 1 else 'warning'} below" if count else None
    return {"related": True, "to_95_s": to, "agree": agree, "text": text, "next": step}


def text_of(solved: Synchronized, found: dict[str, Any], step: str | None, verbose: bool) -> str:
    """Returns what was found in words; `step` is the next one if there are no doubts."""
    verdict, many = found["verdict"], found["network"] is not None
    following = "; ".join(filter(None, [verdict["next"], step if verdict["related"] else None]))
    lines = [verdict["text"] + (f". Next: {following}" if following else "")]
    for recording, own in zip(solved.recordings, found["recordings"], strict=True):
        lines.append(f"{recording.name}: {own['samples']} samples, {own['duration_s']:.2f} s; {own['form']}")
        lines += [f"   {note}" for note in own["notes"]]
    if many and not verbose:
        for warning, count in Counter(warning for pair in found["pairs"] for warning in pair["warnings"]).items():
            lines.append(f"warning{f', of {count} pairs' if count > 1 else ''}: {warning}")
        lines += [f"{p['b']} - {p['a']}: REFUSED: {p['reasons'][0]}" for p in found["pairs"] if not p["accepted"]]
        lines.append("-v shows what was found of each pair")
    else:
        for pair in found["pairs"]:
            lines += _lines(pair, verbose)
    if many:
        lines += _table(solved, found, verbose)
    return "\n".join(lines)


def _lines(pair: dict[str, Any], verbose: bool) -> list[str]:
    names = f"{pair['b']} - {pair['a']}"
    if not pair["accepted"]:
        return [f"{names}: REFUSED", *(f"   {reason}" for reason in pair["reasons"]), *_details(pair, verbose)]
    out = [
        f"{names}: {_seconds(pair['offset_ns'])} s ± {pair['offset_sigma_s'] * 1e6:.2f} µs (1 sigma) at "
        f"{_seconds(pair['reference_ns'])} s of {pair['a']}, skew {pair['skew_ppm']:+.2f} ± "
        f"{pair['skew_sigma_ppm']:.2f} ppm"
    ]
    for start, end in pair.get("unsupported", []):
        out.append(f"   {names}, {start:.1f} to {end:.1f} s: nothing supports the relation there, they did not move as one body")
    for step in pair["steps"]:
        by = f"{step['by'] * 1e3:+.3f} ± {step['sigma'] * 1e3:.3f} ms"
        out.append(f"   a clock stepped by {by} between {step['start']:.1f} and {step['end']:.1f} s of {pair['a']}")
    return [*out, *(f"   warning: {warning}" for warning in pair["warnings"]), *_details(pair, verbose)]


def _details(pair: dict[str, Any], verbose: bool) -> list[str]:
    out = [f"   {part['text']}" for part in pair["left_out"]]
    for fault in pair["faults"]:
        words = FAULTS.get(fault["kind"], fault["kind"].replace("_", " "))
        late = f", {size(abs(fault['displacement']))} late" if fault["displacement"] else ""
        out.append(f"   {fault['recording']}: {words} ({fault['count']} times{late}): {ACTIONS[fault['action']]}")
    if not verbose:
        count = sum(fault["count"] for fault in pair["faults"])
        faults = f"   {count} faulty samples or times in {len(pair['faults'])} kinds were dealt with: -v lists them"
        return [*out[: len(pair["left_out"])], *([faults] if count else [])]
    if windows := pair["windows"]:
        out.append(
            f"   {windows['windows']} windows: {windows['used']} estimates used, {windows['contradicting']} contradict "
            f"the rest; {windows['refused']} windows refused"
        )
        out += [f"      {one['windows']} of them: {one['text']}" for one in pair["refused_windows"]]
    if pair["rotation"]:
        rows = "; ".join(" ".join(f"{x:+.3f}" for x in row) for row in pair["rotation"])
        out.append(f"   rotation from {pair['a']} to {pair['b']}: {rows}")
    for gate in pair["gates"]:
        passed = "passed" if gate["passed"] else "FAILED"
        out.append(f"   {passed}: {gate['name']} {gate['value']:.3g} (limit {gate['limit']:.3g}) {gate['unit']}")
    return out


def _table(solved: Synchronized, found: dict[str, Any], verbose: bool) -> list[str]:
    network, out = found["network"], []
    if verbose:
        for loop in network["loops"]:
            out.append(
                f"loop {', '.join(loop['recordings'])}: closes to {loop['closure_rms_s'] * 1e6:.2f} µs rms, "
                f"where the sigmas say {loop['sigma_rms_s'] * 1e6:.2f} µs"
            )
    wide = max(len(r.name) for r in solved.recordings)
    out.append(f"{'recording':{wide}}  {'its clock less the first, s':>29}  {'± (95 %)':>9}  related to")
    clocks = network["clocks"] or [None] * (len(solved.recordings) - 1)
    for k, (recording, clock) in enumerate(zip(solved.recordings, [None, *clocks], strict=True)):
        related = sum(pair["accepted"] for own, pair in zip(solved.pairs, found["pairs"], strict=True) if k in (own.a, own.b))
        value, sigma = ("0", "the clock") if k == 0 else ("-", "-")
        if clock:
            value, sigma = _seconds(clock["offset_ns"]), size(SIGMAS_95 * clock["largest_sigma_s"])
        out.append(f"{recording.name:{wide}}  {value:>29}  {sigma:>9}  {related} of {len(solved.recordings) - 1}")
    return out + [f"REFUSED: {reason}" for reason in network["reasons"]]
