"""The configuration: one strict, frozen model, read from TOML.

Every key carries its unit as suffix. Defaults are the paper's (Tables I and II) where the paper
has them; docs/method.md says why for the others.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from istc_replay.audit_config import AuditConfig
from istc_replay.errors import ConfigError
from istc_replay.sections import Count, NonNegative, Positive, Section

#: What a field mapping can tell of a vehicle; docs/formats.md explains each.
FieldTarget = Literal[
    "vehicle_id",
    "vehicle_frame",
    "frame",
    "time",
    "time_ns",
    "time_s",
    "position",
    "x_m",
    "y_m",
    "latitude",
    "longitude",
    "orientation",
    "heading_rad",
    "heading_deg",
    "speed_mps",
    "velocity",
    "acceleration_mps2",
    "acceleration",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
    "length_m",
    "width_m",
    "wheelbase_m",
    "rear_axle_to_centre_m",
]
TopicFormat = Literal[
    "istc", "osi", "odometry", "pose", "tf", "autoware", "scene_update", "location", "fields", "ignore"
]


class TopicConfig(Section):
    """How to read one topic, where the schema alone does not tell."""

    format: TopicFormat | None = None
    """Read the topic as this format; unset: by `fields` if there are any, else recognised from its schema."""
    items: str = ""
    """Path of the repeated part of the message that holds a vehicle each; empty: one vehicle a message."""
    fields: dict[FieldTarget, str] = Field(default={})
    """Paths of the message's fields by what they tell, such as x_m = "pose.position.x"."""
    vehicle_id: str | None = None
    """The vehicle that the topic belongs to; unset: from the message or the topic's name."""
    reference_point: Literal["box_centre", "rear_axle", "base_link"] | None = None
    """Which point of the vehicle the positions name; unset: the format's own."""
    base_link_to_centre_m: float | None = None
    """Distance from base_link forward to the box centre; needed for base_link."""


#: What a column of a table can tell.
ColumnTarget = Literal[
    "vehicle_id",
    "role",
    "time_ns",
    "time_us",
    "time_ms",
    "time_s",
    "x_m",
    "y_m",
    "heading_rad",
    "heading_deg",
    "speed_mps",
    "velocity_x_mps",
    "velocity_y_mps",
    "acceleration_mps2",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
    "length_m",
    "width_m",
    "wheelbase_m",
    "rear_axle_to_centre_m",
]


class IngestConfig(Section):
    """Reading logs."""

    time_source: Literal["header", "log", "publish"] = "header"
    """Which time stamps the states: the message's own, the recorder's, or the publisher's."""
    odometry_reference_point: Literal["box_centre", "rear_axle", "base_link"] = "rear_axle"
    """What nav_msgs/Odometry poses name (Autoware: the rear axle)."""
    base_link_to_centre_m: float = 0.0
    """Distance from base_link forward to the box centre, for reference point base_link."""
    columns: dict[ColumnTarget, str] = Field(default={})
    """Columns of a table that `convert` reads, by what they tell, such as x_m = "utm_east"."""
    topics: dict[str, TopicConfig] = Field(default={})
    """Per topic, what differs from the above."""
    road_file: str | None = None
    """GeoJSON with lanes and road edges in the log's metric frame, beside what the log tells of them."""


class WindowConfig(Section):
    """Cutting the log into windows."""

    unit_s: Positive | Literal["auto"] = "auto"
    """Length of a time unit T, each corridor-cube holds for one; auto: 1 s, in traffic 1, 0.5 or 0.25 s."""
    rules: Literal["auto", "scene", "traffic"] = "auto"
    """How to plan: a staged scene, recorded traffic, or by `slow_mps` and what the log tells."""
    slow_mps: Positive = 6.0
    """A log with nothing of a scene in which someone is faster than this is traffic."""
    frame: Literal["auto", "map", "road"] = "auto"
    """Axes of the cubes: the map's, turned to the road, or the road's in traffic alone."""
    whole_log_s: Positive = 20.0
    """A log no longer than this is one window."""
    horizon_s: Positive = 8.0
    """Length of a window of a longer log."""
    stride_s: Positive = 8.0
    """Distance from one window's start to the next."""
    start: Literal["recording", "handed_over"] = "recording"
    """Where windows start: each from the recording, or where the plan of the one before has led (in turn)."""
    minimum_presence_units: Count = 1
    """A vehicle present for fewer whole units is not planned."""
    minimum_rate_hz: Positive = 4.0
    """A vehicle of traffic that is recorded more rarely is not planned."""
    speed_mismatch_mps: Positive = 2.0
    """A vehicle of traffic whose recorded speed and motion differ by more, on average, is not planned."""
    parked_m: NonNegative = 0.5
    """A vehicle of traffic that moves less than this in the whole log is an obstacle."""


