"""The command twist-sync."""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from . import Clock, Course, Estimate, Refused, Unreadable, __version__, _rotation, files
from .network import LOOKS, Pair, Synchronized, sync
from .tables import TIME_UNITS, is_unit

GOOD, USAGE, REFUSED, UNREADABLE = 0, 2, 3, 5
EXAMPLE = Path(__file__).parent / "example"

EPILOG = """\
FILE@NAME chooses one of several gyroscopes of a file, a file of an archive, or "part 2" of a file
whose clock started again. Exit codes: 0, 3 refused (the recordings do not say it), 2 usage, 5 a
file cannot be read or written."""


def parser() -> argparse.ArgumentParser:
    """Returns the parser of the command line."""
    out = argparse.ArgumentParser(
        "twist-sync",
        description="Puts recordings of gyroscopes that were fixed to each other on one clock.",
        epilog=EPILOG,
    )
    add = out.add_argument
    add(
        "recordings",
        metavar="FILE",
        nargs="*",
        help="text, JSON, bags, MCAP, arrays, videos, logs and others, also packed; see the book's table",
    )
    length = out.add_mutually_exclusive_group()
    length.add_argument(
        "--twist", action="store_true", help="take them as one short twist (default: by length)"
    )
    length.add_argument("--whole", action="store_true", help="take them window by window")
    add("--json", action="store_true", help="print one JSON object")
    add(
        "--write",
        metavar="DIR",
        type=Path,
        help="write each again, on the clock of the first, into this folder",
    )
    add("--plot", metavar="FILE", type=Path, help="draw it: png, svg or pdf")
    add("--example", action="store_true", help="two real recordings that come with the package")
    add(
        "--columns",
        metavar="T,X,Y,Z",
        action="append",
        default=[],
        help=_once("columns of time and rates, or w, x, y, z, by name or number from 1; SECONDS+NANOSECONDS, or - with --rate"),
    )
    add(
        "--unit",
        action="append",
        default=[],
        help=_once("of the rates: rad/s, mrad/s, deg/s, mdps, rpm, with a factor as 0.061deg/s; deg:ZYX of angles"),
    )
    add("--rate", metavar="HZ", type=float, action="append", default=[], help=_once("samples a second, by the rows or a counter"))
    add("--time-unit", action="append", choices=TIME_UNITS, default=[], help=_once("of the times"))
    add(
        "--delay-us",
        metavar="US,US",
        help="delays of the gyroscopes' low-pass filters, in the order of the files",
    )
    add(
        "--max-sigma-us",
        metavar="US",
        type=float,
        help="refuse an offset (of a window) with a larger 1-sigma",
    )
    add(
        "--low-pass-hz",
        metavar="HZ",
        type=float,
        help="-3 dB frequency of the zero-phase low-pass, 5 to 100",
    )
    add("--keep-faults", action="store_true", help="do not look for faults of the streams")
    add("--version", action="version", version=f"twist-sync {__version__}")
    return out


def _arguments(arguments: list[str] | None) -> argparse.Namespace:
    of_line = parser()
    options = of_line.parse_args(arguments)
    if options.example:
        options.recordings = [
            str(EXAMPLE / name) for name in ("mcu_gyro_data.csv", "smartphone_gyro_data.csv")
        ]
    count = len(options.recordings)
    if count < 2:
        of_line.error("expected two or more recordings, or --example")
    for name in ("columns", "unit", "time_unit", "rate"):
        given = getattr(options, name)
        if len(given) not in (0, 1, count):
            of_line.error(
                f"--{name.replace('_', '-')} once, or once for each of {count} recordings"
            )
        setattr(options, name, given * count if len(given) == 1 else given or [None] * count)
    for unit in options.unit:
        if unit is not None and not is_unit(unit):
            of_line.error(f"--unit {unit}: expected rad/s, mrad/s, deg/s, mdps, rpm, 0.061deg/s or deg:ZYX")
    for rate in options.rate:
        if rate is not None and not 0 < rate < 1e6:
            of_line.error(f"--rate {rate}: expected samples a second")
    try:
        options.delays = [float(us) * 1e-6 for us in (options.delay_us or "").split(",") if us]
    except ValueError:
        of_line.error(f"--delay-us {options.delay_us}: expected microseconds, as 1900,0")
    if options.delays and len(options.delays) != count:
        of_line.error(f"--delay-us: expected {count} numbers, as 1900,0")
    if options.low_pass_hz is not None and not 5 <= options.low_pass_hz <= 100:
        of_line.error(f"--low-pass-hz {options.low_pass_hz}: expected 5 to 100")
    if options.max_sigma_us is not None and not options.max_sigma_us > 0:
        of_line.error("--max-sigma-us: expected a number above 0")
    return options


def _plain(text: str) -> str:
    """Replaces what would act on a terminal: names and lines of files are printed."""
    return "".join(c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text)


def _once(text: str) -> str:
    return f"{text}; once for all, or once for each in their order"


