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


def test_a_vehicle_keeps_its_colour_whoever_else_is_there() -> None:
    fleet = [f"truck {i}" for i in range(40)] + ["<b>", "", "\ud800", "7" * 40]
    together = vehicle_colours(fleet)
    assert all(vehicle_colours([vehicle])[vehicle] == together[vehicle] for vehicle in fleet)


def test_beyond_the_palette_come_other_shades() -> None:
    colours = vehicle_colours(str(i) for i in range(1, 3 * len(PALETTE) + 1))
    assert len(set(colours.values())) == 3 * len(PALETTE)
    assert colours["1"] == PALETTE[0] != colours["7"]


def test_names_with_numbers_differ_from_their_neighbours() -> None:
    colours = vehicle_colours(f"truck {i}" for i in range(1, len(PALETTE) + 1))
    assert len(set(colours.values())) == len(PALETTE)


def test_colours_differ_for_eyes_without_red_or_green_receptors() -> None:
    # Blue against yellow and lightness is what such eyes have left.
    seen = [((r + g) / 2.0, b) for r, g, b in PALETTE]
    assert all(
        max(abs(p - q) for p, q in zip(one, two, strict=True)) > 15.0 for one, two in combinations(seen, 2)
    )
