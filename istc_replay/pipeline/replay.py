"""Replaying a log end to end."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from istc_replay.config import Config, render_config
from istc_replay.datatypes import Verdict, WindowStatus
from istc_replay.errors import ExportError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import polars as pl

    from istc_replay.datatypes import Certificate, Log, Result, WindowPlan

_COMPONENTS = ("istc-replay", "casadi", "cbcbox", "daqp", "mcap", "numpy", "polars", "pyomo", "rerun-sdk")


@dataclass(slots=True)
class Stages:
    """Wall-clock seconds by stage of a run."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to a stage."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began


@dataclass(frozen=True, slots=True)
class Replay:
    """A finished replay: the result as its file tells it, the file's bytes, and the summary."""

    result: Result
    mcap: bytes
    summary: dict[str, Any]

    @property
    def exit_code(self) -> int:
        """0 done; 3 input incomplete or nothing to plan; 4 a window could not be solved."""
        statuses = {window["status"] for window in self.summary["windows"]}
        if statuses - {WindowStatus.CERTIFIED, WindowStatus.NOTHING_TO_PLAN}:
            return 4
        complete = self.summary["input"]["complete"]
        return 0 if complete and WindowStatus.CERTIFIED in statuses else 3


def _silent(_stage: str, _done: int, _total: int) -> None:
    """Report no progress."""


def replay_log(
    path: Path,
    config: Config | None = None,
    *,
    progress: Callable[[str, int, int], None] = _silent,
    stages: Stages | None = None,
) -> Replay:
    """Replay one log, in memory.

    Parameters
    ----------
    path : Path
        An MCAP log.
    config : Config, optional
        Settings; the defaults otherwise.
    progress : callable
        Told what is being done, the windows done and their number.
    stages : Stages, optional
        Collects the time of each stage.

    Raises
    ------
    LogError
        If the log cannot be read.
    ScenarioError
        If it holds no vehicle, or less than one time unit.
    SolveError
        If a solver is missing or dies.
    """
    settings = config or Config()
    timing = stages or Stages()
    cpu_began = _cpu_s()
    with timing.stage("imports"):
        _import_method()
    from istc_replay.ingest.log import read_log

    progress("reading", 0, 1)
    with timing.stage("ingest"):
        log = read_log(path, settings)
    done = replay_read(log, settings, progress=progress, stages=timing)
    done.summary["totals"]["cpu_s"] = _cpu_s() - cpu_began
    return done


def replay_read(
    log: Log,
    config: Config,
    *,
    progress: Callable[[str, int, int], None] = _silent,
    stages: Stages | None = None,
) -> Replay:
    """Replay a log that has been read; arguments and errors as of `replay_log`."""
    from istc_replay.scenario import settled_config

    timing = stages or Stages()
    config = settled_config(log, config)
    plans = _plans(log, config, timing, progress)
    progress("certifying", len(plans), len(plans))
    done = _certify(log, plans, config, timing)
    done.summary["stages"] = timing.seconds
    return done


def _plans(
    log: Log, config: Config, timing: Stages, progress: Callable[[str, int, int], None]
) -> list[WindowPlan]:
    from istc_replay.coordinate import Planners, plan_span
    from istc_replay.scenario import check_states, window_spans

    with timing.stage("scenario"):
        check_states(log)
        spans = window_spans(log, config)
    planners = Planners(config)
    plans = []
    for done, span in enumerate(spans):

        def told(what: str, done: int = done) -> None:
            progress(what, done, len(spans))

        began = time.perf_counter()
        plan = plan_span(log, config, span, planners, told)
        spent = time.perf_counter() - began
        for name, seconds in {**plan.seconds, "scenario": spent - sum(plan.seconds.values())}.items():
            timing.seconds[name] = timing.seconds.get(name, 0.0) + seconds
        plans.append(plan)
    return plans


