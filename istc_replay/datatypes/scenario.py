"""One window to plan: its frame, who takes part, what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass

from istc_replay.datatypes.arrays import FloatArray
from istc_replay.datatypes.scene import Dimensions

#: So many vehicles among standing obstacles make a crowded scene; so many at most are a small crowd.
CROWD, SMALL_CROWD = 4, 4
#: Below this speed a recorded vehicle counts as standing.
STANDING_MPS = 0.5


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

    @property
    def ends_standing(self) -> bool:
        """Whether the vehicle stands at its end: it has a goal, and that is where."""
        return bool(self.speeds_mps[-1] < STANDING_MPS)


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
