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

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import polars as pl

FloatArray = NDArray[np.float64]

#: So many vehicles among standing obstacles make a crowded scene; so many at most are a small crowd.
CROWD, SMALL_CROWD = 4, 4


def read_only(values: ArrayLike, columns: int | None = None) -> FloatArray:
    """Copy values into a read-only float64 array, of shape (n, columns) where columns is given."""
    array = np.array(values, dtype=np.float64)
    if columns is not None:
        array = array.reshape(-1, columns)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True)
class Dimensions:
    """A vehicle's box and axles [m].

    `rear_axle_to_centre_m` is the distance from the rear axle forward to the box centre:
    wheelbase / 2 + (front overhang - rear overhang) / 2.
    """

    length_m: float
    width_m: float
    wheelbase_m: float
    rear_axle_to_centre_m: float


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the input that is damaged, not understood or left out.

    `code` is a stable lower_snake_case word, `detail` one line for people, `offset` the byte in
    the file where one is known.
    """

    code: str
    detail: str
    offset: int | None = None


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """One channel of a log, as `info` tells it.

    `understood_as` is None where it is not read; `reason` says why nothing of it is used. The log
    times `first_ns` and `last_ns` are None without messages.
    """

    topic: str
    schema: str
    schema_encoding: str
    message_encoding: str
    messages: int
    understood_as: str | None
    reason: str = ""
    first_ns: int | None = None
    last_ns: int | None = None


# --- the static scene of a log ---------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class LaneLine:
    """A lane's centre line (P, 2) in driving order [m, map frame]; `vehicle_id` says whose intent it is.

    `left_m` (L, 2) and `right_m` (R, 2) are its edges in driving order: both, or None where they are
    not known. What lies between the edges of all lanes, and in areas, is the road.
    """

    lane_id: str
    points_m: FloatArray
    vehicle_id: str | None = None
    left_m: FloatArray | None = None
    right_m: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RoadEdge:
    """What no vehicle drives across, a polyline (P, 2) [m, map frame]."""

    edge_id: str
    points_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RoadArea:
    """A part of the road told by its outline (P, 2) [m, map frame]; the last point joins the first."""

    area_id: str
    points_m: FloatArray


@dataclass(frozen=True, slots=True)
class SceneObstacle:
    """A standing oriented box [m, rad, map frame]."""

    obstacle_id: str
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float


@dataclass(frozen=True, slots=True)
class MapBounds:
    """The axis-aligned rectangle of the map frame that no vehicle leaves [m]."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float


@dataclass(frozen=True, slots=True)
class VehicleInfo:
    """What the log says of a vehicle once and for all; None where it is silent."""

    vehicle_id: str
    priority: float | None = None
    dimensions: Dimensions | None = None


@dataclass(frozen=True, slots=True)
class StaticScene:
    """Lane lines, obstacles, bounds, per-vehicle facts, road edges and road areas of a log."""

    lane_lines: tuple[LaneLine, ...] = ()
    obstacles: tuple[SceneObstacle, ...] = ()
    bounds: MapBounds | None = None
    vehicles: tuple[VehicleInfo, ...] = ()
    road_edges: tuple[RoadEdge, ...] = ()
    road_areas: tuple[RoadArea, ...] = ()

    @property
    def edges_m(self) -> list[FloatArray]:
        """All polylines (P, 2) that edge the road: of its lanes and areas, and what nobody drives across."""
        sides = [side for line in self.lane_lines for side in (line.left_m, line.right_m)]
        known = [side for side in sides if side is not None] + [edge.points_m for edge in self.road_edges]
        return known + [np.vstack([area.points_m, area.points_m[:1]]) for area in self.road_areas]


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A log as read: the states table (see `states.STATES_SCHEMA`) and what else it told."""

    path: str
    sha256: str
    complete: bool
    messages: int
    attachments: int
    metadata: int
    chunks: int
    start_ns: int | None
    end_ns: int | None
    channels: tuple[ChannelInfo, ...]
    states: pl.DataFrame
    scene: StaticScene
    problems: tuple[Problem, ...]
    time_source: str = "header"
    road_sha256: str = ""  # of the road file beside it


# --- a window's scenario ---------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Frame:
    """The corridor frame: its origin and yaw in the map frame [m, rad]."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Window:
    """A span of the log, cut into `units` time units of `unit_s` seconds."""

    index: int
    start_ns: int
    end_ns: int
    unit_s: float
    units: int
    frame: Frame


