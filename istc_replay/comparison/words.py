"""A comparison in sentences, one a line; names stand in them as they are."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from istc_replay.comparison.difference import Change, Comparison, PairChange, VehicleChange, WindowChange

#: Shorter delays are not worth a word [s].
_DELAY_S = 0.05
_UNITS = {"m": "m", "m2": "m²", "mps": "m/s", "s": "s"}
_HASH = re.compile("[0-9a-f]{64}")
#: Differences of settings or versions listed.
_MOST = 40


def verdict(comparison: Comparison) -> str:
    """One sentence for the whole, free of names."""
    if comparison.same:
        return "Nothing differs: the two results are the same."
    if comparison.same_outcome:
        return "The outcome is the same: no plan, corridor, certificate or finding differs."
    vehicles = [vehicle for window in comparison.windows for vehicle in window.vehicles]
    moved = [vehicle.moved_m for vehicle in vehicles if vehicle.moved_m is not None]
    turned = sum(pair.reversed for window in comparison.windows for pair in window.pairs)
    parts = []
    if comparison.windows:
        parts.append(f"{_count(len(comparison.windows), 'window')} differ{_s(len(comparison.windows))}")
    if moved:
        parts.append(f"{_count(len(moved), 'plan')} moved, by up to {max(moved):.2f} m")
    if turned:
        parts.append(f"in {_count(turned, 'pair')} the other one goes first")
    only = comparison.vehicles_only_a + comparison.vehicles_only_b
    if only:
        parts.append(
            f"{_count(len(only), 'vehicle')} {'is' if len(only) == 1 else 'are'} in one of the two alone"
        )
    windows = comparison.windows_only_a + comparison.windows_only_b
    if windows:
        parts.append(f"{_count(len(windows), 'window')} {'is' if len(windows) == 1 else 'are'} in one alone")
    if comparison.findings:
        parts.append("the audit's findings differ")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def sentences(comparison: Comparison) -> Iterator[str]:
    """The verdict, then everything that differs."""
    yield verdict(comparison)
    for kind, changes in (
        ("input", comparison.inputs),
        ("setting", comparison.settings),
        ("version", comparison.versions),
        ("findings", comparison.findings),
    ):
        for change in changes[:_MOST]:
            yield f"{kind} {change.key}: {said(change)}"
        if len(changes) > _MOST:
            yield f"{kind}: {len(changes) - _MOST} more"
    for side, names in (("A", comparison.vehicles_only_a), ("B", comparison.vehicles_only_b)):
        if names:
            yield f"only in {side}: vehicle {', '.join(names)}"
    for side, windows in (("A", comparison.windows_only_a), ("B", comparison.windows_only_b)):
        if windows:
            yield f"only in {side}: window {', '.join(map(str, windows))}"
    for window in comparison.windows:
        yield from _window(window)


def said(change: Change) -> str:
    """What a figure is in A and in B."""
    unit = _UNITS.get(change.key.rpartition("_")[2], "") if "_" in change.key else ""
    after = f" {unit}" if unit else ""
    a, b = values(change)
    return f"{a}{after} in A, {b}{after} in B"


def values(change: Change) -> tuple[str, str]:
    """A figure in A and in B, with as many digits as tell them apart."""
    for digits in (6, 9, 12):
        a, b = _value(change.a, digits), _value(change.b, digits)
        if a != b:
            return a, b
    return _value(change.a, 17), _value(change.b, 17)


def _value(figure: Any, digits: int) -> str:
    if figure is None:
        return "none"
    if isinstance(figure, bool):
        return "yes" if figure else "no"
    return f"{figure:.{digits}g}" if isinstance(figure, float) else shortened(str(figure))


def shortened(text: str) -> str:
    """A hash by its beginning, any other text as it is."""
    return text[:16] if _HASH.fullmatch(text) else text


def order(pair: PairChange) -> str:
    """Who waits for whom in A and in B."""
    a, b = pair.a, pair.b
    if a is not None and b is not None and a.first == b.first:
        return f"{a.second} waits for {a.first} in both, {a.lead_s:.1f} s in A, {b.lead_s:.1f} s in B"
    one, two = (
        f"{crossing.second} waits for {crossing.first} ({crossing.lead_s:.1f} s)"
        if crossing
        else "they share no place"
        for crossing in (a, b)
    )
    return f"in A {one}, in B {two}"


def moved(vehicle: VehicleChange) -> str:
    """How a vehicle's motion and corridor differ; empty where only figures do."""
    parts = []
    if vehicle.moved_m is not None:
        parts.append(f"up to {vehicle.moved_m:.2f} m elsewhere (at {vehicle.moved_at_s:.1f} s)")
    if vehicle.delay_s is not None and abs(vehicle.delay_s) >= _DELAY_S:
        parts.append(f"{abs(vehicle.delay_s):.2f} s {'later' if vehicle.delay_s > 0.0 else 'earlier'}")
    if vehicle.cubes:
        walls = "" if vehicle.walls_m is None else f", walls by up to {vehicle.walls_m:.2g} m"
        parts.append(f"{_count(vehicle.cubes, 'corridor-cube')} differ{_s(vehicle.cubes)}{walls}")
    if vehicle.recorded_moved_m is not None:
        parts.append(f"recorded up to {vehicle.recorded_moved_m:.2f} m elsewhere")
    return "; ".join(parts)


def _window(window: WindowChange) -> Iterator[str]:
    place = f"window {window.index}"
    for vehicle in window.vehicles:
        text = moved(vehicle)
        if text:
            yield f"{place}: vehicle {vehicle.vehicle_id}: in B {text}"
    for pair in window.pairs:
        turned = "the other goes first: " if pair.reversed else ""
        yield f"{place}: {' and '.join(pair.pair)}: {turned}{order(pair)}"
    for change in window.checks:
        yield f"{place}: check {change.key}: {said(change)}"
    for change in window.figures:
        yield f"{place}: {change.key}: {said(change)}"
    for vehicle in window.vehicles:
        for change in vehicle.figures:
            yield f"{place}: vehicle {vehicle.vehicle_id}: {change.key}: {said(change)}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _s(number: int) -> str:
    return "s" if number == 1 else ""
