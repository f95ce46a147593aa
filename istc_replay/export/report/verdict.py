"""A window's verdict in plain words: what was certified, and what was not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from istc_replay.datatypes import SOUND, WindowStatus
from istc_replay.export.report.markup import Html, element, join, names, number, prose
from istc_replay.units import NS_PER_S

#: What each check says when it passes.
CHECKS = {
    "complete": "nothing is missing from the plan",
    "cubes_disjoint": "in every time unit, corridor-cubes of different vehicles keep their gap",
    "obstacles_clear": "in every time unit, corridor-cubes keep their gap from obstacles",
    "obstacles_known": "all obstacles, and road users that stay as recorded, are among those kept clear of",
    "cubes_overlap": "consecutive cubes of each corridor overlap",
    "in_bounds": "nothing leaves the map's bounds",
    "dynamics": "the trajectories follow the kinematic bicycle when integrated anew",
    "limits": "steering, speed, acceleration and jerk keep their limits",
    "in_corridor": "each vehicle's box stays inside its cubes at every instant, not only at the knots",
    "separation": "no two planned boxes touch at any instant",
    "obstacle_separation": "no planned box touches an obstacle at any instant",
    "seam": "each plan that was handed over starts where the one before has led",
    "lateral": "in recorded traffic, each box stays on the road, or near its recorded path",
    "start": "each plan starts where its vehicle was recorded",
}

#: Tone, a few words and a sentence of each status that has no plan.
_WITHOUT_PLAN = {
    "no_corridors": ("bad", "✗ no corridors", "✗ No plan: no corridors were found."),
    "conflict_left": (
        "bad",
        "✗ conflict left",
        "✗ No plan: there are no corridors that keep everybody apart.",
    ),
    "not_drivable": (
        "bad",
        "✗ not drivable",
        "✗ No plan: there are corridors, but not every vehicle can be driven in its own.",
    ),
    "nothing_to_plan": ("open", "nothing to plan", "No plan: there was nothing to plan."),
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """A window's verdict: `tone` good, open or bad, a few words, a sentence.

    `planned` is the least gap between two planned boxes, as `recorded` in a summary; empty where
    there is no plan, or none was judged.
    """

    tone: str
    short: str
    sentence: Html
    planned: dict[str, Any]
    has_plan: bool


def verdict_of(entry: dict[str, Any], certificates: Sequence[dict[str, Any]], separation_m: float) -> Verdict:
    """Judge a window by its status and its certificates; the worse of both counts."""
    status = entry.get("status")
    sound = status in SOUND
    if not sound and status != WindowStatus.NOT_CERTIFIED:
        tone, short, words = _WITHOUT_PLAN.get(str(status), ("bad", "✗ no plan", "✗ No plan."))
        return Verdict(tone, short, join([words]), {}, has_plan=False)
    failed = [row["check"] for row in certificates if row["verdict"] == "fail"]
    unjudged = [row["check"] for row in certificates if row["verdict"] == "inconclusive"]
    planned = _planned(entry, certificates, separation_m)
    if sound and not failed and not unjudged and certificates:
        counts = [number(entry.get(f"vehicles_{which}")) for which in ("certified", "plannable", "present")]
        words = "✓ Certified: {} of {} plannable vehicles have plans that pass every check; {} are present."
        if status == WindowStatus.PARTIAL:
            words = (
                "✓ Partial: {} of {} plannable vehicles have plans that pass every check, around the others "
                "as recorded; {} are present."
            )
            return Verdict("open", "✓ partial", join([words.format(*counts)]), planned, has_plan=True)
        told = join([words.format(*counts)])
        if status == WindowStatus.GOAL_NOT_REACHED:
            told = join([told, " Not everybody reaches its goal."])
            return Verdict("open", "✓ goal not reached", told, planned, has_plan=True)
        return Verdict("good", "✓ certified", told, planned, has_plan=True)
    faults = [join(["checks that fail: ", names(failed)])] if failed else []
    faults += [join(["checks that cannot be judged: ", names(unjudged)])] if unjudged else []
    faults += [] if certificates else [join(["no check was made"])]
    said = ", although its status says so" if sound else ""
    sentence = join(
        [f"✗ Not certified{said}: there is a plan, but it is not proven; ", join(faults, "; "), "."]
    )
    return Verdict("bad", "✗ not certified", sentence, planned, has_plan=True)


def _planned(
    entry: dict[str, Any], certificates: Sequence[dict[str, Any]], separation_m: float
) -> dict[str, Any]:
    for row in certificates:
        if row["check"] == "separation" and row["margin"] is not None and row["unit"] == "m":
            time_s = None if row["time_ns"] is None else (row["time_ns"] - int(entry["start_ns"])) / NS_PER_S
            least_m = row["margin"] + separation_m
            return {"min_separation_m": least_m, "pair": row["vehicles"], "time_s": time_s}
    return {}


def verdict_box(entry: dict[str, Any], certificates: Sequence[dict[str, Any]], verdict: Verdict) -> Html:
    """The box that opens a window's section."""
    passed = {row["check"] for row in certificates if row["verdict"] == "pass"} if verdict.has_plan else set()
    proven = [words for check, words in CHECKS.items() if check in passed] + sorted(passed - set(CHECKS))
    reason = entry.get("reason")
    return element(
        "div",
        element("p", verdict.sentence),
        element("p", "Note: " if verdict.tone == "good" else "Reason: ", prose(reason)) if reason else None,
        element("p", "Proven: ", join(proven, "; "), ".") if proven else None,
        element("p", "Least gap between two vehicles, as recorded: ", least_text(entry.get("recorded")), "."),
        element("p", "Least gap between two vehicles, as planned: ", least_text(verdict.planned), ".")
        if verdict.has_plan
        else None,
        class_=f"verdict {verdict.tone}",
    )


def least_text(least: dict[str, Any] | None) -> Html:
    """A least gap in words: how much, whose, and when."""
    gap_m = (least or {}).get("min_separation_m")
    if least is None or gap_m is None:
        return join(["not known; no two vehicles of known size are there at once"])
    overlap = " (their boxes overlap)" if gap_m < 0 else ""
    pair = least.get("pair") or []
    when = f" at {number(least['time_s'], 2, 's')}" if least.get("time_s") is not None else ""
    whose = join([", vehicles ", names(pair)]) if pair else None
    return join([f"{number(gap_m, 2, 'm')}{overlap}", whose, when])
