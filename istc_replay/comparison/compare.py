"""Comparing two results: windows, vehicles, orders, settings."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
import polars as pl

from istc_replay.comparison.difference import Change, Comparison, VehicleChange, WindowChange
from istc_replay.comparison.motion import compare_motions, compare_pairs, window_motions
from istc_replay.datatypes import Result

#: Numbers nearer than this are the same.
TOLERANCE = 1e-9

_VEHICLE_FIGURES = (
    *("priority", "guidance", "first_unit", "units", "corridor_area_m2", "corridor_breadth_m"),
    *("pivot_deviation_m", "speed_std_mps", "length_m", "goal_distance_m", "arrived"),
)
_WINDOW_FIGURES = (
    *("status", "unit_s", "units", "vehicles_present", "vehicles_plannable", "vehicles_certified", "rounds"),
    *("corridors.status", "corridors.objective", "corridors.bound", "corridors.gap", "corridors.found_by"),
    "recorded.min_separation_m",
)
_WALLS = ("x_min_m", "x_max_m", "y_min_m", "y_max_m")


def compare_results(
    a: Result, b: Result, parts_a: Iterable[Result] | None = None, parts_b: Iterable[Result] | None = None
) -> Comparison:
    """Compare two results.

    Parameters
    ----------
    a, b : Result
        As read back. Their logs, vehicles, windows and settings may differ.
    parts_a, parts_b : iterable of Result, optional
        Their parts in order of time, of those that are without their states.

    Returns
    -------
    Comparison
        Only what differs: of a result and itself, nothing.
    """
    windows_a, windows_b = (_entries(result) for result in (a, b))
    ids_a, ids_b = set[str](), set[str]()
    windows = [
        _window(one, two, windows_a[index], windows_b[index])
        for index, one, two in _shared_windows(
            _noting([a] if parts_a is None else parts_a, ids_a),
            _noting([b] if parts_b is None else parts_b, ids_b),
            windows_a.keys() & windows_b.keys(),
        )
    ]
    windows.sort(key=lambda window: window.index)
    settings_a, settings_b = (dict(_flat(_toml(result.config_toml))) for result in (a, b))
    return Comparison(
        inputs=_changes(_input(a), _input(b)),
        settings=_changes(settings_a, settings_b),
        versions=_changes(a.summary.get("versions") or {}, b.summary.get("versions") or {}),
        vehicles_only_a=tuple(sorted(ids_a - ids_b)),
        vehicles_only_b=tuple(sorted(ids_b - ids_a)),
        windows_only_a=tuple(sorted(windows_a.keys() - windows_b.keys())),
        windows_only_b=tuple(sorted(windows_b.keys() - windows_a.keys())),
        windows=tuple(window for window in windows if window.differs),
        findings=_changes(_findings(a), _findings(b)),
    )


def _entries(result: Result) -> dict[int, dict[str, Any]]:
    return {int(entry["index"]): entry for entry in result.summary.get("windows") or []}


def _noting(parts: Iterable[Result], ids: set[str]) -> Iterator[Result]:
    """The parts; who is in their states is added to the ids."""
    for part in parts:
        ids.update(part.states["vehicle_id"].unique())
        yield part


def _shared_windows(
    parts_a: Iterable[Result], parts_b: Iterable[Result], shared: AbstractSet[int]
) -> Iterator[tuple[int, Result, Result]]:
    """The windows that both have, with the parts that hold them; a part is let go when it is done with."""
    waiting: tuple[dict[int, Result], dict[int, Result]] = ({}, {})
    for parts in itertools.zip_longest(parts_a, parts_b):
        for own, part in zip(waiting, parts, strict=True):
            if part is not None:
                own.update((index, part) for index in _entries(part) if index in shared)
        for index in sorted(waiting[0].keys() & waiting[1].keys()):
            yield index, waiting[0].pop(index), waiting[1].pop(index)


def _changes(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Change, ...]:
    keys = sorted(a.keys() | b.keys())
    return tuple(Change(key, a.get(key), b.get(key)) for key in keys if not _equal(a.get(key), b.get(key)))


def _equal(a: Any, b: Any) -> bool:
    numbers = isinstance(a, int | float) and isinstance(b, int | float)
    return a == b or (numbers and math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE))


def _input(result: Result) -> dict[str, Any]:
    told = result.summary.get("input") or {}
    return {key: told.get(key) for key in ("sha256", "complete")}


def _toml(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return {"config.toml": text}


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _findings(result: Result) -> dict[str, int]:
    """Findings by severity, or verdict where there is none, and rule."""
    rows = result.findings.iter_rows(named=True)
    return dict(Counter(f"{row['severity'] or row['verdict']} {row['rule']}" for row in rows))


# --- one window ------------------------------------------------------------------------------


def _window(a: Result, b: Result, entry_a: dict[str, Any], entry_b: dict[str, Any]) -> WindowChange:
    index = int(entry_a["index"])
    motions_a, motions_b = window_motions(a, entry_a), window_motions(b, entry_b)
    figures_a, figures_b = _figures(entry_a, _WINDOW_FIGURES), _figures(entry_b, _WINDOW_FIGURES)
    figures_a |= motions_a.figures()
    figures_b |= motions_b.figures()
    checks_a, checks_b = _checks(a, index), _checks(b, index)
    vehicles_a, vehicles_b = _vehicles(entry_a), _vehicles(entry_b)
    names = set(vehicles_a) | set(vehicles_b) | set(motions_a.recorded) | set(motions_b.recorded)
    moved = compare_motions(motions_a, motions_b)
    walls = _wall_shifts(a, b, index)
    nothing = VehicleChange("", ())
    changes = []
    for name in sorted(names, key=lambda name: (len(name), name)):
        figures = _changes(vehicles_a.get(name, {}), vehicles_b.get(name, {}))
        motion, (cubes, walls_m) = moved.get(name, nothing), walls.get(name, (0, None))
        change = VehicleChange(
            name,
            figures,
            motion.moved_m,
            motion.moved_at_s,
            motion.delay_s,
            walls_m,
            cubes,
            motion.recorded_moved_m,
        )
        if change != VehicleChange(name, ()):
            changes.append(change)
    return WindowChange(
        index=index,
        figures=_changes(figures_a, figures_b),
        checks=_changes(checks_a, checks_b),
        vehicles=tuple(changes),
        pairs=compare_pairs(motions_a, motions_b),
    )


def _figures(entry: Mapping[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    found = {}
    for key in keys:
        value: Any = entry
        for part in key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        found[key] = value
    return found


def _vehicles(entry: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What the summary tells of each vehicle of a window; of those left out the reason."""
    found = {
        str(vehicle["id"]): {"plan": "planned", **_figures(vehicle, _VEHICLE_FIGURES)}
        for vehicle in entry.get("vehicles") or []
    }
    for left in (*(entry.get("exclusions") or []), *(entry.get("frozen") or [])):
        found.setdefault(str(left["vehicle_id"]), {})["plan"] = str(left["reason"])
    return found