def main(arguments: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    options = _arguments(arguments)
    if threading.current_thread() is threading.main_thread():
        # Like Ctrl-C, so that the readers in other processes end too.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return _run(options)
    except BrokenPipeError:
        # The reader of the output has gone.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return GOOD
    except (Unreadable, OSError) as error:
        print(_plain(f"twist-sync: {error}"), file=sys.stderr)
        return UNREADABLE
    except KeyboardInterrupt:
        return 130


def _run(options: argparse.Namespace) -> int:
    each = zip(
        options.recordings, options.columns, options.unit, options.time_unit, options.rate, strict=True
    )
    recordings = [
        files.read(
            path, columns=columns.split(",") if columns else None, unit=unit, time_unit=time_unit, rate=rate
        )
        for path, columns, unit, time_unit, rate in each
    ]
    settings = {"low_pass_hz": options.low_pass_hz, "handle_faults": not options.keep_faults}
    if options.max_sigma_us:
        settings["sigma_limit"] = options.max_sigma_us * 1e-6
    whole = True if options.whole else False if options.twist else None
    solved = sync(recordings, whole=whole, delays=options.delays, **settings)
    if options.plot:
        from . import plot

        plot.save(options.plot, solved)
    written: list[str] = []
    if options.write and solved.network:
        from .write import write

        written = write(options.write, solved)
    found = _object(solved)
    if options.json:
        print(json.dumps(_finite({**found, "written": written})))
    else:
        print(_plain(_text(solved, found)))
        for line in written:
            print(_plain(f"written: {line}"))
        if solved.network:
            paths = ", ".join(repr(path) for path in options.recordings)
            print(f"in Python, t in ns: twist_sync.sync([{paths}]).clock(1).b_to_a(t)")
    return GOOD if solved.network else REFUSED


def _finite(value: Any) -> Any:
    """Replaces NaN, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _middle(pair: Pair) -> Clock | None:
    if pair.found is None:
        return None
    if isinstance(pair.found, Estimate):
        return pair.found.clock
    return pair.found.at(_reference(pair.found.span, pair.found.unsupported))


def _reference(span: tuple[float, float], unsupported: list[tuple[float, float]]) -> float:
    """Returns the middle of a course, or of its longest supported stretch where nothing supports
    the relation in its middle."""
    middle = 0.5 * (span[0] + span[1])
    if not any(start <= middle <= end for start, end in unsupported):
        return middle
    ends = [span[0], *(t for part in sorted(unsupported) for t in part), span[1]]
    start, end = max(zip(ends[::2], ends[1::2], strict=True), key=lambda part: part[1] - part[0])
    return 0.5 * (start + end)


def _pair(pair: Pair, solved: Synchronized) -> dict[str, Any]:
    a, b = solved.recordings[pair.a], solved.recordings[pair.b]
    clock, report = _middle(pair), pair.report
    first, between = int(a.t[0]), int(b.t[0]) - int(a.t[0])
    out: dict[str, Any] = {"a": a.name, "b": b.name, "accepted": clock is not None}
    names = "reference_s offset_s offset_sigma_s skew_ppm skew_sigma_ppm reference_ns offset_ns rotation".split()
    out |= dict.fromkeys(names)
    if clock is not None:
        reference_ns, offset_ns = (
            n + round(s * 1e9) for n, s in ((first, clock.reference), (between, clock.offset))
        )
        out |= {
            "reference_s": reference_ns * 1e-9,
            "offset_s": offset_ns * 1e-9,
            "offset_sigma_s": float(clock.offset_sigma),
            "skew_ppm": float(clock.skew * 1e6),
            "skew_sigma_ppm": float(clock.skew_sigma * 1e6),
            "reference_ns": reference_ns,
            "offset_ns": offset_ns,
        }
    if isinstance(pair.found, Estimate):
        out["rotation"] = _rotation(pair.found.calibration).tolist()
    course = pair.found if isinstance(pair.found, Course) else None
    out["windows"] = course and {
        name: getattr(course, name) for name in ("windows", "used", "refused", "contradicting")
    }
    out["steps"] = [
        vars(step) | {"start": step.start + first * 1e-9, "end": step.end + first * 1e-9}
        for step in (course.steps if course else [])
    ]
    by_name = {"a": a.name, "b": b.name}

    def named(text: str) -> str:
        return re.sub(r"\bstream ([ab])\b", lambda found: by_name[found[1]], text)

    out["faults"] = [
        {
            "recording": by_name[f.stream],
            **{
                name: getattr(f, name)
                for name in ("kind", "count", "period", "displacement", "action")
            },
        }
        for f in (report.faults if report else [])
    ]
    out["left_out"] = [vars(part) for part in (report.left_out if report else [])]
    out["gates"] = [vars(gate) for gate in (report.gates if report else [])]
    out["warnings"] = [named(warning) for warning in (report.warnings if report else [])]
    if course:
        out["refused_windows"] = [{**vars(gate), "windows": n} for gate, n in course.refusals]
        out["unsupported"] = [[s + first * 1e-9 for s in part] for part in course.unsupported]
        out["warnings"] = [f"{named(text)} ({n} estimates)" for text, n in course.warnings]
    failed = [gate.text for gate in (report.gates if report else []) if not gate.passed]
    out["reasons"] = [named(text) for text in failed or [str(pair.refused)]] if pair.refused else []
    return out


def _network(solved: Synchronized) -> dict[str, Any] | None:
    """Returns clocks and loops of three or more recordings."""
    if len(solved.recordings) < 3:
        return None
    if solved.network is None:
        return {"accepted": False, "reasons": [str(solved.refused)], "clocks": [], "loops": []}
    names = [r.name for r in solved.recordings]
    first, length = int(solved.recordings[0].t[0]), solved.recordings[0].seconds
    looks = np.linspace(0, length, LOOKS)
    value, sigma = solved.network.offsets(looks)
    clocks = [
        {
            "recording": names[k],
            "reference_ns": first + round(length / 2 * 1e9),
            "offset_ns": int(solved.recordings[k].t[0])
            - first
            + round(float(value[k, LOOKS // 2]) * 1e9),
            "offset_sigma_s": float(sigma[k, LOOKS // 2]),
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


def _object(solved: Synchronized) -> dict[str, Any]:
    recordings = [
        {
            "file": str(r.path),
            "form": r.form,
            "samples": len(r.t),
            "duration_s": r.seconds,
            "notes": r.notes,
        }
        for r in solved.recordings
    ]
    pairs = [_pair(pair, solved) for pair in solved.pairs]
    return {"recordings": recordings, "pairs": pairs, "network": _network(solved)}


def _seconds(nanos: int) -> str:
    whole, part = divmod(abs(nanos), 10**9)
    return f"{'-' if nanos < 0 else ''}{whole}.{part:09}"


_FAULTS = {"left_out": "left out", "corrected": "corrected", "noted": "nothing done"}


def _text(solved: Synchronized, found: dict[str, Any]) -> str:
    lines = []
    for recording in found["recordings"]:
        name = Path(recording["file"]).name
        lines.append(
            f"{name}: {recording['samples']} samples, {recording['duration_s']:.2f} s; {recording['form']}"
        )
        lines += [f"   {note}" for note in recording["notes"]]
    for pair in found["pairs"]:
        names = f"{pair['b']} - {pair['a']}"
        if pair["accepted"]:
            lines.append(
                f"{names}: {_seconds(pair['offset_ns'])} s ± {pair['offset_sigma_s'] * 1e6:.2f} µs at "
                f"{_seconds(pair['reference_ns'])} s of {pair['a']}, skew {pair['skew_ppm']:+.2f} ± "
                f"{pair['skew_sigma_ppm']:.2f} ppm"
            )
        else:
            lines.append(f"{names}: REFUSED")
            lines += [f"   {reason}" for reason in pair["reasons"]]
        if windows := pair["windows"]:
            lines.append(
                f"   {windows['windows']} windows: {windows['used']} estimates used, {windows['contradicting']} contradict "
                f"the rest; {windows['refused']} windows refused"
            )
            lines += [
                f"      {one['windows']} of them: {one['text']}" for one in pair["refused_windows"]
            ]
            lines += [
                f"   {start:.1f} to {end:.1f} s: nothing supports the relation there; its sigma is larger"
                for start, end in pair["unsupported"]
            ]
        lines += [
            f"   step of {step['by'] * 1e3:+.3f} ± {step['sigma'] * 1e3:.3f} ms between {step['start']:.1f} and {step['end']:.1f} s of {pair['a']}"
            for step in pair["steps"]
        ]
        for fault in pair["faults"]:
            kind = fault["kind"].replace("_", " ")
            lines.append(
                f"   {fault['recording']}: {fault['count']} x {kind}, {_FAULTS[fault['action']]}"
            )
        lines += [f"   {part['text']}" for part in pair["left_out"]]
        lines += [f"   warning: {warning}" for warning in pair["warnings"]]
    if network := found["network"]:
        for loop in network["loops"]:
            lines.append(
                f"loop {', '.join(loop['recordings'])}: closes to {loop['closure_rms_s'] * 1e6:.2f} µs rms, "
                f"where the sigmas say {loop['sigma_rms_s'] * 1e6:.2f} µs"
            )
        for clock in network["clocks"]:
            lines.append(
                f"all together, {clock['recording']}: {_seconds(clock['offset_ns'])} s ± "
                f"{clock['offset_sigma_s'] * 1e6:.2f} µs at {_seconds(clock['reference_ns'])} s, "
                f"± {clock['largest_sigma_s'] * 1e6:.2f} µs at most"
            )
        lines += [f"REFUSED: {reason}" for reason in network["reasons"]]
    return "\n".join(lines)


def run() -> None:
    """Entry point of the installed command."""
    sys.exit(main())