class VehicleConfig(Section):
    """One vehicle."""

    length_m: Positive | None = None
    """Box length."""
    width_m: Positive | None = None
    """Box width."""
    wheelbase_m: Positive | None = None
    """Distance between the axles."""
    rear_axle_to_centre_m: float | None = None
    """Distance from the rear axle forward to the box centre."""
    priority: Positive | None = None
    """Priority weight eta of eq. (4)."""
    cooperative: bool = True
    """Whether the vehicle is planned; if not, it is an obstacle that moves as recorded."""


class VehiclesConfig(Section):
    """Vehicles: defaults for what the log does not tell, and per-vehicle values."""

    length_m: Positive = 4.0
    """Default box length."""
    width_m: Positive = 2.0
    """Default box width."""
    wheelbase_ratio: Positive = 0.675
    """Default wheelbase as a share of the length (2.7 m of 4 m)."""
    priority: Positive = 1.0
    """Default priority weight eta."""
    by_id: dict[str, VehicleConfig] = Field(default={})
    """Values for single vehicles: a priority overrides the log's, dimensions fill what it lacks."""


class GuidanceConfig(Section):
    """Guidance trajectories."""

    source: Literal["auto", "lane", "recorded"] = "auto"
    """Path at constant speed: a lane line (its intent, or the lane it is in), or the recorded path."""
    law: Literal["auto", "recorded", "constant"] = "auto"
    """The repaired recording by its own time, constant speed (the paper), or the former in traffic alone."""
    deviation_max_m: Positive = 1.0
    """A recorded track that no car can follow this closely is an obstacle, not planned."""
    speed_mps: Positive | None = None
    """Constant speed; unset: the recorded mean while moving."""
    stop_deceleration_mps2: Positive = 2.0
    """Braking to the end of a recorded path whose vehicle stands still there."""
    routing: Literal["independent", "coordinated"] = "independent"
    """Routes of scene files: each alone, or each with a view to those routed before it."""
    route_radius_m: Positive = 6.0
    """Preferred turning radius of a route: sharper bends, down to the least radius, have to save length."""
    route_margin_m: NonNegative = 0.3
    """Room that a route keeps between the car-box and an obstacle."""
    route_heading_slack_rad: Annotated[float, Field(ge=0, le=0.6)] = 0.13962634015954636
    """The route keeps its margin for headings this far from its own."""
    route_node_budget: Count = 4000
    """Nodes that one search expands."""


