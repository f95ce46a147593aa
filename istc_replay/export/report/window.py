"""One window's section: verdict, vehicles, layer 1, certificates, solves, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import polars as pl

from istc_replay.export.colours import vehicle_colour
from istc_replay.export.figures.style import line_colour
from istc_replay.export.report.changed import changed_section
from istc_replay.export.report.findings import against_plan_table
from istc_replay.export.report.header import moment
from istc_replay.export.report.markup import (
    NOTHING,
    Html,
    element,
    facts,
    fixed,
    join,
    name,
    names,
    number,
    prose,
    table,
)
from istc_replay.export.report.verdict import Verdict, verdict_box
from istc_replay.units import NS_PER_S

Row = dict[str, Any]

#: A window with more solves than this has them summed up by stage, solver and status.
_SOLVES = 30
_WORDS = {"pass": ("good", "✓ pass"), "fail": ("bad", "✗ fail"), "inconclusive": ("open", "? inconclusive")}
#: Whole numbers of the solves table.
_COUNTS = ("iterations", "nodes", "binaries")


def window_section(
    entry: Row,
    certificates: Sequence[Row],
    solves: pl.DataFrame,
    verdict: Verdict,
    pictures: Html | None,
    *,
    folded: bool,
) -> Html:
    """Build the section of one window.

    Parameters
    ----------
    entry : Row
        The window's figures, of the summary.
    certificates, solves : sequence of Row, DataFrame
        Its checks, and its rows of the solves table.
    verdict : Verdict
        What is said of it in a word.
    pictures : Html, optional
        What it looks like.
    folded : bool
        Whether all but the verdict is hidden until it is opened.
    """
    start_ns = int(entry["start_ns"])
    parts = [
        changed_section(entry),
        _vehicles(entry),
        _exclusions(entry),
        _layer_1(entry),
        _undrivable(entry),
        _certificates(certificates, start_ns),
        _against(entry),
        _solves(solves),
    ]
    body: Html = join([pictures, parts])
    if folded:
        body = element(
            "details", element("summary", "Vehicles, certificates and solves of this window"), body
        )
    length_s = (int(entry["end_ns"]) - start_ns) / NS_PER_S
    units = f"{number(entry.get('units'))} units of {number(entry.get('unit_s'), 2, 's')}"
    return element(
        "section",
        element("h2", f"Window {entry['index']}"),
        element("p", f"From {moment(start_ns)}, {number(length_s, 1, 's')} long, in {units}."),
        verdict_box(entry, certificates, verdict),
        body,
        class_="window",
        id=f"window-{entry['index']}",
    )


def _swatch(vehicle_id: str) -> Html:
    return element("span", class_="swatch", style=f"background:{line_colour(vehicle_colour(vehicle_id))}")


def _vehicles(entry: Row) -> Html:
    counts = facts(
        [
            ("Vehicles present", number(entry.get("vehicles_present"))),
            ("Plannable", number(entry.get("vehicles_plannable"))),
            ("Certified", number(entry.get("vehicles_certified"))),
            ("Changed by coordination", number((entry.get("coordination") or {}).get("vehicles_changed"))),
        ]
    )
    rows = [
        (
            join([_swatch(str(vehicle.get("id"))), name(vehicle.get("id"))]),
            number(vehicle.get("priority"), 3),
            name(vehicle.get("guidance") or NOTHING),
            _units(vehicle),
            fixed(vehicle.get("corridor_area_m2"), 1),
            fixed(vehicle.get("pivot_deviation_m"), 2),
            fixed(vehicle.get("speed_std_mps"), 2),
            fixed(vehicle.get("length_m"), 1),
            name(vehicle.get("dimensions_source") or NOTHING),
        )
        for vehicle in entry.get("vehicles") or []
    ]
    headings = (
        "Vehicle",
        "priority η",
        "guidance",
        "units",
        "corridor [m²]",
        "deviation [m]",
        "speed σ [m/s]",
        "path [m]",
        "size from",
    )
    caption = (
        "Plannable vehicles: priority weight, area of all corridor-cubes, mean distance of the pivotal "
        "points from their references, standard deviation of the planned speed, length of the planned path"
    )
    listed = table(caption, headings, rows, (1, 4, 5, 6, 7)) if rows else None
    return join([element("h3", "Vehicles"), counts, listed])


def _units(vehicle: Row) -> str:
    first, count = vehicle.get("first_unit"), vehicle.get("units")
    if not isinstance(first, int) or not isinstance(count, int):
        return NOTHING
    return f"{first} to {first + count - 1}"


def _exclusions(entry: Row) -> Html | None:
    exclusions = [*(entry.get("frozen") or []), *(entry.get("exclusions") or [])]
    if not exclusions:
        return None
    rows = [
        (name(e.get("vehicle_id")), name(e.get("reason")), prose(e.get("detail", ""))) for e in exclusions
    ]
    return table(f"Left out of the plan ({len(rows)})", ("Vehicle", "reason", "detail"), rows)


def _layer_1(entry: Row) -> Html:
    corridors = entry.get("corridors") or {}
    if corridors.get("status") is None:
        return join([element("h3", "Corridors (layer 1)"), element("p", "Layer 1 was not solved.")])
    gap = corridors.get("gap")
    return join(
        [
            element("h3", "Corridors (layer 1)"),
            facts(
                [
                    ("Status", name(corridors["status"])),
                    ("Objective", number(corridors.get("objective"), 4)),
                    ("Bound", number(corridors.get("bound"), 4)),
                    ("Gap", number(100.0 * gap, 3, "%") if isinstance(gap, float) else NOTHING),
                    ("Found by", name(corridors.get("found_by") or NOTHING)),
                    ("Rounds with layer 2", number(entry.get("rounds"))),
                    ("Reason", prose(corridors["reason"]) if corridors.get("reason") else None),
                ]
            ),
        ]
    )


def _undrivable(entry: Row) -> Html | None:
    found = entry.get("undrivable") or []
    if not found:
        return None
    rows = [
        (
            name(u.get("vehicle_id")),
            number(u.get("unit")),
            number(u.get("slack_m"), 3),
            prose(u.get("detail", "")),
        )
        for u in found
    ]
    caption = "Vehicles that cannot be driven in their corridors: where, and how far the box would stick out"
    return join(
        [
            element("h3", "Not drivable"),
            table(caption, ("Vehicle", "unit", "sticks out [m]", "detail"), rows, (1, 2)),
        ]
    )


def _certificates(certificates: Sequence[Row], start_ns: int) -> Html | None:
    if not certificates:
        return None
    return join([element("h3", "Certificate"), certificates_table(certificates, start_ns)])


def certificates_table(certificates: Sequence[Row], start_ns: int) -> Html:
    """The table of a window's checks; times count from start_ns."""
    rows = []
    for row in certificates:
        tone, word = _WORDS.get(str(row["verdict"]), ("", str(row["verdict"]).replace("_", " ")))
        time_s = None if row["time_ns"] is None else (row["time_ns"] - start_ns) / NS_PER_S
        when = None if time_s is None else f" at {number(time_s, 2, 's')}"
        witness = join([names(row["vehicles"] or [], 6), when])
        rows.append(
            (
                name(row["check"]),
                element("span", word, class_=tone or None),
                number(row["margin"], 4),
                name(row["unit"] or ""),
                witness,
                prose(row["detail"] or ""),
            )
        )
    headings = ("Check", "verdict", "margin", "unit", "witness", "detail")
    caption = "Each check with its least margin (below zero: violated), and where that margin is found"
    return table(caption, headings, rows, (2,))


