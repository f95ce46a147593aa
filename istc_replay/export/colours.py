"""One colour a vehicle, the same in every view and in every result: Rerun, Foxglove and the report."""

from __future__ import annotations

import hashlib
import re
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
EDGE: Colour = (172, 172, 160)
OBSTACLE: Colour = (96, 96, 96)

#: Beyond one round of the palette its colours come again, a shade darker, then a shade lighter.
_SHADES = 3


def vehicle_colours(vehicle_ids: Iterable[str]) -> dict[str, Colour]:
    """Give each vehicle the colour of its id, whoever else is there.

    Vehicles that are numbered take the colours in turn, from a place that their common name tells;
    other names take a colour by their digest.

    Parameters
    ----------
    vehicle_ids : iterable of str
        All vehicles, in any order; repeats count once.

    Returns
    -------
    dict
        Red, green and blue, 0 to 255, by vehicle id, in the order of the ids.
    """
    return {vehicle_id: vehicle_colour(vehicle_id) for vehicle_id in sorted(set(vehicle_ids), key=_natural)}


def vehicle_colour(vehicle_id: str) -> Colour:
    """The colour of one vehicle, as `vehicle_colours` gives it."""
    name, number = re.fullmatch(r"(.*?)([0-9]{0,9})", vehicle_id, re.DOTALL).groups()  # type: ignore[union-attr]
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).digest()
    begin = int.from_bytes(digest[:4], "big") if name else 0
    place = begin % len(PALETTE) + int(number) - 1 if number else begin
    red, green, blue = PALETTE[place % len(PALETTE)]
    shade = place // len(PALETTE) % _SHADES
    if shade == 1:
        return red * 7 // 10, green * 7 // 10, blue * 7 // 10
    if shade == 2:
        return (red + 150) // 2 + 20, (green + 150) // 2 + 20, (blue + 150) // 2 + 20
    return red, green, blue


def _natural(vehicle_id: str) -> tuple[int, str]:
    # Shorter first, so that 2 comes before 10.
    return len(vehicle_id), vehicle_id
