"""Table of all recordings, as Parquet and as an HTML page."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from .work import FAILED, VERDICTS

_TEXT, _COUNT, _REAL = pa.string(), pa.int64(), pa.float64()
#: Columns. ``phase_offset_us`` is the offset of the phone's frames from the trigger's grid,
#: ``phase_sigma_us`` 1-sigma of a pair's difference in time (errors of the constants included),
#: ``clock_sigma_us`` the largest 1-sigma of the phone's clock.
SCHEMA = pa.schema(
    [
        ("name", _TEXT), ("verdict", _TEXT), ("pairs", _COUNT), ("phase_offset_us", _REAL),
        ("phase_sigma_us", _REAL), ("clock_sigma_us", _REAL), ("losses", _COUNT),
        ("lost", pa.list_(_TEXT)), ("message", _TEXT), ("exit_code", _COUNT), ("version", _TEXT),
        ("recorded_by", _TEXT), ("firmware", _TEXT), ("options", pa.list_(_TEXT)),
        ("digest", _TEXT), ("state", _TEXT), ("bytes_in", _COUNT), ("bytes_out", _COUNT),
        ("fetch_s", _REAL), ("extract_s", _REAL), ("store_s", _REAL), ("node", _TEXT),
        ("finished", _TEXT),
    ]
)  # fmt: skip
#: Columns that the page omits.
_HIDDEN = {"digest", "state", "options"}
_RANK = {FAILED: 0, "loss": 1, "good": 2}
assert _RANK.keys() == {FAILED, *VERDICTS.values()}

_STYLE = """body{font:14px sans-serif;margin:2em}table{border-collapse:collapse}
td,th{padding:.3em .6em;border-bottom:1px solid #ccc;text-align:left;vertical-align:top}
th{cursor:pointer}td.n{text-align:right}.failed{color:#a00}.loss{color:#950}.good{color:#070}"""
_SORT = """document.querySelectorAll('th').forEach((head,at)=>head.onclick=()=>{
const body=document.querySelector('tbody'),down=head.dataset.down=head.dataset.down?'':1;
const key=row=>row.cells[at].dataset.v??row.cells[at].textContent;
const order=(a,b)=>isNaN(a-b)||a===''||b===''?a.localeCompare(b):a-b;
[...body.rows].sort((a,b)=>order(key(a),key(b))*(down?-1:1)).forEach(row=>body.append(row))})"""


def worst_first(row: dict[str, Any]) -> Any:
    """Returns a sort key: failed recordings first, then those with most losses, then those with
    unknown or large sigma."""
    sigma = row.get("phase_sigma_us")
    unknown = sigma is None
    return _RANK[row["verdict"]], -(row.get("losses") or 0), not unknown, -(sigma or 0), row["name"]


def parquet(rows: list[dict[str, Any]], path: Path) -> None:
    """Writes the rows as Parquet."""
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), path)


def html(rows: list[dict[str, Any]], path: Path) -> None:
    """Writes the rows as an HTML page, in their order. A click on a heading sorts."""
    names = [name for name in SCHEMA.names if name not in _HIDDEN]
    heads = "".join(f"<th>{escape(name)}</th>" for name in names)
    lines = "\n".join(
        f"<tr>{''.join(_cell(name, row.get(name)) for name in names)}</tr>" for row in rows
    )
    counts = {kind: sum(row["verdict"] == kind for row in rows) for kind in _RANK}
    summary = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    path.write_text(
        f"<!doctype html><meta charset=utf-8><title>Recordings</title><style>{_STYLE}</style>"
        f"<h1>{len(rows)} recordings: {summary}</h1>\n<table><thead><tr>{heads}</tr></thead>"
        f"<tbody>\n{lines}\n</tbody></table><script>{_SORT}</script>\n",
        encoding="utf-8",
    )


def _cell(name: str, value: Any) -> str:
    if value is None:
        return "<td></td>"
    if name == "verdict":
        return f'<td class="{escape(value)}" data-v="{_RANK[value]}">{escape(value)}</td>'
    if isinstance(value, float):
        return f'<td class=n data-v="{value}">{value:.2f}</td>'
    if isinstance(value, int):
        return f'<td class=n data-v="{value}">{value:,}</td>'
    text = "<br>".join(map(escape, value)) if isinstance(value, list) else escape(value)
    return f"<td>{text}</td>"
