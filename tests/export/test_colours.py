"""A vehicle has one colour in every view."""

from __future__ import annotations

from itertools import combinations

from istc_replay.export.colours import PALETTE, vehicle_colours


def test_colours_depend_on_the_set_of_vehicles_alone() -> None:
    assert vehicle_colours(["b", "a", "c", "a"]) == vehicle_colours({"c", "b", "a"})


def test_as_many_vehicles_as_the_palette_has_are_told_apart() -> None:
    colours = vehicle_colours(str(i) for i in range(len(PALETTE)))
    assert len(set(colours.values())) == len(PALETTE)


def test_numbered_vehicles_take_colours_in_the_order_of_their_numbers() -> None:
    assert list(vehicle_colours(["10", "2", "1"])) == ["1", "2", "10"]


def test_more_vehicles_begin_the_palette_again() -> None:
    colours = vehicle_colours(str(i) for i in range(3 * len(PALETTE)))
    assert set(colours.values()) == set(PALETTE)
    assert colours["0"] == colours[str(len(PALETTE))]


def test_colours_differ_for_eyes_without_red_or_green_receptors() -> None:
    # Blue against yellow and lightness is what such eyes have left.
    seen = [((r + g) / 2.0, b) for r, g, b in PALETTE]
    assert all(
        max(abs(p - q) for p, q in zip(one, two, strict=True)) > 15.0 for one, two in combinations(seen, 2)
    )
