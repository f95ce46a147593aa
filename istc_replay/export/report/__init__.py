"""report.html: one self-contained file that says what was planned, what is proven and what is not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import polars as pl

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import Result, WindowStatus
from istc_replay.errors import ConfigError
from istc_replay.export.figures import window_scene
from istc_replay.export.report.findings import recorded_behaviour
from istc_replay.export.report.header import head, problem_list, settings, window_list
from istc_replay.export.report.markup import Html, element
from istc_replay.export.report.page import page
from istc_replay.export.report.pictures import window_pictures
from istc_replay.export.report.verdict import Verdict, verdict_of
from istc_replay.export.report.window import window_section

__all__ = ["report_html"]

States = Callable[[Sequence[int]], pl.DataFrame]

#: Windows with pictures, and the size at which pictures end whatever their number [characters].
PICTURED_WINDOWS = 12
_PICTURES_LIMIT = 12_000_000


def report_html(result: Result, title: str, states: States | None = None) -> str:
    """Write the report of a result.

    Parameters
    ----------
    result : Result
        A result as read back; without its states where `states` gives them.
    title : str
        The document's title, such as the log's name; it may hold anything.
    states : callable, optional
        Gives the states of some windows.

    Returns
    -------
    str
        An HTML document that loads nothing and runs nothing. The same result gives the same
        text. Pictures are drawn of at most 12 windows: those that are not certified come first,
        then those with a plan.
    """
    summary = result.summary
    windows: list[dict[str, Any]] = [dict(window) for window in summary.get("windows") or []]
    certificates = _rows_by_window(result.certificates)
    separation_m = _separation_m(result)
    verdicts = [verdict_of(entry, certificates.get(entry["index"], []), separation_m) for entry in windows]
    pictured = _pictured(windows, verdicts)
    pictures = _draw(result if states is None else replace(result, states=states(pictured)), pictured)
    sections = [
        window_section(
            entry,
            certificates.get(entry["index"], []),
            result.solves.filter(pl.col("window") == entry["index"]),
            verdict,
            pictures.get(entry["index"]),
            folded=len(windows) > PICTURED_WINDOWS and entry["index"] not in pictures,
        )
        for entry, verdict in zip(windows, verdicts, strict=True)
    ]
    body = [
        head(title, summary),
        window_list(windows, verdicts),
        _left_out(windows, pictures),
        sections or element("p", "The log has no window to plan."),
        recorded_behaviour(result),
        problem_list((summary.get("input") or {}).get("problems") or []),
        settings(result),
    ]
    return page(f"{title}: report", body)


def _rows_by_window(table: pl.DataFrame) -> dict[int, list[dict[str, Any]]]:
    rows: dict[int, list[dict[str, Any]]] = {}
    for row in table.iter_rows(named=True):
        rows.setdefault(row["window"], []).append(row)
    return rows


def _separation_m(result: Result) -> float:
    """The distance that the check of separation asks for; its margin counts from there."""
    try:
        return parse_config(result.config_toml).certificate.separation_m
    except ConfigError:
        return Config().certificate.separation_m


def _pictured(windows: Sequence[dict[str, Any]], verdicts: Sequence[Verdict]) -> list[int]:
    """Windows to draw: half at most for what went wrong, the rest for plans, filled up with either."""
    drawn = [
        (entry["index"], verdict)
        for entry, verdict in zip(windows, verdicts, strict=True)
        if entry.get("status") != WindowStatus.NOTHING_TO_PLAN
    ]
    wrong = [index for index, verdict in drawn if verdict.tone != "good"]
    right = [index for index, verdict in drawn if verdict.tone == "good"]
    share = max(PICTURED_WINDOWS // 2, PICTURED_WINDOWS - len(right))
    chosen = wrong[:share]
    return sorted(chosen + right[: PICTURED_WINDOWS - len(chosen)])


def _draw(result: Result, windows: Sequence[int]) -> dict[int, Html]:
    pictures: dict[int, Html] = {}
    size = 0
    for index in windows:
        if size > _PICTURES_LIMIT:
            break
        pictures[index] = window_pictures(window_scene(result, index))
        size += len(pictures[index])
    return pictures


def _left_out(windows: Sequence[dict[str, Any]], pictures: dict[int, Html]) -> Html | None:
    rest = sum(entry.get("status") != WindowStatus.NOTHING_TO_PLAN for entry in windows) - len(pictures)
    if rest <= 0:
        return None
    return element(
        "p",
        f"Pictures are drawn of {len(pictures)} windows, some of those that are not certified among them; "
        f"{rest} more have none here. istc-replay figures draws those of any window.",
    )
