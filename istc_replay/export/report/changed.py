"""What coordination changed of each vehicle in a window, and how its plan keeps to the road."""

from __future__ import annotations

from typing import Any

from istc_replay.export.report.markup import NOTHING, Html, element, fixed, join, name, names, table

Row = dict[str, Any]

#: What bounds a plan sideways, in words.
_BOUNDS = {
    "road": "the road's edge",
    "path": "the bound beside its path",
    "recording": "the bound beside its path, at the edge",
}
#: A recording this far off the road is told [m].
_OFF_ROAD_M = 0.005


def changed_section(entry: Row) -> Html | None:
    """What coordination changed; None where no plan stands."""
    vehicles = [vehicle for vehicle in entry.get("vehicles") or [] if vehicle.get("coordination")]
    if not vehicles:
        return None
    changed = [vehicle for vehicle in vehicles if vehicle["coordination"].get("changed")]
    traffic = any(vehicle.get("lateral") for vehicle in vehicles)
    what = "the recording, made drivable" if traffic else "the guidance"
    lines = [element("p", _same(vehicles, changed, what))]
    if changed:
        lines.append(_table(changed, what, traffic=traffic))
    off = [v for v in vehicles if (v.get("lateral") or {}).get("recorded_off_road_m", 0.0) > _OFF_ROAD_M]
    if off:
        told = [join([name(v["id"]), f" by {fixed(v['lateral']['recorded_off_road_m'], 2)} m"]) for v in off]
        lines.append(element("p", "Recorded beyond the road's edge: ", join(told, ", "), "."))
    return join([element("h3", "What coordination changed"), lines])


def _same(vehicles: list[Row], changed: list[Row], what: str) -> Html:
    """How many vehicles keep to their guidance, and which."""
    same = [vehicle["id"] for vehicle in vehicles if vehicle not in changed]
    if not same:
        return join([f"{len(changed)} of {len(vehicles)} plans differ from {what}."])
    if not changed:
        return join([f"Nothing: {len(same)} of {len(vehicles)} plans are {what}."])
    return join([f"{len(same)} of {len(vehicles)} plans are {what}: vehicles ", names(same, 20), "."])


def _table(changed: list[Row], what: str, *, traffic: bool) -> Html:
    headings = (
        *("Vehicle", "delay [s]", "moved [m]", "aside [m]", "acceleration [m/s²]", "braking [m/s²]"),
        *("least gap [m]", "gained [m]"),
        *(("room left [m]", "to") if traffic else ()),
    )
    caption = (
        f"Against {what}, for vehicles whose plan differs. Delay: how much later (below zero: earlier) it is "
        "at the plan's last place; moved: the largest distance at one instant; aside: across the path; "
        "acceleration and braking: what the root mean square and the hardest braking rose by (below zero: a "
        "gentler drive); least gap to any other road user, and what of it was gained"
    )
    if traffic:
        caption += "; then the least room left sideways, and what it ends at"
    rows = [
        (
            name(vehicle["id"]),
            *(fixed(vehicle["coordination"].get(key), 2) for key in _CHANGES),
            *(_beside(vehicle.get("lateral") or {}) if traffic else ()),
        )
        for vehicle in changed
    ]
    return table(caption, headings, rows, range(1, 9 if traffic else 8))


_CHANGES = (
    *("delay_s", "deviation_m", "lateral_m", "acceleration_rms_mps2", "braking_mps2"),
    *("clearance_m", "clearance_gained_m"),
)


def _beside(lateral: Row) -> tuple[Html | str, ...]:
    return fixed(lateral.get("margin_m"), 2), _BOUNDS.get(str(lateral.get("bound")), NOTHING)
