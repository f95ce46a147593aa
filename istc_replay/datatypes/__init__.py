"""The plain data that flows from the log to the outputs.

Shapes, once for the whole project: V vehicles, K time units (corridor-cubes) of one vehicle,
S samples of one trajectory, P points of one polyline, N time units of one window.

Frames: the *map frame* is the log's own, right-handed, x east, y north, yaw counter-clockwise
from +x in [-pi, pi). The *corridor frame* of a window is the map frame moved and turned by
`Frame`; guidance, corridors and trajectories are solved in it, and cubes stay in it. A vehicle's
reference point is the centre of its box everywhere except in `Trajectory.states`, whose
kinematic bicycle lives on the rear axle.

Arrays are float64 and read-only.
"""

from istc_replay.datatypes.arrays import FloatArray, read_only
from istc_replay.datatypes.certificates import Certificate, Verdict
from istc_replay.datatypes.corridors import Conflict, Corridor, Corridors
from istc_replay.datatypes.guidance import Guidance
from istc_replay.datatypes.log import ChannelInfo, Log, Problem
from istc_replay.datatypes.outcome import (
    ARRIVED_M,
    SOUND,
    Change,
    RecordedGap,
    WindowOutcome,
    WindowPlan,
    WindowStatus,
)
from istc_replay.datatypes.result import Result
from istc_replay.datatypes.scenario import (
    CROWD,
    SMALL_CROWD,
    STANDING_MPS,
    Exclusion,
    Frame,
    LateralBound,
    Obstacle,
    Participant,
    Recording,
    Scenario,
    StartState,
    Window,
)
from istc_replay.datatypes.scene import (
    Dimensions,
    LaneLine,
    MapBounds,
    RoadArea,
    RoadEdge,
    SceneObstacle,
    StaticScene,
    VehicleInfo,
)
from istc_replay.datatypes.solves import SolveRecord, SolveStatus
from istc_replay.datatypes.trajectories import Lateral, Trajectory, Undrivable

__all__ = [
    "ARRIVED_M",
    "CROWD",
    "SMALL_CROWD",
    "SOUND",
    "STANDING_MPS",
    "Certificate",
    "Change",
    "ChannelInfo",
    "Conflict",
    "Corridor",
    "Corridors",
    "Dimensions",
    "Exclusion",
    "FloatArray",
    "Frame",
    "Guidance",
    "LaneLine",
    "Lateral",
    "LateralBound",
    "Log",
    "MapBounds",
    "Obstacle",
    "Participant",
    "Problem",
    "RecordedGap",
    "Recording",
    "Result",
    "RoadArea",
    "RoadEdge",
    "Scenario",
    "SceneObstacle",
    "SolveRecord",
    "SolveStatus",
    "StartState",
    "StaticScene",
    "Trajectory",
    "Undrivable",
    "VehicleInfo",
    "Verdict",
    "Window",
    "WindowOutcome",
    "WindowPlan",
    "WindowStatus",
    "read_only",
]