@dataclass(frozen=True, slots=True)
class StartState:
    """Where a vehicle starts: box centre, heading and speed, in the corridor frame.

    Steering and acceleration are None where the recording does not know them: the plan is then
    free to choose them within the limits.
    """

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float
    steering_rad: float | None = None
    acceleration_mps2: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A vehicle's recorded motion in one window, box centre, corridor frame.

    `times_s` (S,) from the window's start, `poses` (S, 3) x, y, unwrapped heading,
    `speeds_mps` (S,).
    """

    times_s: FloatArray
    poses: FloatArray
    speeds_mps: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LateralBound:
    """How far a vehicle of traffic may leave its recorded path sideways, map or corridor frame.

    `path_m` (P, 2) is the path, straight on beyond its ends. To its left and right at each point,
    `edge_m` (P, 2) is how far away the road's edge is, within which the box has to stay, and `offset_m`
    (P, 2) how far the centre may be from the path; NaN where the other of the two holds. `lateral_m` is
    the offset where nothing tells of the road. `off_road_m` is how far the recorded box itself is
    beyond the edge.
    """

    path_m: FloatArray
    edge_m: FloatArray
    offset_m: FloatArray
    lateral_m: float
    off_road_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Participant:
    """A vehicle that takes part in units first_unit .. first_unit + units - 1 of a window."""

    vehicle_id: str
    dimensions: Dimensions
    priority: float
    first_unit: int
    units: int
    start: StartState
    recording: Recording
    lane_m: FloatArray | None = None  # (P, 2) of its intent, corridor frame
    approach: FloatArray | None = None  # (P, 3) recorded path before a start that was handed over
    ahead: FloatArray | None = None  # (P, 4) time, pose: how the plan that handed it over would have gone on
    route: Recording | None = None  # of a scene that is planned in steps: recorded before and after too
    dimensions_source: str = "log"  # log, config or default
    lateral: LateralBound | None = None  # in traffic

    @property
    def goes_on(self) -> bool:
        """Whether it is on its way beyond the window, and need not have arrived in the end."""
        return self.route is not None and float(self.route.times_s[-1]) > self.recording.times_s[-1] + 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """Axis-aligned boxes of one obstacle, one row a unit of the window.

    `boxes_m` (N, 4): x_min, x_max, y_min, y_max in the corridor frame; NaN where absent.
    `outline_m` (4, 2) is the true outline where it stands still, else None.
    """

    obstacle_id: str
    boxes_m: FloatArray
    outline_m: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A vehicle that is not planned, and why (a stable code and a line for people)."""

    vehicle_id: str
    reason: str
    detail: str


@dataclass(frozen=True, slots=True)
class Scenario:
    """One window to plan: who takes part, what stands in the way, who was left out."""

    window: Window
    participants: tuple[Participant, ...]
    obstacles: tuple[Obstacle, ...]
    bounds_m: tuple[float, float, float, float] | None  # corridor frame, x_min x_max y_min y_max
    excluded: tuple[Exclusion, ...] = ()
    vehicles_present: int = 0
    traffic: bool = False  # planned by the rules for recorded traffic

    @property
    def crowded(self) -> bool:
        """A scene of four vehicles or more among standing obstacles: planned from seeds, in short units."""
        standing = any(obstacle.outline_m is not None for obstacle in self.obstacles)
        return standing and not self.traffic and len(self.participants) >= CROWD

    @property
    def small_crowd(self) -> bool:
        """A crowded scene of so few that the conflict tree may hold it: tried before seeds."""
        return self.crowded and len(self.participants) <= SMALL_CROWD


# --- the two layers --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Guidance:
    """A vehicle's guidance trajectory, box centre, corridor frame.

    `points_m` (K+1, 2) and `headings_rad` (K+1,) at the unit boundaries of the vehicle, the
    first at its start; `times_s` (S,) from the window's start and `poses` (S, 3) for drawing
    and as the NLP's first guess. `kind` is recorded or lane. `slack_rad` (K+1,) is how far from
    its heading the car may turn, None where the configuration tells it. `motion` is the drivable
    motion that it tells of, where there is one: a plan that needs no change. `others` are other
    routes (R, 3) of the rear axle between its ends, in a crowded scene.
    """

    vehicle_id: str
    kind: str
    points_m: FloatArray
    headings_rad: FloatArray
    speed_mps: float
    times_s: FloatArray
    poses: FloatArray
    slack_rad: FloatArray | None = None
    motion: Trajectory | None = None
    others: tuple[FloatArray, ...] = ()