class CorridorsConfig(Section):
    """Layer 1, eq. (1) to (12)."""

    formulation: Literal["pivot_overlap", "paper"] = "pivot_overlap"
    """Our reading, or the printed equations (with a loose big M and the diagonal car-box)."""
    mode: Literal["certified", "fast"] = "certified"
    """certified: prove the gap with the full MIQP; fast: the incumbent alone."""
    area_weight: NonNegative = 0.5
    """omega_area of eq. (2)."""
    reference_weight: Positive = 10.0
    """omega_ref of eq. (3)."""
    forward_m: Positive = 10.0
    """gamma_s+: longest step of a pivotal point in a second, and reach of a cube, eq. (9), (12)."""
    backward_m: NonNegative = 1.0
    """Reach of a cube behind its pivotal point, eq. (9)."""
    sideways_m: NonNegative = 1.5
    """Reach of a cube to either side of its pivotal point, eq. (9)."""
    paper_backward_m: NonNegative = 5.0
    """gamma_s-, used by the paper's formulation alone."""
    paper_relaxation: Positive = 2.0
    """alpha of eq. (9), used by the paper's formulation alone."""
    vehicle_gap_m: NonNegative = 0.3
    """gamma_v2v of eq. (5)."""
    obstacle_gap_m: NonNegative = 0.2
    """gamma_v2o of eq. (6)."""
    heading_slack_rad: NonNegative = 0.4363323129985824
    """The car-box is held for headings this far from the guidance's, eq. (7)."""
    cone: NonNegative = 0.4
    """mu: sideways step per forward step of a pivotal point, eq. (12)."""
    acceleration_mps2: Positive = 1.5
    """Largest second difference of the pivotal points forward."""
    deceleration_mps2: Positive = 3.0
    """Largest second difference backward."""
    lateral_acceleration_mps2: Positive = 1.5
    """Largest second difference sideways."""
    lateral_m: Positive = 1.5
    """A plan of traffic that leaves its path sideways by more is not accepted, where no road is told."""
    frame_rounds: Annotated[int, Field(ge=0)] = 5
    """How often a hard scene's frames, eq. (9) to (12), are written anew about its plan."""
    gap_tolerance: Positive = 1e-3
    """Certified means (objective - bound) / max(1, |objective|) at most this."""
    seeds: Count = 4
    """Seeds tried in one attempt at a crowded scene, until every vehicle arrives."""
    seed_rounds: Count = 60
    """Rounds of repair of one seed."""
    seed_improvements: Annotated[int, Field(ge=0)] = 20
    """Rounds that make a repaired seed cheaper."""
    seed_feedbacks: Annotated[int, Field(ge=0)] = 6
    """How often a seed is repaired anew where layer 1 cannot follow it."""
    group_vehicles_max: Count = 8
    """Vehicles in conflict that are planned at once; of larger groups one is planned against the others."""
    tree_node_budget: Count = 1000
    """QPs of the conflict tree that finds corridors."""
    small_crowd_node_budget: Count = 300
    """The same where four vehicles among standing obstacles are tried before seeds."""
    tree_proof_node_budget: Count = 4000
    """QPs of pivotal points in the tree of eq. (4), certified mode."""
    joint_qp_budget: Annotated[int, Field(ge=0)] = 300
    """QPs of points and cubes together in the tree of eq. (4), certified mode."""
    milp_node_budget: Count = 20_000
    """Nodes of all branch-and-bound runs of one proof."""
    proof_binaries_max: Count = 400
    """What the tree of eq. (4) leaves open goes to CBC unless more binaries are left after probing."""
    rounds: Count = 12
    """Rounds of the outer approximation."""
    emergency_stop_s: Positive = 300.0
    """Wall-clock stop of one solver call; reported when it strikes."""


class TrajectoriesConfig(Section):
    """Layer 2, eq. (13) to (19)."""

    integrator: Literal["gauss", "euler"] = "gauss"
    """gauss: collocation of order 6; euler: the paper's, whose drift from the true motion the solves tell."""
    step_s: Positive = 0.2
    """Control interval, in a unit of T the nearest length that divides T; with euler, 0.1 is the paper's."""
    curvature_weight: NonNegative = 1.0
    """omega_kappa of eq. (13)."""
    steering_rate_weight: NonNegative = 100.0
    """omega_beta of eq. (14)."""
    jerk_weight: NonNegative = 1.0
    """omega_j of eq. (14)."""
    pivotal_x_weight: NonNegative = 1.0
    """omega_px of eq. (15)."""
    pivotal_y_weight: NonNegative = 1.0
    """omega_py of eq. (15)."""
    steering_max_rad: Annotated[float, Field(gt=0, lt=1.5)] = 0.6
    """delta_max of eq. (18)."""
    steering_rate_max_radps: Positive = 0.8
    """Largest steering rate."""
    acceleration_max_mps2: Positive = 3.0
    """a_accmax of eq. (18)."""
    deceleration_max_mps2: Positive = 4.0
    """a_decmax of eq. (18)."""
    jerk_max_mps3: Positive = 8.0
    """Largest jerk."""
    speed_max_mps: Positive = 10.0
    """Largest speed; raised to 1.15 times the fastest recorded speed plus 1 where that is more."""
    margin_m: NonNegative = 0.02
    """The car-box keeps this distance from the walls of its cubes at the knots."""
    iteration_budget: Count = 300
    """IPOPT iterations of one solve."""
    feedback_rounds: Annotated[int, Field(ge=0)] = 3
    """How often layer 1 is tightened and solved again for a vehicle that cannot be driven."""


class CertificateConfig(Section):
    """Certificates of a plan."""

    step_s: Positive = 0.01
    """Longest step of the re-integration."""
    drift_tolerance_m: Positive = 0.05
    """Largest distance between written and re-integrated states."""
    tolerance_m: Positive = 1e-6
    """Rounding allowed in distances."""
    limit_tolerance: Positive = 1e-5
    """Rounding allowed in steering, acceleration and speed limits."""
    separation_m: NonNegative = 0.0
    """Least distance between two planned boxes; their cubes' gap is checked as well."""


