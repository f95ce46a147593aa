"""What Foxglove shows of messages, at an instant."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import (
    Log,
    WindowPlan,
)
from istc_replay.export.foxglove import foxglove_messages

Plan = tuple[Log, list[WindowPlan]]
Messages = dict[str, list[tuple[int, Any]]]
S = 1_000_000_000


def by_topic(stamped: Iterable[tuple[int, str, Any]]) -> Messages:
    found: Messages = defaultdict(list)
    for time_ns, topic, message in stamped:
        found[topic].append((time_ns, message))
    return found


def made(log: Log, plans: list[WindowPlan]) -> Messages:
    return by_topic(foxglove_messages(log, plans, [plan.scenario.window for plan in plans], VehiclesConfig()))


def ns(stamp: Any) -> int:
    return int(stamp.seconds * S + stamp.nanos)


def yaw(rotation: Any) -> float:
    assert (rotation.x, rotation.y) == (0.0, 0.0)
    assert math.hypot(rotation.z, rotation.w) == pytest.approx(1.0, abs=1e-12)
    return 2.0 * math.atan2(rotation.z, rotation.w)


def corners(cube: Any) -> np.ndarray:
    """Corners of a cube of the scene, by its own pose and size, sorted."""
    turn = yaw(cube.pose.orientation)
    forward = np.array([math.cos(turn), math.sin(turn)]) * cube.size.x / 2.0
    left = np.array([-math.sin(turn), math.cos(turn)]) * cube.size.y / 2.0
    centre = np.array([cube.pose.position.x, cube.pose.position.y])
    points = [centre + a * forward + b * left for a in (1, -1) for b in (1, -1)]
    return np.array(sorted(tuple(np.round(point, 9)) for point in points))


def visible(messages: list[tuple[int, Any]], time_ns: int, after_seek: bool = False) -> dict[str, Any]:
    """The entities that a player shows at an instant, having played from the start or jumped there."""
    entities: dict[str, Any] = {}
    past = [message for at_ns, message in messages if at_ns <= time_ns]
    for message in past[-1:] if after_seek else past:
        entities.update({entity.id: entity for entity in message.entities})
    return {
        name: entity
        for name, entity in entities.items()
        if not ns(entity.lifetime) or time_ns < ns(entity.timestamp) + ns(entity.lifetime)
    }
