"""Replaying a log end to end."""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from istc_replay.config import Config, render_config
from istc_replay.datatypes import Certificate, WindowStatus
from istc_replay.errors import ExportError, LogError, UsageError
from istc_replay.pipeline.outcomes import Plans
from istc_replay.pipeline.windows import plan_windows, silent
from istc_replay.pipeline.work_folder import WorkFolder, clear_work

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from istc_replay.datatypes import Log, Result, WindowOutcome
    from istc_replay.export.hashed import HashedFile
    from istc_replay.pipeline.live import LiveView
    from istc_replay.safety.log_audit import Audit

#: What `run_log` writes beside result.mcap and summary.json.
RUN_OUTPUTS = ("view.rrd", "report.html")
RESULT = "result.mcap"
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


@dataclass(frozen=True, eq=False)
class Replay:
    """A finished replay: its summary, the result's file (or its bytes) and their hash, and the audit.

    Without an `audit`, the summary says why there is none; it is not kept of a replay that is
    written to a folder at once.
    """

    summary: dict[str, Any]
    source: Path | bytes
    sha256: str
    audit: Audit | None = None

    @cached_property
    def mcap(self) -> bytes:
        """The bytes of result.mcap."""
        return self.source if isinstance(self.source, bytes) else self.source.read_bytes()

    @cached_property
    def result(self) -> Result:
        """The result as its file tells it."""
        from istc_replay.ingest.result import read_result

        return read_result(self.source)

    @property
    def exit_code(self) -> int:
        """0 done; 3 input incomplete or nothing to plan; 4 a window could not be solved."""
        statuses = {window["status"] for window in self.summary["windows"]}
        if statuses - {WindowStatus.CERTIFIED, WindowStatus.NOTHING_TO_PLAN}:
            return 4
        complete = self.summary["input"]["complete"]
        return 0 if complete and WindowStatus.CERTIFIED in statuses else 3