def _certify(log: Log, plans: Sequence[WindowPlan], config: Config, timing: Stages) -> Replay:
    """Write the plans, certify what the written result says, and write it again with the verdict."""
    from istc_replay.export.result_mcap import result_bytes, solve_times
    from istc_replay.export.summary import summarise
    from istc_replay.ingest.result import read_result
    from istc_replay.safety.certificate import certify, overall
    from istc_replay.safety.recorded import least_recorded_gap

    toml = render_config(config)
    config_sha256 = hashlib.sha256(toml.encode()).hexdigest()
    provenance = {**versions(), "input_sha256": log.sha256, "config_sha256": config_sha256}
    sized = _sized(log.states, plans)
    gaps = {
        w.index: least_recorded_gap(sized, w.start_ns, w.end_ns)
        for w in (plan.scenario.window for plan in plans)
    }

    def written(
        plans: Sequence[WindowPlan], certificates: Sequence[Certificate]
    ) -> tuple[bytes, dict[str, Any]]:
        summary = summarise(log, plans, certificates, gaps, versions(), config_sha256)
        return result_bytes(log, plans, certificates, summary, toml, provenance), summary

    with timing.stage("result_mcap"):
        hoped = [replace(p, status=WindowStatus.CERTIFIED) if p.trajectories else p for p in plans]
        draft = read_result(written(hoped, ())[0])
    with timing.stage("certificate"):
        certificates = certify(draft, config)
    judged = []
    for plan in plans:
        own = [c for c in certificates if c.window == plan.scenario.window.index]
        judged.append(_judged(plan, own, overall(own) if own else Verdict.NOT_APPLICABLE))
    with timing.stage("result_mcap"):
        data, summary = written(judged, certificates)
        result = read_result(data)
    summary["solves"] = solve_times(judged)
    return Replay(result, data, summary)


def _sized(states: pl.DataFrame, plans: Sequence[WindowPlan]) -> pl.DataFrame:
    """Recorded states with the sizes that the plans took for vehicles whose log tells none."""
    import polars as pl

    sizes = {p.vehicle_id: p.dimensions for plan in plans for p in plan.scenario.participants}
    return states.with_columns(
        pl.col(name).fill_null(
            pl.col("vehicle_id").replace_strict(
                {vehicle: getattr(size, name) for vehicle, size in sizes.items()},
                default=None,
                return_dtype=pl.Float64,
            )
        )
        for name in ("length_m", "width_m")
    )


def _judged(plan: WindowPlan, certificates: Sequence[Certificate], verdict: Verdict) -> WindowPlan:
    if plan.status is not WindowStatus.NOT_CERTIFIED:
        return plan
    if verdict is Verdict.PASS:
        if plan.frozen:
            stay = "; ".join(f"{e.vehicle_id}: {e.detail}" for e in plan.frozen)
            return replace(plan, status=WindowStatus.PARTIAL, reason=f"as recorded stay {stay}")
        return replace(plan, status=WindowStatus.CERTIFIED)
    faults = [c for c in certificates if c.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)]
    reason = "; ".join(f"{c.check} {c.verdict}: {c.detail}" for c in faults) or "nothing was certified"
    return replace(plan, reason=reason)


def run_log(
    path: Path,
    folder: Path,
    config: Config,
    progress: Callable[[str, int, int], None] = _silent,
) -> Replay:
    """Replay one log and write result.mcap, view.rrd, report.html and summary.json to a folder.

    Raises
    ------
    ExportError
        If an output cannot be written whole; nothing half-written stays.
    """
    stages = Stages()
    with stages.stage("imports"):
        from istc_replay.export.atomic import atomic_file, prepare_folder
        from istc_replay.export.report import report_html
        from istc_replay.export.rerun_view import write_view

    prepare_folder(folder)
    done = replay_log(path, config, progress=progress, stages=stages)
    windows = len(done.summary["windows"])
    progress("writing", windows, windows)
    with stages.stage("write_mcap"), atomic_file(folder / "result.mcap") as file:
        file.write_bytes(done.mcap)
    with stages.stage("view_rrd"):
        write_view(done.result, config.view, folder / "view.rrd")
    with stages.stage("report_html"), atomic_file(folder / "report.html") as file:
        file.write_text(report_html(done.result, path.name), encoding="utf-8")
    with atomic_file(folder / "summary.json") as file:
        file.write_text(json.dumps(done.summary, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return done


def result_folders(paths: Sequence[Path], output: Path) -> dict[Path, Path]:
    """Name each log's folder, `output/<log stem>`.

    Raises
    ------
    UsageError
        If two logs would share one.
    """
    folders: dict[Path, Path] = {}
    for path in paths:
        folder = output / (path.stem or "log")
        if folder in folders.values():
            raise UsageError(f"{path}: another log writes to {folder} too; run them apart, or rename one")
        folders[path] = folder
    return folders


@cache
def versions() -> dict[str, str]:
    """Versions of everything that a result depends on."""
    found = {"python": platform.python_version()}
    for name in _COMPONENTS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError as error:
            raise ExportError(f"{name} is not installed as a package: {error}; install it again") from None
    # The wheel holds several builds of CBC and picks one by processor.
    from istc_replay.corridors.cbc import build_name

    found["cbc"] = build_name()
    return found


def _import_method() -> None:
    """Import the heavy libraries at one place, so that their time shows as a stage of its own."""


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
