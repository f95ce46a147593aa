"""Tables that filter and sort in the page, and stay quick with any number of rows."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from istc_replay.export.report.markup import Html, element, join
from istc_replay.export.text import visible

#: More characters of one cell than this are cut.
_CELL_CHARACTERS = 300

STYLE = """
.live .tools{display:flex;flex-wrap:wrap;gap:.6rem 1rem;align-items:end;margin:.5rem 0}
.live label{display:flex;flex-direction:column;font-size:.8rem;color:var(--muted)}
.live input,.live select{font:inherit;font-size:.9rem;color:var(--ink);background:var(--card);
border:1px solid var(--muted);border-radius:.25rem;padding:.2rem .4rem;min-width:9rem}
.live output{font-size:.875rem;color:var(--muted);margin-left:auto}
.live .pane{overflow:auto;max-height:32rem;border:1px solid var(--grid);border-radius:.25rem;padding:0 .6rem}
.live table{margin:0;table-layout:auto;white-space:nowrap}
.live caption{position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}
.live thead th{position:sticky;top:0;background:var(--paper);z-index:1;padding:0 .75rem 0 0}
.live tbody tr{height:30px}
.live tbody td,.live tbody th{padding:0 .75rem 0 0;height:30px;line-height:29px;max-width:26rem;
overflow:hidden;text-overflow:ellipsis;vertical-align:middle}
.live .spacer,.live .spacer td{height:0;padding:0;border:0;line-height:0}
.live button{font:inherit;color:inherit;background:none;border:0;padding:.35rem 0;cursor:pointer;
text-decoration:underline dotted}
.live [aria-sort=ascending] button::after{content:" ↑"}
.live [aria-sort=descending] button::after{content:" ↓"}
td.good,td.bad,td.open{font-weight:600}
"""


@dataclass(frozen=True, slots=True)
class Column:
    """A column: `digits` of numbers (None: text), its `tones` by value, `choice` to filter by value.

    `ranks` orders its values, least first.
    """

    title: str
    digits: int | None = None
    tones: dict[str, str] | None = None
    choice: bool = False
    ranks: tuple[str, ...] = ()


def script() -> str:
    """The script of all such tables."""
    return resources.files("istc_replay.export.fleet_page").joinpath("table.js").read_text(encoding="utf-8")


def live_table(name: str, caption: str, columns: Sequence[Column], rows: Iterable[Sequence[Any]]) -> Html:
    """Build a table.

    Parameters
    ----------
    name : str
        Its id, a constant of the caller.
    caption : str
        What it shows.
    columns : sequence of Column
        Its columns; the first heads the rows.
    rows : iterable of sequences
        Cells: text, number, None, or a pair of text and link; a link is a constant or quoted.
    """
    held = [[_cell(value) for value in row] for row in rows]
    told = [{"digits": c.digits, "tones": c.tones, "ranks": list(c.ranks) or None} for c in columns]
    data = json.dumps({"columns": told, "rows": held}, separators=(",", ":"), allow_nan=False)
    # Of JSON in HTML these three could end the element or open another.
    for character in "<>&":
        data = data.replace(character, f"\\u{ord(character):04x}")
    pane: dict[str, str] = {"class_": "pane", "tabindex": "0", "role": "region", "aria_label": caption}
    return join(
        [
            element("script", Html(data), type="application/json", id=name),
            element("noscript", element("p", "This table needs JavaScript; its rows are in the data set.")),
            element(
                "div",
                _tools(columns, held),
                element("div", _frame(caption, columns), **pane),
                class_="live",
                data_rows=name,
                hidden=True,
            ),
        ]
    )


def _cell(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_cell(value[0]), value[1]]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int)):
        return value
    text = visible(str(value))
    return text if len(text) <= _CELL_CHARACTERS else text[: _CELL_CHARACTERS - 1] + "…"


def _tools(columns: Sequence[Column], rows: Sequence[Sequence[Any]]) -> Html:
    parts = [element("label", "Text", element("input", type="search"))]
    for place, column in enumerate(columns):
        if not column.choice:
            continue
        values = {"–" if row[place] is None else str(row[place]) for row in rows}
        options = [element("option", value, value=value) for value in sorted(values, key=_by(column))]
        everything = element("option", "all", value="")
        parts.append(
            element("label", column.title, element("select", everything, options, data_column=str(place)))
        )
    return element("div", parts, element("output", aria_live="polite"), class_="tools")


def _by(column: Column) -> Any:
    return lambda value: (-column.ranks.index(value) if value in column.ranks else 1, value)


def _side(column: Column) -> str | None:
    return None if column.digits is None else "n"


def _frame(caption: str, columns: Sequence[Column]) -> Html:
    head = [
        element("th", element("button", c.title, type="button"), scope="col", class_=_side(c))
        for c in columns
    ]
    return element(
        "table", element("caption", caption), element("thead", element("tr", head)), element("tbody")
    )
