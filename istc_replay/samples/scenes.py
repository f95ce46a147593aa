"""The sample scenes by name, and scenes of one's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

from istc_replay.config import GuidanceConfig
from istc_replay.datatypes import CROWD, MapBounds, SceneObstacle, StaticScene, VehicleInfo
from istc_replay.errors import ScenarioError, UsageError
from istc_replay.guidance.curves import Curve, Pose
from istc_replay.guidance.routes import Task, find_paths
from istc_replay.samples.drive import Drive, RecordedScene, record_drives
from istc_replay.samples.intersection import START_NS, intersection
from istc_replay.samples.pace import Pace
from istc_replay.samples.sceneform import Box, SceneFile, ScenePose, parse_scene

#: Priority weights eta of Table II by vehicle.
TURN_FIRST = {"1": 0.20, "2": 0.01, "3": 0.50}
STRAIGHT_FIRST = {"1": 0.50, "2": 0.40, "3": 0.01}

_STEERING_MAX_RAD = 0.6
_DECELERATION_MPS2 = 2.0
_STANDING_S = 3  # recorded after the last arrival
_STANDING_CROWDED_S = 6  # the same where openings are passed in turn
_MANY, _STANDING_MANY_S = 6, 8  # the same by so many vehicles
_ONE_WINDOW_S = 20  # unless that made a second window
_DURATION_MAX_S = 900
_COUNTS = {4: "four", 6: "six", 8: "eight"}
#: Larger crossings without obstacles.
_LARGE = {12: "twelve", 16: "sixteen", 24: "twenty-four"}
_BLOCKS = {"": "no lanes", "_obstacles": "two blocks in the way", "_row": "three blocks in a row in the way"}
#: Dense crossings whose logs lie in sample_logs/; the others are made by name.
_DENSE_LOGS = ("dense_4", "dense_8")


@dataclass(frozen=True, slots=True)
class Sample:
    """A named sample: what it shows, in which format it is written, and how it is recorded.

    `has_log` tells whether its log lies in sample_logs/; `scene` names its packaged scene, if it has one.
    """

    description: str
    format: str
    record: Callable[[], RecordedScene]
    has_log: bool = True
    scene: str | None = None

    def recorded(self, settings: GuidanceConfig) -> RecordedScene:
        """Record it with these settings, which matter where routes are searched for."""
        return self.record() if self.scene is None else record(packaged_scene(self.scene), settings)


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


def _dense(name: str, description: str) -> Sample:
    return Sample(description, "istc", lambda: record(packaged_scene(name)), name in _DENSE_LOGS, name)


SAMPLES |= {
    f"dense_{count}{kind}": _dense(
        f"dense_{count}{kind}",
        f"{word} vehicles cross a map of 50 m x 38 m from its sides, with {blocks}",
    )
    for count, word in _COUNTS.items()
    for kind, blocks in _BLOCKS.items()
}


SAMPLES |= {
    f"dense_{count}": _dense(f"dense_{count}", f"{word} vehicles cross an open map from its sides")
    for count, word in _LARGE.items()
}


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


def record(scene: SceneFile, settings: GuidanceConfig | None = None) -> RecordedScene:
    """Record a scene in which every vehicle drives its own short path and ignores the others.

    Each drives at the scene's speed, brakes at 2 m/s^2 to stand at its goal, and stays.

    Parameters
    ----------
    scene : SceneFile
        The scene.
    settings : GuidanceConfig, optional
        How paths are found; the defaults otherwise.

    Raises
    ------
    ScenarioError
        If a vehicle has no path past the obstacles, or the recording would be too long.
    """
    drives = _drives(scene, settings or GuidanceConfig())
    crowded = bool(scene.obstacles) and len(scene.vehicles) >= CROWD
    arrival_s = math.ceil(max(drive.pace.arrival_s for drive in drives) - 1e-9)
    standing_s = _STANDING_S
    if crowded:
        wanted_s = _STANDING_MANY_S if len(scene.vehicles) >= _MANY else _STANDING_CROWDED_S
        standing_s = max(_STANDING_CROWDED_S, min(wanted_s, _ONE_WINDOW_S - arrival_s))
    duration_s = arrival_s + standing_s
    if duration_s > _DURATION_MAX_S:
        raise ScenarioError(
            f"scene {scene.name}: the recording would last {duration_s} s, at most {_DURATION_MAX_S} s are "
            "written; raise speed_mps or bring the goals nearer"
        )
    return record_drives(scene.name, _static_scene(scene), drives, START_NS, duration_s)


def packaged_scene(name: str) -> SceneFile:
    """Return a scene file that comes with the package."""
    text = resources.files("istc_replay").joinpath(f"data/{name}.json").read_text(encoding="utf-8")
    return parse_scene(text, name)


def _drives(scene: SceneFile, settings: GuidanceConfig) -> list[Drive]:
    car = scene.vehicle.dimensions
    least_radius_m = car.wheelbase_m / math.tan(_STEERING_MAX_RAD)
    if scene.vehicle.min_turn_radius_m is not None:
        least_radius_m = max(least_radius_m, scene.vehicle.min_turn_radius_m)
    tasks = [Task(v.id, _pose(v.start), _pose(v.goal), car, least_radius_m) for v in scene.vehicles]
    obstacles = _static_scene(scene).obstacles
    try:
        paths = find_paths(tasks, _bounds(scene), obstacles, settings, scene.speed_mps)
    except ScenarioError as error:
        raise ScenarioError(f"guidance missing: scene {scene.name}: {error}") from None
    return [_drive(task, path, scene.speed_mps) for task, path in zip(tasks, paths, strict=True)]


def _drive(task: Task, path: Curve, speed_mps: float) -> Drive:
    # A path too short to brake on from full speed is driven more slowly.
    speed = min(speed_mps, math.sqrt(2.0 * _DECELERATION_MPS2 * path.length_m))
    return Drive(task.vehicle_id, task.car, path, Pace(speed, path.length_m, _DECELERATION_MPS2))


def _bounds(scene: SceneFile) -> MapBounds:
    return MapBounds(scene.map.x_min_m, scene.map.x_max_m, scene.map.y_min_m, scene.map.y_max_m)


def _pose(pose: ScenePose) -> Pose:
    return Pose(pose.x_m, pose.y_m, pose.heading_rad)


def _static_scene(scene: SceneFile) -> StaticScene:
    car = scene.vehicle.dimensions
    return StaticScene(
        obstacles=tuple(_obstacle(index, box) for index, box in enumerate(scene.obstacles, start=1)),
        bounds=_bounds(scene),
        vehicles=tuple(VehicleInfo(vehicle.id, dimensions=car) for vehicle in scene.vehicles),
    )


def _obstacle(index: int, box: Box) -> SceneObstacle:
    return SceneObstacle(
        obstacle_id=f"obstacle_{index}",
        x_m=(box.x_min_m + box.x_max_m) / 2.0,
        y_m=(box.y_min_m + box.y_max_m) / 2.0,
        heading_rad=0.0,
        length_m=box.x_max_m - box.x_min_m,
        width_m=box.y_max_m - box.y_min_m,
    )
