"""What the report says of the whole log: the head, its windows, its problems, its settings."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from istc_replay.datatypes import Result
from istc_replay.export.report.markup import (
    NOTHING,
    Content,
    Html,
    element,
    facts,
    join,
    name,
    number,
    prose,
    table,
)
from istc_replay.export.report.verdict import Verdict
from istc_replay.export.text import shortened, visible
from istc_replay.units import NS_PER_S

#: More problems of one log than this are counted, not listed.
_PROBLEMS = 200
#: Stamps before this are not taken for a date (2000-01-01).
_FIRST_DATE_NS = 946_684_800 * NS_PER_S


def head(title: str, summary: dict[str, Any]) -> Html:
    """The title, the log's identity and the totals."""
    source, totals = summary.get("input") or {}, summary.get("totals") or {}
    windows = summary.get("windows") or []
    complete = source.get("complete") is True
    state = "complete" if complete else "not complete: it ends early or is damaged"
    problems = len(source.get("problems") or [])
    return join(
        [
            element("h1", element("bdi", visible(shortened(title, 200)))),
            element(
                "dl",
                _fact("Log", prose(source.get("path", NOTHING)), class_="row"),
                _fact("SHA-256", _hash(source.get("sha256"))),
                _fact("The log is", element("span", state, class_="good" if complete else "bad")),
                _fact("Problems in the log", str(problems)),
                _fact("Begins", moment(min((w["start_ns"] for w in windows), default=None))),
                _fact("Length of the log", number(totals.get("log_s"), 1, "s")),
                _fact("Windows, every vehicle certified", _of(totals, "windows_full", "windows")),
                _fact(
                    "Vehicles certified, of those plannable",
                    _of(totals, "vehicles_certified", "vehicles_plannable"),
                ),
                _fact(
                    "Vehicles certified, of those present",
                    _of(totals, "vehicles_certified", "vehicles_present"),
                ),
            ),
        ]
    )


def _fact(title: str, value: Content, class_: str | None = None) -> Html:
    return element("div", element("dt", title), element("dd", value), class_=class_)


def _of(totals: dict[str, Any], part: str, whole: str) -> str:
    return f"{number(totals.get(part))} of {number(totals.get(whole))}"


def moment(time_ns: Any) -> str:
    """A stamp as a date where it can be one, else as seconds."""
    if not isinstance(time_ns, int):
        return NOTHING
    if not _FIRST_DATE_NS <= time_ns < 8 * _FIRST_DATE_NS:
        return number(time_ns / NS_PER_S, 3, "s")
    date = datetime.fromtimestamp(time_ns // NS_PER_S, UTC)
    return f"{date:%Y-%m-%d %H:%M:%S}.{time_ns % NS_PER_S // 1_000_000:03d} UTC"


def window_list(windows: Sequence[dict[str, Any]], verdicts: Sequence[Verdict]) -> Html | None:
    """An overview of all windows, where there is more than one."""
    if len(windows) < 2:
        return None
    rows = []
    for entry, verdict in zip(windows, verdicts, strict=True):
        recorded = entry.get("recorded") or {}
        rows.append(
            (
                element("a", f"Window {entry['index']}", href=f"#window-{entry['index']}"),
                moment(entry["start_ns"]),
                number((entry["end_ns"] - entry["start_ns"]) / NS_PER_S, 1),
                element("span", verdict.short, class_=verdict.tone),
                number(entry.get("vehicles_present")),
                number(entry.get("vehicles_plannable")),
                number(entry.get("vehicles_certified")),
                number(recorded.get("min_separation_m")),
                number(verdict.planned.get("min_separation_m")),
            )
        )
    headings = (
        "Window",
        "begins",
        "length [s]",
        "verdict",
        "present",
        "plannable",
        "certified",
        "recorded gap [m]",
        "planned gap [m]",
    )
    caption = (
        "All windows; vehicles are counted, and gaps are the least between two boxes (below zero: overlap)"
    )
    return join([element("h2", "Windows"), table(caption, headings, rows, (2, 4, 5, 6, 7, 8))])


def problem_list(problems: Sequence[dict[str, Any]]) -> Html:
    """What is damaged or not understood in the log."""
    title = element("h2", "Problems of the log")
    if not problems:
        return join([title, element("p", "None were found.")])
    rows = [
        (name(problem.get("code", NOTHING)), prose(problem.get("detail", "")), number(problem.get("offset")))
        for problem in problems[:_PROBLEMS]
    ]
    rest = len(problems) - len(rows)
    more = element("p", f"{rest} more are in summary.json.") if rest else None
    return join(
        [title, table("Damaged, not understood or left out", ("Code", "detail", "byte"), rows, (2,)), more]
    )


def settings(result: Result) -> Html:
    """The configuration, the versions and, where they are known, the times of the stages."""
    summary = result.summary
    config = join([visible(line.expandtabs(4)) for line in result.config_toml.splitlines()], "\n")
    versions = [
        (name(part), name(version)) for part, version in sorted((summary.get("versions") or {}).items())
    ]
    times = [(name(stage), number(spent_s, 3)) for stage, spent_s in (summary.get("stages") or {}).items()]
    cpu_s = (summary.get("totals") or {}).get("cpu_s")
    identity = [
        ("SHA-256 of the settings", _hash(summary.get("config_sha256"))),
        ("Schema of the summary", name(summary.get("schema", NOTHING))),
        ("Processor time", None if cpu_s is None else number(cpu_s, 1, "s")),
    ]
    return join(
        [
            element("h2", "Settings and versions"),
            facts(identity),
            element(
                "details",
                element("summary", "Settings (config.toml)"),
                element("pre", element("code", config)),
            ),
            table("Versions", ("Part", "version"), versions),
            table("Time of the stages", ("Stage", "seconds"), times, (1,)) if times else None,
        ]
    )


def _hash(value: Any) -> Html:
    return element("span", str(value or NOTHING)[:16], class_="hash")
