"""Layer 2 of the sample scenes side by side: led by quadratic programmes, and by IPOPT alone."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

from istc_replay.bench import TABLES, recorded_log
from istc_replay.config import Config, TrajectoriesConfig
from istc_replay.coordinate import Planners, plan_part
from istc_replay.datatypes import Scenario
from istc_replay.samples.scenes import find_sample
from istc_replay.trajectories.plan import TrajectoryOutcome, TrajectoryPlanner
from istc_replay.windows import log_parts

SCENES = (
    *TABLES["iii"],
    *TABLES["iv"],
    *(f"dense_{n}_row" for n in (4, 6, 8)),
    *(f"dense_{n}" for n in (12, 16, 24)),
)
HEAD = "| scene | corridors | IPOPT alone s | iterations | cost | led s | iterations | cost | worst vehicle |"
RUNS = 3


class _Keeping(TrajectoryPlanner):
    """Keeps what it is asked."""

    def __init__(self, config: TrajectoriesConfig, unit_s: float, asked: list[Any]) -> None:
        super().__init__(config, unit_s)
        self._unit, self._asked = unit_s, asked

    def plan(self, *given: Any) -> TrajectoryOutcome:
        self._asked.append((self._unit, given))
        return super().plan(*given)


class _KeepingPlanners(Planners):
    """Planners that keep what they are asked."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._trajectories, self.asked = config.trajectories, list[Any]()

    def of(self, scenario: Scenario) -> TrajectoryPlanner:
        return _Keeping(self._trajectories, scenario.window.unit_s, self.asked)


def asked(name: str, config: Config) -> list[Any]:
    """What layer 2 is asked in a scene, in all rounds: the time unit and the arguments of `plan`."""
    planners = _KeepingPlanners(config)
    part = next(iter(log_parts(recorded_log(find_sample(name).record()), config)))
    plan_part(part, config, planners)
    return planners.asked


def planned(asked: Sequence[Any], config: TrajectoriesConfig) -> tuple[float, list[TrajectoryOutcome]]:
    """Least processor time of several runs, NLPs built, and the outcomes."""
    planners = {unit_s: TrajectoryPlanner(config, unit_s) for unit_s, _ in asked}
    seconds = []
    for _ in range(1 + RUNS):
        began = time.process_time()
        found = [planners[unit_s].plan(*given) for unit_s, given in asked]
        seconds.append(time.process_time() - began)
    return min(seconds[1:]), found


def row(name: str, config: Config) -> str:
    """One line of the table; costs are of vehicles that both can drive."""
    corridors = asked(name, config)
    alone_s, alone = planned(corridors, config.trajectories.model_copy(update={"quadratic_passes": 0}))
    led_s, led = planned(corridors, config.trajectories)
    pairs = [
        (a.trajectory.cost, b.trajectory.cost)
        for a, b in zip(alone, led, strict=True)
        if a.trajectory is not None and b.trajectory is not None
    ]
    cells = [name, f"{len(pairs)} of {len(corridors)}"]
    for i, (seconds, outcomes) in enumerate(((alone_s, alone), (led_s, led))):
        iterations = sum(r.iterations or 0 for o in outcomes for r in o.records)
        cells += [f"{seconds:.3f}", str(iterations), f"{sum(pair[i] for pair in pairs):.3f}"]
    cells.append(f"{max((b - a) / max(a, 1.0) for a, b in pairs):+.1e}")
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print a line a scene; times are of the processor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    config = Config()
    fast = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    print(HEAD, "|" + "---|" * HEAD.count(" | ") + "---|", sep="\n")
    for name in parser.parse_args().scenes:
        print(row(name, fast), flush=True)


if __name__ == "__main__":
    main()
