"""The sample scenes by name, and scenes of one's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from istc_replay.errors import UsageError
from istc_replay.samples.drive import RecordedScene
from istc_replay.samples.intersection import intersection

#: Priority weights eta of Table II by vehicle.
TURN_FIRST = {"1": 0.20, "2": 0.01, "3": 0.50}
STRAIGHT_FIRST = {"1": 0.50, "2": 0.40, "3": 0.01}


@dataclass(frozen=True, slots=True)
class Sample:
    """A named sample: what it shows, in which format it is written, and how it is recorded."""

    description: str
    format: str
    record: Callable[[], RecordedScene]


SAMPLES: dict[str, Sample] = {
    "intersection_turn_first": Sample(
        "three vehicles meet at an unsignalised intersection; the left-turning one has the highest priority",
        "istc",
        lambda: intersection("intersection_turn_first", TURN_FIRST),
    ),
    "intersection_straight_first": Sample(
        "the same intersection; the two that go straight on have the highest priorities",
        "istc",
        lambda: intersection("intersection_straight_first", STRAIGHT_FIRST),
    ),
    "intersection_osi": Sample(
        "the same intersection as ASAM OSI GroundTruth, which carries no lanes and priorities here",
        "osi",
        lambda: intersection("intersection_osi", TURN_FIRST),
    ),
    "intersection_odometry": Sample(
        "the same intersection as ROS 2 odometry, which carries no dimensions, lanes and priorities",
        "odometry",
        lambda: intersection("intersection_odometry", TURN_FIRST),
    ),
}


def sample_names() -> dict[str, str]:
    """Return every sample's name with a line that says what it shows."""
    return {name: sample.description for name, sample in SAMPLES.items()}


def find_sample(name: str) -> Sample:
    """Return the sample of this name.

    Raises
    ------
    UsageError
        If there is none; the message lists the names.
    """
    if name not in SAMPLES:
        raise UsageError(f"no sample is named {name!r}; there are {', '.join(SAMPLES)}")
    return SAMPLES[name]