class SolveStatus(StrEnum):
    """How a solve ended."""

    OPTIMAL = "optimal"  # proven within the tolerance asked for
    FEASIBLE = "feasible"  # a solution, its optimality not proven
    INFEASIBLE = "infeasible"
    LIMIT = "limit"  # the budget ended first, with no solution
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class SolveRecord:
    """One call of one solver, as the solves table tells it."""

    layer: str  # corridors or trajectory
    stage: str
    solver: str
    status: SolveStatus
    vehicle_id: str | None = None
    objective: float | None = None
    bound: float | None = None
    gap: float | None = None
    wall_s: float | None = None
    iterations: int | None = None
    nodes: int | None = None
    binaries: int | None = None
    detail: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """The spatio-temporal corridor of one vehicle, eq. (1), corridor frame.

    `cubes_m` (K, 4): x_min, x_max, y_min, y_max of unit first_unit + row.
    `pivots_m` (K+1, 2) and `references_m` (K+1, 2) at the unit boundaries.
    """

    vehicle_id: str
    first_unit: int
    cubes_m: FloatArray
    pivots_m: FloatArray
    references_m: FloatArray


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two road users that were not kept apart, and in which time unit."""

    first: str
    second: str
    unit: int


@dataclass(frozen=True, slots=True)
class Corridors:
    """The interactive spatio-temporal corridors of one window, eq. (4).

    `corridors` is empty unless status is optimal or feasible. `gap` = (objective - bound) /
    max(1, |objective|). `reason` says in one line why there is no solution, or what of this one is out of
    the ordinary, `culprits` which vehicles (or pairs of road users) are in the way of one, and `conflicts`
    where pairs meet. `frames` are the guidance that eq. (9) to (12) were written about, one a corridor.
    """

    status: SolveStatus
    corridors: tuple[Corridor, ...] = ()
    frames: tuple[Guidance, ...] = ()
    objective: float | None = None
    bound: float | None = None
    gap: float | None = None
    found_by: str = ""
    reason: str = ""
    records: tuple[SolveRecord, ...] = ()
    culprits: tuple[tuple[str, ...], ...] = ()
    conflicts: tuple[Conflict, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """An in-corridor trajectory, eq. (16): rear axle, corridor frame.

    `times_s` (S,) from the window's start. `states` (S, 6): x, y, heading (unwrapped), steering
    delta, speed v, acceleration a of the rear axle. `controls` (S-1, 2): steering rate beta and
    jerk j, each held from its sample to the next.
    """

    vehicle_id: str
    dimensions: Dimensions
    times_s: FloatArray
    states: FloatArray
    controls: FloatArray
    cost: float
    costs: dict[str, float] = field(default_factory=dict)  # smoothness, comfort, pivotal


@dataclass(frozen=True, slots=True)
class Undrivable:
    """Where a vehicle cannot be driven in its corridor: the unit, and how far it would stick out."""

    vehicle_id: str
    unit: int
    slack_m: float
    detail: str


class Verdict(StrEnum):
    """The outcome of one check; inconclusive is never pass."""

    PASS = "pass"  # noqa: S105
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
    NOT_APPLICABLE = "not_applicable"


@dataclass(frozen=True, slots=True)
class Certificate:
    """One check of one plan: its verdict, the least margin, and the witness.

    `margin` is in `unit`, negative where the check fails; `time_s` (from the window's start),
    `vehicles` and `detail` name the place of the least margin.
    """

    window: int
    check: str
    verdict: Verdict
    margin: float | None
    unit: str
    time_s: float | None = None
    vehicles: tuple[str, ...] = ()
    detail: str = ""


#: A vehicle that ends its recording standing has arrived where its plan ends this near.
ARRIVED_M = 1.0


class WindowStatus(StrEnum):
    """How a window ended."""

    CERTIFIED = "certified"  # every plannable vehicle has a plan, every check passes
    PARTIAL = "partial"  # some plannable vehicles stay as recorded, the others' plans pass every check
    NOT_CERTIFIED = "not_certified"  # a plan, but a check fails or cannot be judged
    GOAL_NOT_REACHED = "goal_not_reached"  # every check passes, but a scene's vehicle ends elsewhere
    CONFLICT_LEFT = "conflict_left"  # no corridors: a pair is not kept apart in a time unit
    NO_CORRIDORS = "no_corridors"  # for any other reason
    NOT_DRIVABLE = "not_drivable"  # corridors, but a vehicle sticks out of its own in a time unit
    NOTHING_TO_PLAN = "nothing_to_plan"


#: Statuses of windows whose plans pass every check.
SOUND = frozenset({WindowStatus.CERTIFIED, WindowStatus.PARTIAL, WindowStatus.GOAL_NOT_REACHED})


@dataclass(frozen=True, slots=True)
class Lateral:
    """How a plan of traffic keeps its lateral bound.

    `bounds` are what holds somewhere along its path: road, path, recording (which is itself at the
    road's edge). `excursion_m` is the largest distance of the centre from the recorded path,
    `margin_m` the least room left, and `bound` what bounds it there. `off_road_m` is how far the
    recorded box is beyond the road's edge; `sample` is the number of the pose of the least margin.
    """

    vehicle_id: str
    bounds: tuple[str, ...]
    excursion_m: float
    margin_m: float
    bound: str
    off_road_m: float = 0.0
    sample: int = 0


@dataclass(frozen=True, slots=True)
class WindowPlan:
    """A window's whole result before it is certified.

    `frozen` vehicles could have been planned but stay as recorded: obstacles to the others. The
    gaps [m] are those that layer 1 promised, None where they are the configuration's. `late` are vehicles
    of a scene that do not come to their goals.
    """

    scenario: Scenario
    status: WindowStatus
    reason: str = ""
    guidance: tuple[Guidance, ...] = ()
    corridors: Corridors | None = None
    trajectories: tuple[Trajectory, ...] = ()
    undrivable: tuple[Undrivable, ...] = ()
    rounds: int = 1
    records: tuple[SolveRecord, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    frozen: tuple[Exclusion, ...] = ()
    vehicle_gap_m: float | None = None
    obstacle_gap_m: float | None = None
    lateral: tuple[Lateral, ...] = ()
    late: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordedGap:
    """The least gap of two recorded boxes (negative: they overlap), whose, and when."""

    min_separation_m: float
    pair: tuple[str, str]
    time_ns: int


@dataclass(frozen=True, slots=True)
class Change:
    """What a plan changed of one vehicle's guidance; zeros where nothing had to change.

    `delay_s`: at the plan's end, later (negative: earlier) than the guidance at the same place.
    `deviation_m`, `lateral_m`: the largest distance from the guidance at the same instant, and
    across its path. `acceleration_rms_mps2`, `braking_mps2`: rise of the root mean square
    acceleration, and of the hardest braking. `clearance_m`: least gap to any other road user as
    planned, and `clearance_gained_m` what that is more than by guidance; None where nobody is near.
    """

    vehicle_id: str
    changed: bool
    delay_s: float = 0.0
    deviation_m: float = 0.0
    lateral_m: float = 0.0
    acceleration_rms_mps2: float = 0.0
    braking_mps2: float = 0.0
    clearance_m: float | None = None
    clearance_gained_m: float | None = None


@dataclass(frozen=True, slots=True)
class WindowOutcome:
    """A window's plan as its certificates judge it, the least gap of its recording, and both compared.

    `changes` are what coordination changed of the guidance, for vehicles that have a trajectory.
    """

    plan: WindowPlan
    certificates: tuple[Certificate, ...] = ()
    recorded: RecordedGap | None = None
    against_plan: tuple[dict[str, Any], ...] = ()  # rows of AGAINST_PLAN_SCHEMA
    changes: tuple[Change, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """A result as read back from a result.mcap, the same truth that every view shows.

    Tables have the columns of the contract (see `states.py`); positions of `states` are box
    centres in the map frame. `corridors` and `obstacles` are in the window's corridor frame.
    """

    path: str
    states: pl.DataFrame
    corridors: pl.DataFrame
    obstacles: pl.DataFrame
    solves: pl.DataFrame
    certificates: pl.DataFrame
    findings: pl.DataFrame
    scene: StaticScene
    summary: dict[str, Any]
    config_toml: str
