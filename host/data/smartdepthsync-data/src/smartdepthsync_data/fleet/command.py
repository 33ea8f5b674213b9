"""``smartdepthsync-fleet``: extracts every recording of a store."""

from __future__ import annotations

import argparse
import json
import sys

from .run import NotStarted, fleet


def main(arguments: list[str] | None = None) -> int:
    """Runs the command. Returns 0 if everything was extracted, 4 if the index lists something
    missing, 1 on an error."""
    parser = argparse.ArgumentParser(
        prog="smartdepthsync-fleet",
        description="Extract every recording below SOURCE into OUT (both URLs of fsspec), on Ray.",
        epilog="What follows -- goes to `smartdepthsync extract`, for example -- --register phone.",
    )
    parser.add_argument("source", help="for example s3://bucket/recordings or a folder")
    parser.add_argument("out", help="where data sets, logs and the index go")
    parser.add_argument("--address", help="a Ray cluster; this computer unless given")
    parser.add_argument("--program", default="smartdepthsync", help="on each node")
    parser.add_argument("--threads", type=int, default=1, help="processors of a recording")
    parser.add_argument("--retries", type=int, default=3, help="after a node was lost")
    parser.add_argument("--scratch", help="folder on each node; the system's unless given")
    parser.add_argument("--storage", type=json.loads, default={}, help="JSON for fsspec")
    parser.add_argument("options", nargs="*", help=argparse.SUPPRESS)
    given = vars(parser.parse_args(arguments))
    try:
        rows = fleet(given.pop("source"), given.pop("out"), **given)
    except ImportError as error:
        print(f"error: {error}; pip install 'smartdepthsync-data[fleet,s3]'", file=sys.stderr)
        return 1
    except (OSError, ValueError, NotStarted) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for row in rows:
        print(f"{row['verdict']:7} {row.get('pairs') or 0:8}  {row['name']}  {row['message']}")
    return 0 if all(row["verdict"] == "good" for row in rows) else 4


if __name__ == "__main__":
    sys.exit(main())
