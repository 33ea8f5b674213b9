"""The command twist-sync."""

from __future__ import annotations

import argparse
import json
import math
import os
import shlex
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from . import Unreadable, __version__, files, report
from .network import sync
from .tables import OF_TIME, UNITS, is_time_unit, is_unit

GOOD, USAGE, REFUSED, UNREADABLE = 0, 2, 3, 5
EXAMPLE = Path(__file__).parent / "example"

EPILOG = """\
FILE@NAME chooses one of several gyroscopes of a file, a file of an archive, or "part 2" of a file
whose clock started again. Exit codes: 0, 3 refused (the recordings do not say it), 2 usage, 5 a
file cannot be read or written."""


def parser() -> argparse.ArgumentParser:
    """Returns the parser of the command line."""
    about = "Puts recordings of gyroscopes that were fixed to each other on one clock."
    out = argparse.ArgumentParser("twist-sync", description=about, epilog=EPILOG)
    add = out.add_argument
    known = "text, JSON, bags, MCAP, arrays, videos, logs and others, also packed; see the book's table"
    add("recordings", metavar="FILE", nargs="*", help=known)
    length = out.add_mutually_exclusive_group()
    length.add_argument("--twist", action="store_true", help="take them as one short twist (default: by length)")
    length.add_argument("--whole", action="store_true", help="take them window by window")
    add("-v", "--verbose", action="store_true", help="print all that was found: faults, gates, windows, axes")
    add("--json", action="store_true", help="print one JSON object")
    again = "write each again, on the clock of the first, into this folder"
    add("--write", metavar="DIR", type=Path, help=again)
    add("--plot", metavar="FILE", type=Path, help="draw it: png, svg or pdf")
    add("--example", action="store_true", help="two real recordings that come with the package")

    def add_each(name: str, text: str, **more: Any) -> None:
        add(name, action="append", default=[], help=f"{text}; once for all, or once for each in their order", **more)

    columns = "columns of time and rates, or w, x, y, z, by name or number from 1; SECONDS+NANOSECONDS, or - with --rate"
    add_each("--columns", columns, metavar="T,X,Y,Z")
    add_each("--unit", "of the rates: rad/s, mrad/s, deg/s, mdps, rpm, with a factor as 0.061deg/s; deg:ZYX of angles")
    add_each("--rate", "samples a second, by the rows or a counter", metavar="HZ", type=float)
    add_each("--time-unit", "of the times: s, ms, us, ns, with a factor as 30.5us")
    delays = "delays of the gyroscopes' low-pass filters, in the order of the files"
    add("--delay-us", metavar="US,US", help=delays)
    limit = "refuse an offset (of a window) with a larger 1-sigma"
    add("--max-sigma-us", metavar="US", type=float, help=limit)
    low_pass = "-3 dB frequency of the zero-phase low-pass, 5 to 100"
    add("--low-pass-hz", metavar="HZ", type=float, help=low_pass)
    add("--exact-stamps", action="store_true", help="times in whole milliseconds, say, are exact and not cut to them")
    add("--keep-faults", action="store_true", help="do not look for faults of the streams")
    add("--version", action="version", version=f"twist-sync {__version__}")
    return out


def _arguments(arguments: list[str] | None) -> argparse.Namespace:
    of_line = parser()
    options = of_line.parse_args(arguments)
    if options.example:
        options.recordings = [str(EXAMPLE / f"{name}_gyro_data.csv") for name in ("mcu", "smartphone")]
    count = len(options.recordings)
    if count < 2:
        of_line.error("expected two or more recordings, or --example")
    for name in ("columns", "unit", "time_unit", "rate"):
        given = getattr(options, name)
        if len(given) not in (0, 1, count):
            of_line.error(f"--{name.replace('_', '-')} once, or once for each of {count} recordings")
        setattr(options, name, given * count if len(given) == 1 else given or [None] * count)
    try:
        options.delays = [float(us) * 1e-6 for us in (options.delay_us or "").split(",") if us]
    except ValueError:
        options.delays = [math.nan]
    bad = next((unit for unit in options.unit if unit and not is_unit(unit)), None)
    bad_time = next((unit for unit in options.time_unit if unit and not is_time_unit(unit)), None)
    for is_wrong, said in (
        (bad is not None, f"--unit {bad}: {UNITS}"),
        (bad_time is not None, f"--time-unit {bad_time}: {OF_TIME}"),
        (any(rate is not None and not 0 < rate < 1e6 for rate in options.rate), "--rate: expected samples a second"),
        (
            options.delays and (len(options.delays) != count or not all(map(math.isfinite, options.delays))),
            f"--delay-us {options.delay_us}: expected {count} numbers of microseconds, as 1900,0",
        ),
        (
            options.low_pass_hz is not None and not 5 <= options.low_pass_hz <= 100,
            f"--low-pass-hz {options.low_pass_hz}: expected 5 to 100",
        ),
        (options.max_sigma_us is not None and not 0 < options.max_sigma_us < 1e9, "--max-sigma-us: expected a number above 0"),
    ):
        if is_wrong:
            of_line.error(said)
    return options


def _plain(text: str) -> str:
    """Replaces what would act on a terminal: names and lines of files are printed."""
    return "".join(c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text)


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
    each = zip(options.recordings, options.columns, options.unit, options.time_unit, options.rate, strict=True)
    recordings = [
        files.read(path, columns=columns and columns.split(","), unit=unit, time_unit=time_unit, rate=rate)
        for path, columns, unit, time_unit, rate in each
    ]
    settings = {
        "low_pass_hz": options.low_pass_hz,
        "handle_faults": not options.keep_faults,
        "exact_stamps": options.exact_stamps,
    }
    if options.max_sigma_us:
        settings["sigma_limit"] = options.max_sigma_us * 1e-6
    whole = True if options.whole else False if options.twist else None
    solved = sync(recordings, whole=whole, delays=options.delays, **settings)
    found = report.object_of(solved)
    if options.plot:
        from . import plot

        plot.save(options.plot, solved)
    written: list[str] = []
    if options.write and solved.network:
        from .write import write

        written = write(options.write, solved)
    if options.json:
        print(json.dumps(_finite({**found, "written": written})))
        return GOOD if solved.network else REFUSED
    paths = " ".join(map(shlex.quote, options.recordings))
    step = None if options.write else f"twist-sync {paths} --write DIR puts them on the clock of {recordings[0].name}"
    print(_plain(report.text_of(solved, found, step, options.verbose)))
    for line in written:
        print(_plain(f"written: {line}"))
    if solved.network:
        print(f"in Python, t in ns: twist_sync.sync({options.recordings!r}).clock(1).b_to_a(t)")
    return GOOD if solved.network else REFUSED


def _finite(value: Any) -> Any:
    """Replaces NaN, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def run() -> None:
    """Entry point of the installed command."""
    sys.exit(main())
