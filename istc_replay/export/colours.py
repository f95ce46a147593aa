"""One colour a vehicle, the same in every view: Rerun, Foxglove and the report."""

from __future__ import annotations

from collections.abc import Iterable

Colour = tuple[int, int, int]

#: Okabe and Ito's palette without black and the pale yellow, told apart by colour-blind readers
#: and on light and dark grounds alike.
PALETTE: tuple[Colour, ...] = (
    (0, 114, 178),  # blue
    (230, 159, 0),  # orange
    (0, 158, 115),  # bluish green
    (204, 121, 167),  # reddish purple
    (86, 180, 233),  # sky blue
    (213, 94, 0),  # vermilion
)

#: What was recorded, and the lines of the map: readable on light and dark grounds.
RECORDED: Colour = (128, 128, 128)
LANE: Colour = (140, 140, 140)
OBSTACLE: Colour = (96, 96, 96)


def vehicle_colours(vehicle_ids: Iterable[str]) -> dict[str, Colour]:
    """Give each vehicle a colour of the palette, in the order of the sorted ids, cycling.

    Parameters
    ----------
    vehicle_ids : iterable of str
        All vehicles of the result, in any order; repeats count once.

    Returns
    -------
    dict
        Red, green and blue, 0 to 255, by vehicle id. Equal sets of ids give equal colours.
    """
    return {
        vehicle_id: PALETTE[index % len(PALETTE)]
        for index, vehicle_id in enumerate(sorted(set(vehicle_ids), key=_natural))
    }


def _natural(vehicle_id: str) -> tuple[int, str]:
    # Shorter first, so that 2 comes before 10.
    return len(vehicle_id), vehicle_id
