"""The paper's tables, measured here, beside the paper's figures and CL-CBS's.

Figures of others stand in data/peers.json with their source. Ours are medians over several runs of
the same scene in one process; every plan is certified once, from what would be written.
"""

from __future__ import annotations

import json
import math
import os
import re
import time
from dataclasses import dataclass
from importlib import resources
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from istc_replay.coordinate import Planners, plan_part
from istc_replay.datatypes import SOUND, Log, WindowStatus
from istc_replay.errors import ScenarioError
from istc_replay.geometry import box_corners, shift_along
from istc_replay.pipeline.replay import replay_read
from istc_replay.samples.scenes import SAMPLES, find_sample, packaged_scene, record
from istc_replay.windows import log_parts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from istc_replay.config import Config
    from istc_replay.datatypes import Result, WindowPlan
    from istc_replay.samples.drive import RecordedScene
    from istc_replay.samples.sceneform import SceneFile
    from istc_replay.windows import LogPart

TABLES = {
    "iii": ("intersection_turn_first", "intersection_straight_first"),
    "iv": (
        "dense_4",
        "dense_4_obstacles",
        "dense_6",
        "dense_6_obstacles",
        "dense_8",
        "dense_8_obstacles",
    ),
}
#: Perturbed starts and goals move by at most this much.
PERTURBED_M, PERTURBED_RAD = 1.0, math.radians(5.0)


@dataclass(frozen=True, slots=True)
class Row:
    """One scene, measured; lengths and times are sums over its vehicles."""

    name: str
    vehicles: int
    guidance_s: float
    layer1_s: float
    layer2_s: float
    total_s: float
    cpu_s: float  # processor time of both layers with CBC's, which other work on the machine hardly changes
    proof_s: float | None
    objective: float | None
    bound: float | None
    gap: float | None
    length_m: float | None
    guidance_m: float
    min_separation_m: float | None
    certified: bool
    arrived: bool
    reason: str
    stages_s: dict[str, float]  # of layer 1, in the run of median length, and of its proof


def bench(
    names: Sequence[str], config: Config, runs: int, told: Callable[[str], None]
) -> tuple[list[Row], dict[str, Result]]:
    """Measure scenes by name, in order; `told` hears which one is being measured.

    Returns
    -------
    tuple
        A row a scene, and by name the results that were certified.
    """
    rows, results = [], {}
    for name in names:
        told(name)
        row, results[name] = _row(name, find_sample(name).record, config, runs)
        rows.append(row)
    return rows, results


def scaling_names() -> tuple[str, ...]:
    """Names of the dense crossings without obstacles, from few vehicles to many."""
    found = {int(m[1]): name for name in SAMPLES if (m := re.fullmatch(r"dense_(\d+)", name))}
    return tuple(found[count] for count in sorted(found))


