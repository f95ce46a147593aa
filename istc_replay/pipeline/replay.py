"""Replaying a log end to end, into memory or a file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from istc_replay.config import Config, render_config
from istc_replay.pipeline.assembly import Replay, assemble
from istc_replay.pipeline.libraries import import_method, versions
from istc_replay.pipeline.stages import Stages
from istc_replay.pipeline.windows import plan_windows, silent
from istc_replay.pipeline.work_folder import WorkFolder

if TYPE_CHECKING:
    from collections.abc import Callable

    from istc_replay.datatypes import Log, WindowOutcome
    from istc_replay.pipeline.live import LiveView


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


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
