"""The section of the serious encounters: figures, a picture from above, plots, and their findings."""

from __future__ import annotations

from typing import Any

import polars as pl

from istc_replay.config import HARDEST_BRAKING_MPS2
from istc_replay.export.audit.links import Links
from istc_replay.export.audit.pictures import Recording, draw_encounter
from istc_replay.export.figures import figure_bytes
from istc_replay.export.figures.style import drawing_style
from istc_replay.export.report.findings import findings_table, severity_word
from istc_replay.export.report.markup import Html, captioned, element, facts, join, names, number
from istc_replay.export.report.pictures import inline_svg
from istc_replay.export.text import shortened, visible
from istc_replay.safety.rules import worst_first
from istc_replay.units import NS_PER_S

Row = dict[str, Any]

#: Encounters with a picture, and findings listed of each.
PICTURED = 12
_LISTED = 20

_CAPTION = (
    "Boxes where it is worst, with ticks each second along their ways; others are grey. Right: the gap of "
    "the boxes, the time to collision at constant velocities, the speeds; thresholds are dashed, the "
    "encounter is shaded, the line is its worst instant."
)
_LINKED = (
    "Links to the view work where istc-replay view RESULT --bundle has written the folder view beside this "
    "file; istc-replay view RESULT --finding opens Rerun at the same instant."
)


def encounters_section(recording: Recording, links: Links) -> Html:
    """The serious and critical encounters, worst first."""
    severe = recording.audit.encounters.filter(pl.col("severity").is_in(["serious", "critical"]))
    if severe.is_empty():
        return join([element("h2", "Encounters"), element("p", "No encounter is serious or critical.")])
    rows = worst_first(severe).head(PICTURED).iter_rows(named=True)
    shown = [_encounter(recording, row, k, links) for k, row in enumerate(rows)]
    rest = severe.height - len(shown)
    more = f"{rest} more are serious or critical and have no picture here; the tables have them all."
    return join(
        [
            element("h2", "Serious encounters"),
            element("p", _LINKED) if links.origin_ns is not None else None,
            shown,
            element("p", more) if rest else None,
        ]
    )


def _encounter(recording: Recording, row: Row, k: int, links: Links) -> Html:
    own = worst_first(recording.audit.findings.filter(pl.col("encounter_id") == row["encounter_id"]))
    link = links.of if links else None
    kind = (row["conflict_type"] or "courses not known").replace("_", " ")
    return element(
        "section",
        element("h3", names([row["first"], row["second"]]), f": {kind}, ", severity_word(row)),
        _figures(row, own, links),
        _picture(recording, row, k),
        findings_table(own, recording.start_ns, "Findings of this encounter", _LISTED, link),
        class_="window",
        id=f"encounter-{k}",
    )


def _figures(row: Row, own: pl.DataFrame, links: Links) -> Html:
    changes = [number(row[name], 1) for name in ("delta_v_first_mps", "delta_v_second_mps")]
    worst = own.row(0, named=True) if own.height else None
    return facts(
        [
            ("Least gap", number(row["least_gap_m"], 2, "m")),
            ("Least TTC", number(row["least_ttc_s"], 2, "s")),
            ("PET", number(row["least_pet_s"], 2, "s")),
            ("Most DRAC", _braking(row["most_drac_mps2"])),
            ("Required braking", _braking(row["most_required_mps2"])),
            ("Least headway", number(row["least_thw_s"], 2, "s")),
            ("TET, TIT", f"{number(row['tet_s'], 1, 's')}, {number(row['tit_s2'], 2, 's²')}"),
            ("Change of speed in a collision", f"{' and '.join(changes)} m/s"),
            ("To the instant", links.of(worst) if worst else None),
        ]
    )


def _braking(value: float | None) -> str:
    """A deceleration; the hardest that a car can is told as that or more."""
    more = " or more" if value is not None and value >= HARDEST_BRAKING_MPS2 else ""
    return number(value, 1, "m/s²") + more


def _picture(recording: Recording, row: Row, k: int) -> Html | None:
    with drawing_style():
        figure = draw_encounter(recording, row)
    if figure is None:
        return None
    at = number((row["worst_ns"] - recording.start_ns) / NS_PER_S, 2, "s")
    who = " and ".join(visible(shortened(str(row[side]), 40)) for side in ("first", "second"))
    alternative = (
        f"{who} from above at {at}; their gap, time to collision and speeds about it. "
        f"The least gap is {number(row['least_gap_m'], 2, 'm')}."
    )
    svg = inline_svg(figure_bytes(figure, "svg"), f"e{k}", alternative)
    return captioned(svg, _CAPTION)
