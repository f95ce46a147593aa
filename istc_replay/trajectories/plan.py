"""Plan one vehicle through its corridor: hard NLP, continuous-time check, soft twin as diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from istc_replay.bicycle import dense_motion
from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import (
    Corridor,
    FloatArray,
    Guidance,
    Participant,
    SolveRecord,
    SolveStatus,
    Trajectory,
    Undrivable,
    read_only,
)
from istc_replay.trajectories.knots import SOLVERS
from istc_replay.trajectories.nlp import COSTS, CorridorNlp, NlpSolution
from istc_replay.trajectories.task import WALLS, Task
from istc_replay.trajectories.walls import SIDES, Grid, box_extents, excess, raised

#: What a soft solution may stick out by and still count as touching [m].
_NEARLY_INSIDE_M = 1e-3
#: Rounding allowed when the continuous-time check judges a wall [m].
_TOUCHING_M = 5e-7
#: How often margins are raised where the car-box leaves a cube between wall instants.
_REFINEMENTS = 4


@dataclass(frozen=True, slots=True)
class TrajectoryOutcome:
    """Either a trajectory or why there is none, and every solve on the way."""

    trajectory: Trajectory | None
    undrivable: Undrivable | None
    records: tuple[SolveRecord, ...]


class TrajectoryPlanner:
    """Plans in-corridor trajectories, eq. (16), one vehicle at a time.

    Keeps one compiled NLP (and its soft twin) a horizon length, shared by all vehicles. The same
    input gives the same trajectory, whatever was planned before.

    Parameters
    ----------
    config : TrajectoriesConfig
    unit_s : float
        Length of a time unit [s]; `Grid.cut` tells how control intervals divide it.
    """

    def __init__(self, config: TrajectoriesConfig, unit_s: float) -> None:
        self._config = config
        self._unit_s = unit_s
        self._compiled: dict[tuple[int, bool], CorridorNlp] = {}

    def plan(
        self, participant: Participant, corridor: Corridor, guidance: Guidance, speed_max_mps: float
    ) -> TrajectoryOutcome:
        """Plan one vehicle.

        Parameters
        ----------
        participant : Participant
            Dimensions and start state (box centre).
        corridor : Corridor
            K cubes and K+1 pivotal points.
        guidance : Guidance
            Its K+1 headings make the first guess.
        speed_max_mps : float
            Largest speed.

        Returns
        -------
        TrajectoryOutcome
            The motion of the guidance where it stays in the corridor as it is. Else a trajectory whose
            car-box stays in its cubes in continuous time (with the paper's Euler integrator: at the
            knots), or the diagnosis by the soft twin.

        Raises
        ------
        SolveError
            If shapes do not match or a number is not finite.
        """
        grid = Grid.cut(len(corridor.cubes_m), self._unit_s, self._config)
        task = Task.of(participant, corridor, guidance, grid, speed_max_mps)
        fault = task.start_fault(self._config)
        if fault is not None:
            return TrajectoryOutcome(None, fault, ())
        unchanged = self._unchanged(task, guidance)
        if unchanged is not None:
            return unchanged
        records: list[SolveRecord] = []
        margin = self._config.margin_m
        # Where quadratic programmes see no way in, the soft twin tells sooner than IPOPT if there is one.
        found = self._drive(task, margin, task.first_guess(self._config), records, insist=False)
        if found is None:
            soft = self._soften(task, margin, records)
            out = self._excess(task, soft)
            kept = soft.solved and soft.slack_m <= _TOUCHING_M
            # The soft solution kept the margin as well: what is short of that may fit without it.
            if kept or out.max() <= max(margin, _NEARLY_INSIDE_M):
                guess = soft.states, soft.controls
                found = self._drive(task, margin if kept else 0.0, guess, records, insist=True)
            if found is None:
                return TrajectoryOutcome(None, _diagnosis(task, soft, out), tuple(records))
        trajectory = _trajectory(task, found.states, found.controls, found.costs)
        return TrajectoryOutcome(trajectory, None, tuple(records))

    def _unchanged(self, task: Task, guidance: Guidance) -> TrajectoryOutcome | None:
        """The motion of the guidance itself, where it stays in the corridor as it is."""
        motion = guidance.motion
        if motion is None:
            return None
        step_s = float(motion.times_s[1] - motion.times_s[0])
        # Control intervals may be longer than a unit: cut them at its boundaries.
        cut = max(1, round(step_s / task.grid.unit_s))
        controls, per_unit = np.repeat(motion.controls, cut, axis=0), round(cut * task.grid.unit_s / step_s)
        grid = Grid(task.grid.units, per_unit, step_s / cut)
        start = motion.states[0] - np.concatenate([task.origin_m, np.zeros(4)])
        if len(controls) != grid.intervals:
            return None
        out = excess(grid, start, controls, task.dimensions, task.cubes_m)
        if out.max() > _TOUCHING_M:
            return None
        dense, _, _ = dense_motion(start, controls, grid.step_s, task.dimensions.wheelbase_m, grid.step_s)
        states = np.vstack([dense[:, 0], dense[-1, -1]])
        own = replace(task, grid=grid)
        costs = own.costs(states, controls, self._config)
        record = SolveRecord(
            layer="trajectory",
            stage="unchanged",
            solver="none",
            status=SolveStatus.FEASIBLE,
            vehicle_id=task.vehicle_id,
            objective=sum(costs),
            detail="the repaired recording stays in its corridor",
        )
        return TrajectoryOutcome(_trajectory(own, states, controls, costs), None, (record,))

    def _drive(
        self,
        task: Task,
        margin_m: float,
        guess: tuple[FloatArray, FloatArray],
        records: list[SolveRecord],
        *,
        insist: bool,
    ) -> NlpSolution | None:
        """Solve the hard NLP until the car-box stays inside in continuous time; None where it fails."""
        extra = np.zeros((len(task.grid.wall_units), 4))
        for _ in range(1 + _REFINEMENTS):
            data = task.data(self._config, margin_m, extra)
            if (data.walls_m[:, ::2] > data.walls_m[:, 1::2]).any():
                return None  # adjacent cubes do not even meet
            solution = self._nlp(task.grid, soft=False).solve(data, *guess, insist=insist)
            records.append(self._record(task, "nlp", solution))
            if not solution.solved:
                return None
            out = self._excess(task, solution)
            if out.max() <= _TOUCHING_M:
                return solution
            extra = raised(extra, out)
            guess = (solution.states, solution.controls)
        return None

    def _soften(self, task: Task, margin_m: float, records: list[SolveRecord]) -> NlpSolution:
        data = task.data(self._config, margin_m, np.zeros((len(task.grid.wall_units), 4)))
        solution = self._nlp(task.grid, soft=True).solve(data, *task.first_guess(self._config))
        records.append(self._record(task, "soft", solution))
        return solution

    def _excess(self, task: Task, solution: NlpSolution) -> FloatArray:
        """How far the car-box sticks out (S-1, 4): in continuous time, with Euler at the knots."""
        if self._config.integrator == "gauss":
            return excess(task.grid, solution.states[0], solution.controls, task.dimensions, task.cubes_m)
        x, y, heading = solution.states[1:, :3].T
        reach = task.dimensions.rear_axle_to_centre_m
        centres = np.column_stack([x + reach * np.cos(heading), y + reach * np.sin(heading)])
        out = SIDES * (
            box_extents(centres, heading, task.dimensions) - np.repeat(task.cubes_m, task.grid.per_unit, 0)
        )
        return np.asarray(out)

    def _nlp(self, grid: Grid, *, soft: bool) -> CorridorNlp:
        key = (grid.units, soft)
        if key not in self._compiled:
            self._compiled[key] = CorridorNlp(grid, self._config, soft)
        return self._compiled[key]

    def _record(self, task: Task, stage: str, solution: NlpSolution) -> SolveRecord:
        drift = "; explicit Euler drifts from the true motion" if self._config.integrator == "euler" else ""
        return SolveRecord(
            layer="trajectory",
            stage=stage,
            solver=SOLVERS,
            status=solution.status,
            vehicle_id=task.vehicle_id,
            objective=solution.objective,
            wall_s=solution.wall_s,
            iterations=solution.iterations,
            detail=solution.reason + drift,
        )


def _trajectory(
    task: Task, states: FloatArray, controls: FloatArray, costs: tuple[float, float, float]
) -> Trajectory:
    states = states.copy()
    states[:, :2] += task.origin_m
    start_s = task.first_unit * task.grid.unit_s
    return Trajectory(
        vehicle_id=task.vehicle_id,
        dimensions=task.dimensions,
        times_s=read_only(start_s + task.grid.knots_s),
        states=read_only(states),
        controls=read_only(controls),
        cost=sum(costs),
        costs=dict(zip(COSTS, costs, strict=True)),
    )


def _diagnosis(task: Task, soft: NlpSolution, out_m: FloatArray) -> Undrivable:
    """Where the soft trajectory sticks out most, and how far."""
    interval, wall = np.unravel_index(int(np.argmax(out_m)), out_m.shape)
    row = int(interval) // task.grid.per_unit
    slack = max(0.0, float(out_m.max()))
    if not soft.solved:
        detail = f"no trajectory found, not even one that may leave its cubes ({soft.reason})"
    elif slack <= _NEARLY_INSIDE_M:
        detail = f"no trajectory found that keeps the car-box inside; the nearest touches {WALLS[wall]}"
    else:
        detail = f"the car-box would stick out of its cube by {slack:.3f} m at {WALLS[wall]}"
    return task.undrivable(row, slack, detail)
