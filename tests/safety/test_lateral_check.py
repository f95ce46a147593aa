"""In traffic a plan stays on the road, or near the recorded path, at all times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import Certificate, Frame, Result, RoadEdge, StaticScene, Verdict, read_only
from istc_replay.geometry import to_map

from ..support.bicycles import straight_car
from ..support.judged import FAIL, INCONCLUSIVE, NOT_APPLICABLE, PASS, judge, without
from ..support.written import Scene

RECORDED = pl.col("source") == "recorded"
#: Between two instants that are looked at a box may come this much nearer [m].
BETWEEN_M = 12.0 * 0.05**2 / 8.0


def traffic(frame: Frame, aside_m: float = 0.0, edge_m: float | None = None, **changes: Any) -> Result:
    """A car planned straight on in its frame, recorded to its right; a kerb to its left."""
    scene = Scene([straight_car("a", 0, 0, 0.0, 8.0, 15)], frame=frame)
    result = scene.result()
    shift = to_map([0.0, -aside_m], frame) - to_map([0.0, 0.0], frame)
    moved = [
        pl.when(RECORDED).then(pl.col(name) + by).otherwise(pl.col(name)).alias(name)
        for name, by in zip(("x_m", "y_m"), shift, strict=True)
    ]
    kerb = () if edge_m is None else (to_map([[-90.0, edge_m], [190.0, edge_m]], frame),)
    edges = tuple(RoadEdge("kerb", read_only(line)) for line in kerb)
    window = result.summary["windows"][0] | {"rules": "traffic"} | changes
    return replace(
        result,
        states=result.states.with_columns(moved),
        scene=StaticScene(road_edges=edges),
        summary={"windows": [window]},
    )


def lateral(result: Result) -> Certificate:
    """The check, with a bound of 1.5 m from the path."""
    return judge(result, parse_config("[corridors]\nlateral_m = 1.5"))["lateral"]


FRAMES = [Frame(), Frame(700.0, -300.0, 1.0), Frame(700.0, -300.0, -2.4)]


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    ("spare_m", "verdict"),
    [(-1e-3, FAIL), (0.5 * BETWEEN_M, INCONCLUSIVE), (1.5 * BETWEEN_M, PASS), (1.0, PASS)],
)
def test_where_nothing_is_told_of_the_road_the_centre_stays_near_the_recorded_path(
    frame: Frame, spare_m: float, verdict: Verdict
) -> None:
    check = lateral(traffic(frame, aside_m=1.5 - spare_m))
    assert (check.verdict, check.vehicles) == (verdict, ("a",))
    assert check.margin == pytest.approx(spare_m, abs=1e-6)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(("spare_m", "verdict"), [(-0.1, FAIL), (0.002, INCONCLUSIVE), (0.1, PASS)])
def test_where_a_kerb_is_told_the_box_stays_on_its_side(
    frame: Frame, spare_m: float, verdict: Verdict
) -> None:
    check = lateral(traffic(frame, aside_m=1.0, edge_m=0.95 + spare_m))
    assert (check.verdict, check.vehicles) == (verdict, ("a",))
    assert check.margin == pytest.approx(spare_m, abs=1e-6)


def test_who_was_not_recorded_is_not_judged() -> None:
    check = lateral(without(traffic(Frame()), "states", RECORDED))
    assert (check.verdict, check.vehicles) == (INCONCLUSIVE, ("a",))


def test_whose_motion_is_not_known_is_not_judged() -> None:
    result = traffic(Frame(), vehicles=[{"id": "a"}, {"id": "ghost"}])
    check = lateral(result)
    assert (check.verdict, check.vehicles) == (INCONCLUSIVE, ("ghost",))


def test_in_a_scene_it_does_not_apply() -> None:
    assert lateral(traffic(Frame(), aside_m=5.0, rules="scene")).verdict == NOT_APPLICABLE