class ViewConfig(Section):
    """The Rerun view."""

    metres_per_second: Positive | None = None
    """Height of a second in the (x, y, t) view; without it as the scene's size wants."""


class Config(Section):
    """The whole configuration."""

    ingest: IngestConfig = IngestConfig()
    """Reading logs."""
    window: WindowConfig = WindowConfig()
    """Cutting the log into windows."""
    vehicles: VehiclesConfig = VehiclesConfig()
    """Dimensions and priorities."""
    guidance: GuidanceConfig = GuidanceConfig()
    """Guidance trajectories."""
    corridors: CorridorsConfig = CorridorsConfig()
    """Layer 1."""
    trajectories: TrajectoriesConfig = TrajectoriesConfig()
    """Layer 2."""
    certificate: CertificateConfig = CertificateConfig()
    """Certificates."""
    audit: AuditConfig = AuditConfig()
    """The safety audit of recorded traffic."""
    view: ViewConfig = ViewConfig()
    """The Rerun view."""


def parse_config(text: str, name: str = "config") -> Config:
    """Read a configuration from TOML text.

    Raises
    ------
    ConfigError
        If the text is not TOML, or a key is unknown or out of range; one line a fault.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name}: not TOML: {error}") from None
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{name}: " + "; ".join(_fault(fault) for fault in error.errors())) from None


def load_config(path: Path | None) -> Config:
    """Read a configuration file; None gives the defaults.

    Raises
    ------
    ConfigError
        If the file cannot be read or breaks a rule.
    """
    if path is None:
        return Config()
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    return parse_config(text, str(path))


def render_config(config: Config, *, explain: bool = False) -> str:
    """Write a configuration as TOML; `parse_config` reads it back to an equal one.

    Parameters
    ----------
    config : Config
        What to write; unset keys are left out (with `explain`, shown as comments).
    explain : bool
        Put each key's meaning above it.
    """
    lines: list[str] = []
    _render(config, "", lines, explain)
    return "\n".join(lines).strip() + "\n"


def _render(section: BaseModel, path: str, lines: list[str], explain: bool) -> None:
    fields = type(section).model_fields
    nested: list[tuple[str, Any, str | None]] = []
    for name, field in fields.items():
        value = getattr(section, name)
        if isinstance(value, (BaseModel, dict)):
            nested.append((name, value, field.description))
            continue
        if explain and field.description:
            lines.append(f"# {field.description}")
        if value is not None:
            lines.append(f"{name} = {_toml(value)}")
        elif explain:
            lines.append(f"# {name} =")
    for name, value, description in nested:
        key = f"{path}.{_key(name)}" if path else _key(name)
        if isinstance(value, BaseModel):
            lines.append("")
            if explain and description:
                lines.append(f"# {description}")
            lines.append(f"[{key}]")
            _render(value, key, lines, explain)
            continue
        if explain and not value:
            lines += ["", f"# {description}", f'# [{key}."..."]']
        plain = {entry: item for entry, item in value.items() if isinstance(item, str)}
        if plain:
            lines += ["", f"[{key}]", *(f"{_key(entry)} = {_toml(item)}" for entry, item in plain.items())]
            continue
        for entry, item in value.items():
            lines += ["", f"[{key}.{_key(entry)}]"]
            _render(item, f"{key}.{_key(entry)}", lines, explain)


def _key(name: str) -> str:
    return name if name.replace("_", "").isalnum() and name.isascii() else _toml(name)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, save for DEL, which JSON leaves as it is.
        return json.dumps(value).replace("\x7f", "\\u007f")
    return repr(value)


def _fault(fault: Any) -> str:
    key = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "extra_forbidden":
        known = ", ".join(_known_keys(fault["loc"][:-1]))
        return f"unknown key {key}; known here: {known}"
    return f"{key} = {fault['input']!r}: {fault['msg']}"


def _known_keys(location: tuple[Any, ...]) -> list[str]:
    model: Any = Config
    for part in location:
        field = model.model_fields.get(part) if hasattr(model, "model_fields") else None
        if field is None:
            # A key of a table of tables: the entries share one model.
            continue
        model = field.annotation
        for candidate in getattr(model, "__args__", ()):
            if hasattr(candidate, "model_fields"):
                model = candidate
    return sorted(getattr(model, "model_fields", {}))