def replay_log(
    path: Path,
    config: Config | None = None,
    *,
    jobs: int = 1,
    output: Path | None = None,
    progress: Callable[[str, int, int], None] = silent,
    reading: Callable[[int, int], None] | None = None,
    stages: Stages | None = None,
    live: LiveView | None = None,
    file: Path | None = None,
) -> Replay:
    """Replay one log.

    Parameters
    ----------
    path : Path
        An MCAP log.
    config : Config, optional
        Settings; the defaults otherwise.
    jobs : int
        Parallel processes; the result is the same for any number.
    output : Path, optional
        A folder in which finished windows are kept; `work_folder.clear_work` removes them.
    progress : callable
        Told what is being done, the windows done and their number.
    reading : callable, optional
        Told the bytes of the log that are read, and their number.
    stages : Stages, optional
        Collects the time of each stage.
    live : LiveView, optional
        Shows every window as soon as it is solved.
    file : Path, optional
        Where the result goes; into memory otherwise.

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
        import_method()
    from istc_replay.ingest.log import read_log

    progress("reading", 0, 1)
    with timing.stage("ingest"):
        log = read_log(path, settings, reading)
    done = replay_read(
        log, settings, jobs=jobs, output=output, progress=progress, stages=timing, live=live, file=file
    )
    done.summary["totals"]["cpu_s"] = _cpu_s() - cpu_began
    return done


def replay_read(
    log: Log,
    config: Config,
    *,
    jobs: int = 1,
    output: Path | None = None,
    progress: Callable[[str, int, int], None] = silent,
    stages: Stages | None = None,
    live: LiveView | None = None,
    file: Path | None = None,
) -> Replay:
    """Replay a log that has been read; arguments and errors as of `replay_log`."""
    from istc_replay.windows import settled_config

    timing = stages or Stages()
    work = None
    settled = settled_config(log, config)
    if output is not None:
        toml = render_config(settled)
        work = WorkFolder(output, log.sha256 + log.road_sha256, toml, versions())

    def seen(outcome: WindowOutcome) -> None:
        if live is not None:
            with timing.stage("live_view"):
                live.window(log, settled, outcome)

    outcomes = plan_windows(log, config, jobs=jobs, work=work, progress=progress, seen=seen)
    progress("writing", len(outcomes), len(outcomes))
    return assemble(log, config, outcomes, timing, file=file)


def assemble(
    log: Log,
    config: Config,
    outcomes: Sequence[WindowOutcome],
    stages: Stages | None = None,
    *,
    file: Path | None = None,
) -> Replay:
    """Join the outcomes of all windows, wherever they were made, to the replay of the log.

    Parameters
    ----------
    log, config
        As they were for `windows.plan_windows`.
    outcomes : sequence of WindowOutcome
        In order of their windows.
    stages : Stages, optional
        Collects the time of each stage.
    file : Path, optional
        Where the result goes; into memory otherwise.

    Raises
    ------
    ExportError
        If the file cannot be written whole.
    """
    from istc_replay.export.result_mcap import solve_times, write_result
    from istc_replay.export.summary import audited, summarise, window_figures
    from istc_replay.windows import settled_config

    timing = stages or Stages()
    toml = render_config(settled_config(log, config))
    config_sha256 = hashlib.sha256(toml.encode()).hexdigest()
    certificates, solves = list[Certificate](), list[dict[str, Any]]()
    windows, rows = list[dict[str, Any]](), list[dict[str, Any]]()
    for outcome in outcomes:
        windows.append(window_figures(outcome))
        certificates += outcome.certificates
        rows += outcome.against_plan
        solves += solve_times(outcome.plan)
        for name, seconds in outcome.plan.seconds.items():
            timing.seconds[name] = timing.seconds.get(name, 0.0) + seconds
    summary = summarise(log, windows, versions(), config_sha256)
    with timing.stage("audit"):
        audit = _audited(log, config, rows, windows)
    summary["audit"] = audited(audit)
    provenance = {**versions(), "input_sha256": log.sha256, "config_sha256": config_sha256}
    if log.road_sha256:
        provenance["road_sha256"] = log.road_sha256
    findings = None if isinstance(audit, str) else audit.findings
    with timing.stage("result_mcap"), _target(file) as (stream, memory):
        told = (Plans(outcomes), certificates, summary, toml, provenance)
        write_result(stream, log, *told, findings=findings)
    summary["solves"] = solves
    summary["stages"] = timing.seconds
    source = memory.getvalue() if file is None else file
    return Replay(summary, source, stream.sha256, None if isinstance(audit, str) else audit)


def _audited(
    log: Log, config: Config, rows: list[dict[str, Any]], windows: Sequence[Mapping[str, Any]]
) -> Audit | str:
    """The audit of what was recorded, or why there is none."""
    import polars as pl

    from istc_replay.safety.log_audit import audit_log
    from istc_replay.safety.solver_record import with_solver_record
    from istc_replay.states import AGAINST_PLAN_SCHEMA

    try:
        found = audit_log(log, config, pl.DataFrame(rows, schema=AGAINST_PLAN_SCHEMA))
    except LogError as error:  # too dense for the memory: the plans stand without it
        return str(error)
    return with_solver_record(found, windows, config)


@contextmanager
def _target(file: Path | None) -> Iterator[tuple[HashedFile, io.BytesIO]]:
    """Where a result goes: a file that is whole or not there at all, else memory."""
    from istc_replay.export.atomic import atomic_file
    from istc_replay.export.hashed import HashedFile

    memory = io.BytesIO()
    if file is None:
        yield HashedFile(memory), memory
    else:
        with atomic_file(file) as temporary, temporary.open("wb") as stream:
            yield HashedFile(stream), memory


def run_log(
    path: Path,
    folder: Path,
    config: Config,
    progress: Callable[[str, int, int], None] = silent,
    jobs: int = 1,
    live: LiveView | None = None,
    *,
    reading: Callable[[int, int], None] | None = None,
) -> Replay:
    """Replay one log and write result.mcap, view.rrd, report.html and summary.json to a folder.

    Raises
    ------
    ExportError
        If an output cannot be written whole; nothing half-written stays.
    """
    from istc_replay.export.atomic import prepare_folder
    from istc_replay.pipeline.reading import read_for_show

    stages = Stages()
    prepare_folder(folder)
    done = replay_log(
        path,
        config,
        jobs=jobs,
        output=folder,
        progress=progress,
        reading=reading,
        stages=stages,
        live=live,
        file=folder / RESULT,
    )
    done = replace(done, audit=None)
    windows = len(done.summary["windows"])
    progress("writing", windows, windows)
    write_run(done, folder, config, path.name, stages)
    clear_work(folder)
    if live is not None:
        live.finish(read_for_show(folder / RESULT), config)
    return done


def write_run(
    done: Replay,
    folder: Path,
    config: Config,
    title: str,
    stages: Stages | None = None,
    products: Collection[str] = RUN_OUTPUTS,
) -> None:
    """Write the `products` and summary.json beside a replay's result.mcap.

    Raises
    ------
    ExportError
        If an output cannot be written whole; nothing half-written stays.
    """
    from istc_replay.export.atomic import atomic_file
    from istc_replay.pipeline.reading import read_for_show

    timing = stages or Stages()
    with timing.stage("reading_back"):
        found = read_for_show(folder / RESULT)
    if "view.rrd" in products:
        with timing.stage("view_rrd"):
            from istc_replay.export.rerun_view import write_view

            write_view(found.result, config.view, folder / "view.rrd", parts=found.parts)
    if "report.html" in products:
        with timing.stage("report_html"), atomic_file(folder / "report.html") as file:
            from istc_replay.export.report import report_html

            file.write_text(report_html(found.result, title, found.states), encoding="utf-8")
    with atomic_file(folder / "summary.json") as file, file.open("w", encoding="utf-8") as text:
        json.dump(done.summary, text, indent=1, allow_nan=False)
        text.write("\n")


def result_folders(paths: Sequence[Path], output: Path) -> dict[Path, Path]:
    """Name each log's folder, `output/<log stem>`.

    Raises
    ------
    UsageError
        If two logs would share one.
    """
    folders: dict[Path, Path] = {}
    for path in paths:
        folder = output / folder_name(path)
        if folder in folders.values():
            raise UsageError(f"{path}: another log writes to {folder} too; run them apart, or rename one")
        folders[path] = folder
    return folders


def folder_name(path: Path) -> str:
    """Name of a log's folder: its stem, without dots before it, which would hide it or lead elsewhere."""
    return path.stem.lstrip(".") or "log"


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


#: Modules of which a replay needs all, and whose libraries take long to import.
_METHOD = (
    "coordinate",
    "changes",
    "export.result_mcap",
    "export.summary",
    "ingest.result",
    "safety.certificate",
)


def import_method() -> None:
    """Import the heavy libraries at one place, so that their time shows as a stage of its own."""
    for name in _METHOD:
        import_module(f"istc_replay.{name}")


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
