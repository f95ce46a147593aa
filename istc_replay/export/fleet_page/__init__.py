"""The report of a fleet: one self-contained page over all its logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import polars as pl

from istc_replay.export.fleet_page.histogram import Distribution, histogram
from istc_replay.export.fleet_page.live_table import STYLE, Column, live_table, script
from istc_replay.export.report.header import moment
from istc_replay.export.report.markup import Html, element, facts, join, name, number, prose, table
from istc_replay.export.report.page import page
from istc_replay.export.text import shortened, visible

__all__ = ["Distribution", "FleetFigures", "fleet_page"]

_OUTCOMES = ("done", "inconclusive", "failed", "waiting")
_TONES = {"done": "good", "inconclusive": "open", "failed": "bad", "waiting": "open"}
_SEVERITIES = ("minor", "serious", "critical")
_SEVERITY_TONES = {"critical": "bad", "serious": "open"}
_PAGE_STYLE = """
.parts{display:grid;grid-template-columns:repeat(auto-fill,minmax(20rem,1fr));gap:0 1.5rem}
.part h3{margin:0 0 .3rem}
body{max-width:96rem}
"""


@dataclass(frozen=True, slots=True)
class FleetFigures:
    """What the page shows.

    `logs`, `encounters` and `findings` are the tables of `fleet.figures`; `call` holds facts of
    the fleet as a whole, by title; `distributions` are drawn by group title.
    """

    title: str
    call: Sequence[tuple[str, Any]]
    logs: pl.DataFrame
    findings: pl.DataFrame
    encounters: pl.DataFrame
    encounters_left_out: int
    quality: pl.DataFrame
    distributions: dict[str, Sequence[Distribution]]


def fleet_page(figures: FleetFigures) -> str:
    """Write the page.

    Parameters
    ----------
    figures : FleetFigures
        What it shows; every text may hold anything.

    Returns
    -------
    str
        An HTML document that loads nothing and runs its own script alone.
    """
    body = [
        element("h1", element("bdi", visible(shortened(figures.title, 200)))),
        facts(figures.call),
        _outcomes(figures.logs),
        _logs(figures.logs),
        _encounters(figures),
        _findings(figures.findings),
        [_distributions(title, parts) for title, parts in figures.distributions.items()],
        _quality(figures.quality),
        _data_set(),
    ]
    return page(f"{figures.title}: fleet", body, script=script(), style=STYLE + _PAGE_STYLE)


def _outcomes(logs: pl.DataFrame) -> Html:
    counts = dict(logs.group_by("outcome").len().iter_rows())
    rows = [
        (element("span", outcome, class_=_TONES[outcome]), number(counts[outcome]), _why(logs, outcome))
        for outcome in _OUTCOMES
        if outcome in counts
    ]
    return join(
        [
            element("h2", "Logs by outcome"),
            table("What became of the logs", ("Outcome", "logs", "most common reason"), rows, (1,)),
        ]
    )


def _why(logs: pl.DataFrame, outcome: str) -> Html | None:
    """The reason that most logs of an outcome share, without what is particular to each."""
    reasons = (
        logs.filter(pl.col("outcome") == outcome, pl.col("error") != "")
        .group_by(pl.col("error").str.replace_all(r"[0-9]+(\.[0-9]+)?", "…"))
        .len()
        .sort("len", "error", descending=[True, False])
    )
    return None if reasons.is_empty() else prose(f"{reasons['error'][0]} ({reasons['len'][0]})")


def _logs(logs: pl.DataFrame) -> Html:
    columns = (
        Column("Log"),
        Column("outcome", tones=_TONES, choice=True, ranks=_OUTCOMES),
        Column("worst finding", tones=_SEVERITY_TONES, choice=True, ranks=_SEVERITIES),
        Column("critical", 0),
        Column("serious", 0),
        Column("minor", 0),
        Column("in doubt", 0),
        Column("windows", 0),
        Column("in full", 0),
        Column("vehicles", 0),
        Column("certified", 0),
        Column("least gap [m]", 2),
        Column("least TTC [s]", 2),
        Column("least PET [s]", 2),
        Column("layer 1 [s]", 2),
        Column("layer 2 [s]", 2),
        Column("largest MIQP gap", 4),
        Column("problems", 0),
        Column("job [s]", 1),
        Column("memory [MB]", 0),
        Column("reason"),
    )
    names = (
        *("outcome", "severity", "critical", "serious", "minor", "in_doubt", "windows", "windows_full"),
        *(
            "vehicles_plannable",
            "vehicles_certified",
            "least_gap_m",
            "least_ttc_s",
            "least_pet_s",
            "corridors_s",
        ),
        *("trajectories_s", "most_gap", "problems", "seconds", "peak_mb", "error"),
    )
    rows = (
        ((row["log"], _link(row["log"], row["page"])), *(row[key] for key in names))
        for row in logs.iter_rows(named=True)
    )
    return join([element("h2", "Logs"), live_table("logs", "All logs of the fleet", columns, rows)])


def _link(log: str, page_name: str | None, anchor: str = "") -> str | None:
    return None if page_name is None else f"../logs/{quote(log)}/{quote(page_name)}{anchor}"


def _encounters(figures: FleetFigures) -> Html:
    title = element("h2", "Worst encounters")
    if figures.encounters.is_empty():
        return join([title, element("p", "The audit found none.")])
    columns = (
        Column("Log and window"),
        Column("severity", tones=_SEVERITY_TONES, choice=True, ranks=_SEVERITIES),
        Column("verdict", choice=True),
        Column("conflict", choice=True),
        Column("vehicles"),
        Column("at"),
        Column("least gap [m]", 2),
        Column("least TTC [s]", 2),
        Column("least PET [s]", 2),
        Column("DRAC [m/s²]", 2),
        Column("rules"),
    )
    rows = (
        (
            (_place(row), _link(row["log"], row["page"], _anchor(row))),
            *(row["severity"], row["verdict"], row["conflict_type"], f"{row['first']} and {row['second']}"),
            moment(row["worst_ns"]),
            *(row["least_gap_m"], row["least_ttc_s"], row["least_pet_s"], row["most_drac_mps2"]),
            ", ".join(row["rules"]),
        )
        for row in figures.encounters.iter_rows(named=True)
    )
    rest = figures.encounters_left_out
    more = element("p", f"{rest} that are less severe are in the data set.") if rest else None
    whole = live_table("encounters", "Worst encounters, most severe first", columns, rows)
    return join([title, whole, more])


def _place(row: dict[str, Any]) -> str:
    return str(row["log"]) if row["window"] is None else f"{row['log']}, window {row['window']}"


def _anchor(row: dict[str, Any]) -> str:
    shown = row["page"] == "report.html" and row["window"] is not None
    return f"#window-{row['window']}" if shown else ""


def _findings(findings: pl.DataFrame) -> Html:
    title = element("h2", "Findings by rule and severity")
    if findings.is_empty():
        return join([title, element("p", "The audit found nothing.")])
    rows = [
        (name(row["rule"]), *(number(row[key]) for key in (*reversed(_SEVERITIES), "in_doubt", "logs")))
        for row in findings.iter_rows(named=True)
    ]
    headings = ("Rule", "critical", "serious", "minor", "in doubt", "logs")
    caption = "Findings of recorded behaviour; in doubt are those that rest on data that cannot be trusted"
    return join([title, table(caption, headings, rows, range(1, 6))])


def _distributions(title: str, parts: Sequence[Distribution]) -> Html:
    return join([element("h2", title), element("div", [histogram(part) for part in parts], class_="parts")])


def _quality(quality: pl.DataFrame) -> Html:
    title = element("h2", "Data quality")
    if quality.is_empty():
        return join([title, element("p", "No log has a problem.")])
    rows = [
        (name(row["code"]), row["kind"], number(row["logs"]), number(row["cases"]), prose(row["example"]))
        for row in quality.iter_rows(named=True)
    ]
    headings = ("What", "told by", "logs", "cases", "for example")
    return join([title, table("What is damaged, missing or doubtful in the logs", headings, rows, (2, 3))])


def _data_set() -> Html:
    words = (
        "Every table of every log is in tables/ beside this page, as Parquet with a column log: "
        'polars.scan_parquet("tables/encounters/*.parquet") reads it lazily.'
    )
    return join([element("h2", "Data set"), element("p", words)])