def _against(entry: Row) -> Html | None:
    rows = [
        {"vehicle_id": vehicle.get("id"), "start_ns": int(entry["start_ns"]), **told}
        for vehicle in entry.get("vehicles") or []
        if (told := vehicle.get("recorded_against_plan"))
    ]
    compared = against_plan_table(rows, windows=False)
    return join([element("h3", "Recorded against planned"), compared]) if compared else None


def _solves(solves: pl.DataFrame) -> Html | None:
    if solves.is_empty():
        return None
    timed = ("seconds",) if solves["wall_s"].is_not_null().any() else ()
    listed = _each_solve(solves, timed) if solves.height <= _SOLVES else _summed_solves(solves, timed)
    return join([element("h3", "Solves"), listed])


def _each_solve(solves: pl.DataFrame, timed: tuple[str, ...]) -> Html:
    headings = (
        "Layer",
        "stage",
        "vehicle",
        "solver",
        "status",
        "objective",
        "bound",
        "gap",
        *_COUNTS,
        *timed,
    )
    rows = [
        (
            name(row["layer"] or NOTHING),
            name(row["stage"] or NOTHING),
            NOTHING if row["vehicle_id"] is None else name(row["vehicle_id"]),
            name(row["solver"] or NOTHING),
            name(row["status"] or NOTHING),
            number(row["objective"], 4),
            number(row["bound"], 4),
            number(row["gap"], 5),
            *(number(row[column]) for column in _COUNTS),
            *(number(row["wall_s"], 3) for _ in timed),
            prose(row["detail"] or ""),
        )
        for row in solves.iter_rows(named=True)
    ]
    return table("Each call of a solver", (*headings, "detail"), rows, range(5, len(headings)))


def _summed_solves(solves: pl.DataFrame, timed: tuple[str, ...]) -> Html:
    keys = ("layer", "stage", "solver", "status")
    summed = solves.group_by(keys, maintain_order=True).agg(
        pl.len().alias("solves"), *(pl.col(column).sum() for column in (*_COUNTS, "wall_s"))
    )
    headings = ("Layer", "stage", "solver", "status", "solves", *_COUNTS, *timed)
    rows = [
        (
            *(name(row[key] or NOTHING) for key in keys),
            *(number(row[column]) for column in ("solves", *_COUNTS)),
            *(number(row["wall_s"], 3) for _ in timed),
        )
        for row in summed.iter_rows(named=True)
    ]
    caption = f"The window's {solves.height} solves, summed up; istc-replay export lists them all"
    return table(caption, headings, rows, range(4, len(headings)))
