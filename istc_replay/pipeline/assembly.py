"""The outcomes of all windows, joined to the replay of their log."""

from __future__ import annotations

import hashlib
import io
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from istc_replay.config import Config, render_config
from istc_replay.datatypes import Certificate, WindowStatus
from istc_replay.errors import LogError
from istc_replay.pipeline.libraries import versions
from istc_replay.pipeline.outcomes import Plans
from istc_replay.pipeline.stages import Stages

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from istc_replay.datatypes import Log, Result, WindowOutcome
    from istc_replay.export.hashed import HashedFile
    from istc_replay.safety.log_audit import Audit


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
    from istc_replay.export.result_mcap import Contents, solve_times, write_result
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
        plans = Plans(outcomes)
        write_result(stream, Contents(log, plans, certificates, summary, toml, provenance, findings))
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
