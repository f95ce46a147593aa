"""compare.html: two results on one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from istc_replay.comparison.difference import Change, Comparison, PairChange, VehicleChange, WindowChange
from istc_replay.comparison.words import values, verdict
from istc_replay.datatypes import Result
from istc_replay.export.figures import figure_bytes
from istc_replay.export.figures.beside import draw_beside
from istc_replay.export.report.markup import (
    NOTHING,
    Content,
    Html,
    captioned,
    element,
    facts,
    join,
    name,
    names,
    number,
    prose,
    table,
)
from istc_replay.export.report.page import page
from istc_replay.export.report.pictures import inline_svg
from istc_replay.export.text import visible

#: Windows with pictures; the size at which pictures end whatever their number [characters].
_PICTURED, _PICTURES_LIMIT = 6, 12_000_000
_CAPTIONS = {
    "corridors": "Corridors of A and of B in space-time, drawn to one scale and seen from one side.",
    "priorities": "What each vehicle's priority buys it: hollow marks are A, filled ones B. More priority "
    "should mean a larger corridor, pivotal points nearer their references, and a steadier speed.",
    "top_down": "Trajectories from above, A beside or above B, with a tick each second; what has no plan "
    "moves as recorded. Boxes stand at the instant at which two vehicles of A are closest.",
    "filmstrip": "Instants about the closest approach in A. Dashed boxes are A's, filled ones B's, with "
    "B's corridor-cubes around them.",
    "speed_acceleration": "Speed and acceleration: A dashed, B solid.",
    "separation": "Gap of the two closest boxes: A dashed, B solid; below zero they overlap.",
}
_ALTERNATIVES = {
    "corridors": "Corridors of both results in space and time, side by side.",
    "priorities": "Corridor area, deviation of pivotal points and spread of speed by vehicle, in A and B.",
    "top_down": "Trajectories of both results from above, side by side.",
    "filmstrip": "Six instants about the closest approach, the boxes of both results in each.",
    "speed_acceleration": "Speed and acceleration over time in both results.",
    "separation": "Gap of the closest pair over time in both results.",
}


def comparison_html(comparison: Comparison, a: Result, b: Result, titles: tuple[str, str]) -> str:
    """Write the page of a comparison.

    Parameters
    ----------
    comparison : Comparison
        Of `a` and `b`.
    a, b : Result
        The results, for the pictures; of their states those of the windows that are `pictured` will do.
    titles : tuple of str
        What A and B are called, such as their folders; they may hold anything.

    Returns
    -------
    str
        An HTML document that loads nothing and runs nothing; the same for the same results.
    """
    body = [
        element("h1", "A beside B"),
        element(
            "div",
            element("p", verdict(comparison)),
            class_=f"verdict {'good' if comparison.same_outcome else 'open'}",
        ),
        _side("A", titles[0], a),
        _side("B", titles[1], b),
        differences(comparison, _pictures(comparison, a, b)),
    ]
    return page(f"{titles[0]} beside {titles[1]}", body)


def differences(comparison: Comparison, pictures: Mapping[int, Html]) -> Html:
    """All that differs, as tables, with the pictures of windows."""
    sections = [
        _changes("Input", "What of the log differs", comparison.inputs),
        _changes("Settings", "Settings that differ", comparison.settings),
        _changes("Versions", "Versions that differ", comparison.versions),
        _changes("Findings", "Findings of the audit by severity and rule", comparison.findings),
        _only(comparison),
        [_window(window, pictures.get(window.index)) for window in comparison.windows],
    ]
    return join(sections)


def _side(letter: str, title: str, result: Result) -> Html:
    summary = result.summary
    source, totals = summary.get("input") or {}, summary.get("totals") or {}
    certified = f"{number(totals.get('vehicles_certified'))} of {number(totals.get('vehicles_plannable'))}"
    return element(
        "section",
        element("h2", f"{letter}: ", element("bdi", visible(title))),
        facts(
            [
                ("Log", prose(source.get("path", NOTHING))),
                ("SHA-256 of the log", _hash(source.get("sha256"))),
                ("SHA-256 of the settings", _hash(summary.get("config_sha256"))),
                ("Windows", number(totals.get("windows"))),
                ("Vehicles certified, of those plannable", certified),
            ]
        ),
    )


def _hash(told: Any) -> Html:
    return element("span", str(told or NOTHING)[:16], class_="hash")


def _changes(title: str, caption: str, changes: Sequence[Change], level: str = "h2") -> Html | None:
    if not changes:
        return None
    rows = [(name(c.key), *map(prose, values(c))) for c in changes]
    return join([element(level, title), table(caption, ("What", "A", "B"), rows)])


def _only(comparison: Comparison) -> Html | None:
    rows: list[tuple[Content, ...]] = []
    for side, vehicles, windows in (
        ("A", comparison.vehicles_only_a, comparison.windows_only_a),
        ("B", comparison.vehicles_only_b, comparison.windows_only_b),
    ):
        if vehicles or windows:
            rows.append(
                (
                    side,
                    names(vehicles, 40) if vehicles else NOTHING,
                    names(windows, 40) if windows else NOTHING,
                )
            )
    if not rows:
        return None
    caption = "What one of the two has and the other has not"
    return join([element("h2", "In one alone"), table(caption, ("In", "vehicles", "windows"), rows)])


# --- one window ------------------------------------------------------------------------------


def _window(window: WindowChange, pictures: Html | None) -> Html:
    return element(
        "section",
        element("h2", f"Window {window.index}"),
        _moved(window.vehicles),
        _orders(window.pairs),
        _changes("Figures", "Figures of the window that differ", window.figures, "h3"),
        _changes("Certificate", "Checks whose verdict differs", window.checks, "h3"),
        _vehicle_figures(window.vehicles),
        pictures,
        class_="window",
        id=f"window-{window.index}",
    )


def _moved(vehicles: Sequence[VehicleChange]) -> Html | None:
    rows = [
        (
            name(vehicle.vehicle_id),
            number(vehicle.moved_m),
            number(vehicle.moved_at_s, 1),
            number(vehicle.delay_s),
            number(vehicle.cubes) if vehicle.cubes else NOTHING,
            number(vehicle.walls_m, 3),
            number(vehicle.recorded_moved_m),
        )
        for vehicle in vehicles
        if vehicle.moved_m is not None or vehicle.cubes or vehicle.recorded_moved_m is not None
    ]
    if not rows:
        return None
    headings = ("Vehicle", "moved [m]", "at [s]", "later [s]", "cubes", "walls [m]", "recording [m]")
    caption = (
        "What moved from A to B: the largest distance between the plans at one instant and when; how much "
        "later B passes the place where A has done 95 % of its way (below zero: earlier); corridor-cubes "
        "that differ, and the largest shift of a wall; the largest distance between the recordings"
    )
    return join([element("h3", "What moved"), table(caption, headings, rows, range(1, 7))])


def _orders(pairs: Sequence[PairChange]) -> Html | None:
    if not pairs:
        return None

    def told(crossing: Any) -> Content:
        if crossing is None:
            return "no shared place"
        if crossing.lead_s <= 0.0:
            return join([name(crossing.first), " and ", name(crossing.second), " touch"])
        waits = join([name(crossing.second), " waits for ", name(crossing.first)])
        return join([waits, f": {number(crossing.lead_s, 1, 's')}"])

    rows = [
        (
            names(pair.pair),
            told(pair.recorded),
            told(pair.a),
            told(pair.b),
            element("span", "the other goes first", class_="open") if pair.reversed else "as in A",
        )
        for pair in pairs
    ]
    caption = (
        "Pairs that come to one place: who waits for whom, and how long the place is empty in between. Only "
        "pairs whose order or distance in time differs"
    )
    headings = ("Pair", "recorded in A", "A", "B", "order in B")
    return join([element("h3", "Who waits for whom"), table(caption, headings, rows)])


def _vehicle_figures(vehicles: Sequence[VehicleChange]) -> Html | None:
    rows = [
        (name(vehicle.vehicle_id), name(change.key), *map(prose, values(change)))
        for vehicle in vehicles
        for change in vehicle.figures
    ]
    if not rows:
        return None
    shown = table("Figures of the vehicles that differ", ("Vehicle", "what", "A", "B"), rows)
    return element("details", element("summary", "Figures of the vehicles"), shown)


def pictured(comparison: Comparison) -> list[int]:
    """The windows with pictures: those in which motions or corridors differ most."""
    differing = [window for window in comparison.windows if window.vehicles or window.pairs]
    worst = sorted(differing, key=lambda w: -max((v.moved_m or 0.0 for v in w.vehicles), default=0.0))
    return [window.index for window in worst[:_PICTURED]]


def _pictures(comparison: Comparison, a: Result, b: Result) -> dict[int, Html]:
    found: dict[int, Html] = {}
    size = 0
    for index in pictured(comparison):
        if size > _PICTURES_LIMIT:
            break
        drawn = [
            captioned(
                inline_svg(figure_bytes(figure, "svg"), f"w{index}-{kind}", _ALTERNATIVES[kind]),
                _CAPTIONS[kind],
            )
            for kind, figure in draw_beside(a, b, index).items()
        ]
        found[index] = join([element("h3", "Pictures"), drawn])
        size += len(found[index])
    return found
