"""Lanes and road edges of OSI: in driving order, joined from boundaries, damaged ones told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from istc_replay.datatypes import LaneLine, Log, StaticScene
from istc_replay.ingest.log import read_log

from ..support.logs import T0_NS, Topic, write_log

Points = list[tuple[float, float]]


@pytest.fixture
def truth(osi: Callable[[str], Any]) -> Any:
    """A ground truth with one car."""
    made = osi("GroundTruth")()
    made.timestamp.seconds = 1
    car = made.moving_object.add()
    car.id.value = 1
    car.base.position.x = car.base.position.y = 1.0
    car.base.dimension.length, car.base.dimension.width = 4.5, 1.8
    return made


@pytest.fixture
def read(save: Any, osi_descriptor: bytes) -> Callable[..., Log]:
    """A function that logs messages as OSI and reads them."""

    def as_log(*truths: Any) -> Log:
        told = [(T0_NS + row, each.SerializeToString()) for row, each in enumerate(truths)]
        return read_log(save(write_log(Topic("osi", told, "osi3.GroundTruth", schema_data=osi_descriptor))))

    return as_log


def bound(truth: Any, number: int, points: Points, kind: int = 3) -> None:
    """Add a boundary."""
    made = truth.lane_boundary.add()
    made.id.value, made.classification.type = number, kind
    for x, y in points:
        place = made.boundary_line.add().position
        place.x, place.y = x, y


def lane(
    truth: Any, number: int, line: Points, left: list[int], right: list[int], *, forward: bool = True
) -> Any:
    """Add a lane on which cars drive."""
    made = truth.lane.add()
    made.id.value = number
    kind = made.classification
    kind.type, kind.centerline_is_driving_direction = 2, forward
    for x, y in line:
        place = kind.centerline.add()
        place.x, place.y = x, y
    for ids, numbers in ((kind.left_lane_boundary_id, left), (kind.right_lane_boundary_id, right)):
        for each in numbers:
            ids.add().value = each
    return made


def lanes(scene: StaticScene) -> dict[str, LaneLine]:
    """Lane lines by their ids."""
    return {line.lane_id: line for line in scene.lane_lines}


def test_the_lanes_of_a_third_party_log_are_those_of_its_messages(shared_logs: Path) -> None:
    path = shared_logs / "third_party/acc-test.mcap"
    scene = read_log(path).scene
    with path.open("rb") as stream:
        schema, _, message = next(iter(make_reader(stream).iter_messages()))
    assert schema is not None
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    truth = message_factory.GetMessageClass(pool.FindMessageTypeByName("osi3.GroundTruth"))()
    truth.ParseFromString(message.data)
    bounds = {
        b.id.value: np.array([(p.position.x, p.position.y) for p in b.boundary_line])
        for b in truth.lane_boundary
    }
    driven = {str(e.id.value): e.classification for e in truth.lane if e.classification.type == 2}
    found = lanes(scene)
    assert found.keys() == driven.keys() == {"2", "4"}
    for name, kind in driven.items():
        line = np.array([(p.x, p.y) for p in kind.centerline])
        left, right = (
            bounds[ids[0].value] for ids in (kind.left_lane_boundary_id, kind.right_lane_boundary_id)
        )
        if not kind.centerline_is_driving_direction:
            line, left, right = line[::-1], right[::-1], left[::-1]
        np.testing.assert_array_equal(found[name].points_m, line)
        np.testing.assert_array_equal(found[name].left_m, left)
        np.testing.assert_array_equal(found[name].right_m, right)


def test_edges_lie_to_the_left_and_right_of_the_way_driven(truth: Any, read: Callable[..., Log]) -> None:
    bound(truth, 1, [(100.0, 4.0), (0.0, 4.0)])  # told against the lane's direction
    bound(truth, 2, [(0.0, 0.0), (40.0, 0.0)])
    bound(truth, 3, [(100.0, 0.0), (40.0, 0.0)], kind=6)  # the second half of a side, and the road's edge
    lane(truth, 10, [(0.0, 2.0), (100.0, 2.0)], [1], [2, 3])
    lane(truth, 11, [(0.0, 2.0), (100.0, 2.0)], [1], [2, 3], forward=False)
    log = read(truth)
    assert log.problems == ()
    (east, west), (edge,) = log.scene.lane_lines, log.scene.road_edges
    assert east.left_m is not None
    assert east.right_m is not None
    assert east.left_m.tolist() == [[0.0, 4.0], [100.0, 4.0]]
    assert east.right_m.tolist() == [[0.0, 0.0], [40.0, 0.0], [40.0, 0.0], [100.0, 0.0]]
    assert west.points_m.tolist() == [[100.0, 2.0], [0.0, 2.0]]
    assert west.left_m is not None
    assert west.left_m[[0, -1]].tolist() == [[100.0, 0.0], [0.0, 0.0]]
    assert edge.edge_id == "3"


def test_what_is_told_once_or_late_or_again_makes_one_lane(
    truth: Any, osi: Callable[[str], Any], read: Callable[..., Log]
) -> None:
    lane(truth, 10, [], [1], [2])
    later = osi("GroundTruth").FromString(truth.SerializeToString())
    bound(later, 1, [(0.0, 4.0), (100.0, 4.0)])
    bound(later, 2, [(0.0, 0.0), (100.0, 0.0)])
    again = osi("GroundTruth").FromString(later.SerializeToString())
    later.timestamp.seconds, again.timestamp.seconds = 2, 3
    log = read(truth, later, again)
    (line,) = log.scene.lane_lines
    assert not any(problem.code == "lanes" for problem in log.problems)
    assert line.points_m.tolist() == [[0.0, 2.0], [100.0, 2.0]]  # its middle, where no line is told


def test_a_damaged_lane_is_a_problem_and_the_others_are_read(truth: Any, read: Callable[..., Log]) -> None:
    bound(truth, 1, [(0.0, 4.0), (100.0, 4.0)])
    bound(truth, 2, [(0.0, float("nan")), (100.0, 0.0)])
    bound(truth, 3, [(0.0, 0.0), (0.0, 0.0)])
    lane(truth, 10, [(0.0, 2.0), (100.0, 2.0)], [1], [2])  # its right side is damaged: a line alone
    lane(truth, 11, [(0.0, 2.0), (float("inf"), 2.0)], [], [])
    lane(truth, 12, [(0.0, 2.0)], [], [])
    lane(truth, 13, [(0.0, 9.0), (50.0, 9.0)], [], [])  # tells no sides
    walk = lane(truth, 14, [(0.0, 9.0), (50.0, 9.0)], [1], [1])
    walk.classification.type = 3
    log = read(truth)
    assert [(line.lane_id, line.left_m) for line in log.scene.lane_lines] == [("10", None), ("13", None)]
    told = [problem.detail for problem in log.problems if problem.code == "lanes"]
    for part in ("not finite", "boundary 3 needs two", "lane 10 names a boundary", "lane 12 is left out"):
        assert any(part in detail for detail in told), part
    assert log.complete
    assert log.states.height == 1


def test_an_intersection_is_an_area_between_its_free_boundaries(truth: Any, read: Callable[..., Log]) -> None:
    # Four corners, told in any order and direction; roads join between them.
    bound(truth, 1, [(10.0, 4.0), (6.0, 6.0), (4.0, 10.0)])
    bound(truth, 2, [(-4.0, -10.0), (-6.0, -6.0), (-10.0, -4.0)])
    bound(truth, 3, [(10.0, -4.0), (6.0, -6.0), (4.0, -10.0)])
    bound(truth, 4, [(-10.0, 4.0), (-6.0, 6.0), (-4.0, 10.0)])
    crossing = lane(truth, 60, [], [], [])
    crossing.classification.type = 4
    for number in (1, 2, 3, 4):
        crossing.classification.free_lane_boundary_id.add().value = number
    scene = read(truth).scene
    (area,) = scene.road_areas
    assert scene.lane_lines == ()
    quarter = [(10, 4), (6, 6), (4, 10)]
    left = [(-x, y) for x, y in reversed(quarter)]
    whole = [*quarter, *left, *((x, -y) for x, y in reversed(left)), *((x, -y) for x, y in reversed(quarter))]
    assert shapely.Polygon(area.points_m).equals(shapely.Polygon(whole))


def test_logical_lanes_are_read_where_there_are_no_physical_ones(
    truth: Any, read: Callable[..., Log]
) -> None:
    for number, y in ((1, 4.0), (2, 0.0)):
        made = truth.logical_lane_boundary.add()
        made.id.value = number
        for x in (0.0, 80.0):
            place = made.boundary_line.add().position
            place.x, place.y = x, y
    made = truth.logical_lane.add()
    made.id.value = 5
    made.type = made.Type.TYPE_NORMAL
    made.move_direction = made.MoveDirection.MOVE_DIRECTION_DECREASING_S
    made.left_boundary_id.add().value = 1
    made.right_boundary_id.add().value = 2
    (line,) = read(truth).scene.lane_lines
    assert line.points_m.tolist() == [[80.0, 2.0], [0.0, 2.0]]
    assert line.left_m is not None
    assert line.left_m.tolist() == [[80.0, 0.0], [0.0, 0.0]]