def _row(name: str, make: Callable[[], RecordedScene], config: Config, runs: int) -> tuple[Row, Result]:
    fast = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    began = time.perf_counter()
    log = recorded_log(make())
    guidance_s = time.perf_counter() - began
    part = next(iter(log_parts(log, fast)))
    planners = Planners(fast)
    plan_part(part, fast, planners)  # builds the NLPs, which all later runs share
    plans, cpu = [], []
    for _ in range(runs):
        spent = _cpu_s()
        plans.append(plan_part(part, fast, planners))
        cpu.append(_cpu_s() - spent)
    layer1, layer2 = (median(p.seconds[layer] for p in plans) for layer in ("corridors", "trajectories"))
    median_run = sorted(plans, key=lambda p: p.seconds["corridors"])[len(plans) // 2]
    replayed = replay_read(log, fast)
    window = replayed.summary["windows"][0]
    proven = _proof(part, config, planners) if config.corridors.mode == "certified" else {}
    figures = window["corridors"] | {
        key: proven[key] for key in ("objective", "bound", "gap") if key in proven
    }
    checks = {check["check"]: check["margin"] for check in window["certificate"]["checks"]}
    vehicles = window["vehicles"]
    lengths = [v["length_m"] for v in vehicles]
    row = Row(
        name=name,
        vehicles=len(vehicles),
        guidance_s=guidance_s,
        layer1_s=layer1,
        layer2_s=layer2,
        total_s=layer1 + layer2,
        cpu_s=median(cpu),
        proof_s=proven.get("seconds"),
        objective=figures["objective"],
        bound=figures["bound"],
        gap=figures["gap"],
        length_m=sum(lengths) if None not in lengths else None,
        guidance_m=_recorded_m(log),
        min_separation_m=checks.get("separation"),
        certified=window["status"] in SOUND,
        arrived=all(v["arrived"] is not False for v in vehicles) and window["vehicles_certified"] > 0,
        reason=window["reason"],
        stages_s=_stages(median_run) | {f"proof: {k}": v for k, v in proven.get("stages", {}).items()},
    )
    return row, replayed.result


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _stages(plan: WindowPlan) -> dict[str, float]:
    """Seconds of each stage of layer 1."""
    stages: dict[str, float] = {}
    for solve in plan.records:
        if solve.layer == "corridors":
            stages[solve.stage] = stages.get(solve.stage, 0.0) + (solve.wall_s or 0.0)
    return stages


def _proof(part: LogPart, config: Config, planners: Planners) -> dict[str, Any]:
    plan = plan_part(part, config, planners)
    if plan.corridors is None or plan.corridors.objective is None:
        return {}
    found = plan.corridors
    return {
        "objective": found.objective,
        "bound": found.bound,
        "gap": found.gap,
        "seconds": plan.seconds["corridors"],
        "stages": _stages(plan),
    }


def recorded_log(recorded: RecordedScene) -> Log:
    """Take a recorded scene as a log that has been read, without a file."""
    stamps = [pl.col("time_ns").alias(name) for name in ("log_time_ns", "publish_time_ns")]
    states = recorded.states.with_columns(stamps).sort("vehicle_id", "time_ns")
    first, last = states["time_ns"].min(), states["time_ns"].max()
    return Log(
        path=recorded.name,
        sha256="0" * 64,
        complete=True,
        messages=len(states),
        attachments=0,
        metadata=0,
        chunks=0,
        start_ns=int(first),  # type: ignore[arg-type]
        end_ns=int(last),  # type: ignore[arg-type]
        channels=(),
        states=states,
        scene=recorded.scene,
        problems=(),
    )


def _recorded_m(log: Log) -> float:
    """Length of all recorded paths."""
    steps = log.states.select(
        pl.col("x_m").diff().over("vehicle_id"), pl.col("y_m").diff().over("vehicle_id")
    ).drop_nulls()
    return float(np.hypot(steps["x_m"].to_numpy(), steps["y_m"].to_numpy()).sum())


# --- robustness ------------------------------------------------------------------------------


def perturbed(scene: SceneFile, seed: int) -> SceneFile:
    """Move every start and goal by up to 1 m along each axis and 5 degrees.

    A car that would stick out of the map is put back to its edge.
    """
    random = np.random.default_rng(seed)
    car = scene.vehicle.dimensions
    edge = np.array([[scene.map.x_min_m, scene.map.y_min_m], [scene.map.x_max_m, scene.map.y_max_m]])

    def pose(of: Any) -> Any:
        x, y = np.array([of.x_m, of.y_m]) + random.uniform(-PERTURBED_M, PERTURBED_M, 2)
        heading = of.heading_rad + random.uniform(-PERTURBED_RAD, PERTURBED_RAD)
        centre = shift_along(x, y, heading, car.rear_axle_to_centre_m)
        box = box_corners(centre[0], centre[1], heading, car.length_m, car.width_m)
        # What sticks out on the one side, less what sticks out on the other.
        back = np.maximum(edge[0] - box.min(axis=0), 0.0) - np.maximum(box.max(axis=0) - edge[1], 0.0)
        moved = {"x_m": float(x + back[0]), "y_m": float(y + back[1]), "heading_rad": float(heading)}
        return of.model_copy(update=moved)

    vehicles = [v.model_copy(update={"start": pose(v.start), "goal": pose(v.goal)}) for v in scene.vehicles]
    return scene.model_copy(update={"vehicles": tuple(vehicles)})


def robustness(name: str, count: int, config: Config, told: Callable[[str], None]) -> dict[str, Any]:
    """Replay perturbed copies of a packaged scene: how many are certified and have all arrived."""
    scene = packaged_scene(name)
    fast = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    good, misses = 0, []
    for seed in range(count):
        told(f"{scene.name}, perturbed {seed + 1} of {count}")
        try:
            window = replay_read(recorded_log(record(perturbed(scene, seed))), fast).summary["windows"][0]
        except ScenarioError as error:
            misses.append({"seed": seed, "status": "guidance_missing", "reason": str(error)})
            continue
        late = [v["id"] for v in window["vehicles"] if v["arrived"] is False]
        if window["status"] == WindowStatus.CERTIFIED and not late:
            good += 1
        else:
            reason = window["reason"] or f"not arrived: {', '.join(late)}"
            misses.append({"seed": seed, "status": window["status"], "reason": reason})
    return {"name": scene.name, "perturbed": count, "certified_and_arrived": good, "misses": misses}


# --- what others report ----------------------------------------------------------------------


def peers() -> dict[str, Any]:
    """Figures of the paper and of CL-CBS, by scene, with their sources."""
    text = resources.files("istc_replay").joinpath("data/peers.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def table(rows: Sequence[Row], others: Mapping[str, Any]) -> list[list[str]]:
    """Rows of text: ours beside the paper's and CL-CBS's."""
    head = [
        "scene",
        "layer 1 s",
        "paper",
        "layer 2 s",
        "paper",
        "CPU s",
        "proof s",
        "gap",
        "length m",
        "paper",
    ]
    lines = [[*head, "CL-CBS", "CL-CBS s", "least gap m", "certified", "arrived"]]
    for row in rows:
        paper = others["paper"].get(row.name, {})
        peer = others["cl_cbs"].get(row.name, {})
        lines.append(
            [
                row.name,
                _number(row.layer1_s, 3),
                _number(paper.get("layer1_s"), 3),
                _number(row.layer2_s, 3),
                _number(paper.get("layer2_s"), 3),
                _number(row.cpu_s, 2),
                _number(row.proof_s, 2),
                "-" if row.gap is None else f"{row.gap:.1e}",
                _number(row.length_m, 1),
                _number(paper.get("length_m"), 1),
                _number(peer.get("length_m"), 1),
                _number(peer.get("seconds"), 3),
                _number(row.min_separation_m, 2),
                "yes" if row.certified else f"no: {row.reason}",
                "yes" if row.arrived else "no",
            ]
        )
    return lines


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