def _checks(result: Result, window: int) -> dict[str, str]:
    rows = result.certificates.filter(pl.col("window") == window).iter_rows(named=True)
    return {str(row["check"]): str(row["verdict"]) for row in rows}


def _wall_shifts(a: Result, b: Result, window: int) -> dict[str, tuple[int, float | None]]:
    """By vehicle how many corridor-cubes differ, and by how much a wall at most (None: other units).

    Cubes are compared in the corridor frame; where the two frames differ all cubes do.
    """
    tables = [
        {
            str(name): part.sort("k")
            for (name,), part in result.corridors.filter(pl.col("window") == window)
            .partition_by("vehicle_id", as_dict=True)
            .items()
        }
        for result in (a, b)
    ]
    frame = ("frame_x_m", "frame_y_m", "frame_yaw_rad")
    found: dict[str, tuple[int, float | None]] = {}
    for name in tables[0].keys() | tables[1].keys():
        one, two = (table.get(name) for table in tables)
        if one is None or two is None:
            found[name] = (max(part.height for part in (one, two) if part is not None), None)
            continue
        alike = one["k"].to_list() == two["k"].to_list()
        if not alike or not np.allclose(one[0].select(frame), two[0].select(frame), atol=TOLERANCE):
            found[name] = (max(one.height, two.height), None)
            continue
        shifts = np.abs(one.select(_WALLS).to_numpy() - two.select(_WALLS).to_numpy()).max(axis=1)
        if shifts.max() > TOLERANCE:
            found[name] = (int((shifts > TOLERANCE).sum()), float(shifts.max()))
    return found
