"""Entities of vehicles: one each, or slots that vehicles take in turn where many come and go.

Rerun keeps a column for each component of each entity, some hundred of them a vehicle, and its viewer
refuses a recording of about 90,000. With slots their number follows how many vehicles are there at a
time, however long the log is.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from typing import Any

from rerun.chunk import Chunk

from istc_replay.export.rerun.chunks import Columns, same, static
from istc_replay.export.rerun.stage import Stage

#: More vehicles share slots.
OWN_ENTITIES = 300

#: From when to when a vehicle is shown [ns].
Presence = tuple[int, int]


def slots(presence: Mapping[str, Presence]) -> dict[str, str]:
    """The slot of each vehicle, where there are more than `OWN_ENTITIES`; nothing otherwise.

    A slot is free again after the end of the vehicle that had it, and not at that instant, at which its
    last picture is cleared.
    """
    if len(presence) <= OWN_ENTITIES:
        return {}
    taken: list[tuple[int, int]] = []  # until when, and which
    free: list[int] = []
    count, found = 0, {}
    for vehicle_id, (first_ns, last_ns) in sorted(presence.items(), key=lambda item: (item[1][0], item[0])):
        while taken and taken[0][0] < first_ns:
            heapq.heappush(free, heapq.heappop(taken)[1])
        if free:
            slot = heapq.heappop(free)
        else:
            slot, count = count, count + 1
        heapq.heappush(taken, (last_ns, slot))
        found[vehicle_id] = slot
    digits = len(str(count - 1))
    return {vehicle_id: f"slot {slot:0{digits}}" for vehicle_id, slot in found.items()}


def presence(stage: Stage) -> dict[str, Presence]:
    """From when to when each vehicle is shown in this part: its recording, and the windows that it is in."""
    found: dict[str, Presence] = {}

    def add(vehicle_id: str, first_ns: int, last_ns: int) -> None:
        first, last = found.get(vehicle_id, (first_ns, last_ns))
        found[vehicle_id] = min(first, first_ns), max(last, last_ns)

    spans = {span.index: span for span in stage.spans}
    planned = stage.result.corridors.select("window", "vehicle_id").unique().rows()
    for index, vehicle_id in [*stage.planned, *planned]:
        if index in spans:
            add(vehicle_id, spans[index].start_ns, spans[index].shown_end_ns)
    for vehicle_id, track in stage.recorded.items():
        own = stage.own(track)
        if len(own.times_ns):
            add(vehicle_id, int(own.times_ns[0]), int(own.ends_ns[-1]))
        for span in stage.spans:
            if stage.window_states(span, vehicle_id):
                add(vehicle_id, span.start_ns, span.shown_end_ns)
    return found


def place(stage: Stage, vehicle_id: str) -> str:
    """The last part of the paths of a vehicle's entities: its slot, or its name."""
    return stage.slots.get(vehicle_id) or stage.names[vehicle_id]


def look(stage: Stage, path: str, archetype: Any, **values: Any) -> tuple[list[Chunk], list[Columns]]:
    """What a vehicle's rows have in common: told once, or where others take its entity with each row."""
    if stage.slots:
        return [], [same(archetype, **values)]
    return [static(path, archetype.columns(**{name: [value] for name, value in values.items()}))], []
