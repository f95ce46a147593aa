"""Doing a job: from the log's bytes to sealed outputs in their place."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from istc_replay.config import Config, parse_config, render_config
from istc_replay.errors import ConfigError, ExportError, IstcReplayError, LogError, ScenarioError
from istc_replay.export.atomic import refused
from istc_replay.fleet.inputs import is_url, local_file, sha256_of, stamp_of
from istc_replay.fleet.jobs import Job, Outcome, config_sha256, products_key, version
from istc_replay.fleet.manifest import this_process
from istc_replay.fleet.outputs import job_folder, job_key, logs_folder, publish, seal, whole_receipt

if TYPE_CHECKING:
    from istc_replay.datatypes import Log
    from istc_replay.pipeline.assembly import Replay

#: Errors of writing that no other log would be spared: the fleet stops.
_STOPS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)
_FULL_BYTES = 64 << 10
_LINE_CHARACTERS = 500


def do_job(job: Job, content: bytes | None = None) -> Outcome:
    """Do one log: outputs to a folder of a temporary name, checked, sealed and moved to their place.

    Whatever goes wrong is in the outcome; the process goes on.

    Parameters
    ----------
    job : Job
        What to do.
    content : bytes, optional
        The log's bytes, where its location cannot be seen from here.
    """
    began, cpu_began = time.perf_counter(), _cpu_s()
    _reset_peak()
    try:
        found = _do(job, content)
    except (IstcReplayError, OSError, MemoryError, Exception) as error:
        found = _failure(error, job)
    return Outcome(
        **{
            **found,
            "seconds": round(time.perf_counter() - began, 3),
            "cpu_s": round(_cpu_s() - cpu_began, 3),
            "peak_mb": round(_peak_mb(), 1),
            "worker": this_process(),
        }
    )


def _do(job: Job, content: bytes | None) -> dict[str, Any]:
    if job.version != version():
        raise ConfigError(
            f"the worker {this_process()} has other versions of istc-replay or its libraries than the fleet; "
            "install the same"
        )
    if content is None and not is_url(job.location) and not _is_here(job):
        return {"status": "away", "error": f"{job.location}: not seen by {this_process()}"}
    config = parse_config(job.config_toml)
    with local_file(job.location, content) as path:
        try:
            sha256 = sha256_of(path)
        except OSError as error:
            raise LogError(f"{job.location}: cannot be read: {error.strerror}") from None
        fleet = Path(job.fleet)
        key = job_key(sha256, products_key(config_sha256(config), job.products), job.version)
        receipt = None if job.force else whole_receipt(logs_folder(fleet) / job.name)
        if receipt is not None and receipt["key"] == key:
            return _from_receipt(receipt, logs_folder(fleet) / job.name)
        try:
            return _make(job, config, path, {"key": key, "log_sha256": sha256})
        except IstcReplayError as error:
            # Of a copy, the error is to name the log.
            raise type(error)(str(error).replace(str(path), job.location)) from error


def _is_here(job: Job) -> bool:
    try:
        return stamp_of(job.location) == job.stamp
    except LogError:
        return False


def _from_receipt(receipt: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    return {
        "status": receipt["status"],
        "error": str(receipt.get("error", "")),
        "code": int(receipt.get("code", 0)),
        "log_sha256": receipt["log_sha256"],
        "receipt_sha256": sha256_of(folder / "receipt.json"),
        "reused": True,
    }


def _make(job: Job, config: Config, path: Path, facts: dict[str, str]) -> dict[str, Any]:
    from istc_replay.ingest.log import read_log

    log = read_log(path, config)
    if log.sha256 != facts["log_sha256"]:
        raise LogError(f"{job.location}: changed while it was read; call again when it is finished")
    try:
        return _plan(job, config, log, facts)
    except ScenarioError as error:
        if not log.problems:
            raise
        first = log.problems[0]
        raise ScenarioError(f"{error}; {first.code}: {first.detail}") from None


def _plan(job: Job, config: Config, log: Log, facts: dict[str, str]) -> dict[str, Any]:
    from istc_replay.windows import window_spans

    # Windows that are done outlive a worker that dies, and are shared by all that work on the log.
    kept = Path(job.fleet) / "parts" / facts["key"][:32]
    if job.windows is not None:
        _plan_part(log, config, job.windows, kept)
        return {"status": "part", "log_sha256": log.sha256}
    if job.cut and config.window.start == "recording":  # else each follows from the one before
        count = len(window_spans(log, config))
        if count > job.cut:
            return {"status": "long", "windows": count, "log_sha256": log.sha256}
    return _whole(job, config, log, kept, facts)


def _plan_part(log: Log, config: Config, windows: tuple[int, int], kept: Path) -> None:
    """Plan some windows of a log; the job that joins them finds them done."""
    from istc_replay.pipeline.libraries import versions
    from istc_replay.pipeline.windows import plan_windows
    from istc_replay.pipeline.work_folder import WorkFolder
    from istc_replay.windows import settled_config

    toml = render_config(settled_config(log, config))
    plan_windows(
        log, config, range(*windows), work=WorkFolder(kept, log.sha256 + log.road_sha256, toml, versions())
    )


def _whole(job: Job, config: Config, log: Log, kept: Path, facts: dict[str, str]) -> dict[str, Any]:
    from istc_replay.fleet.inputs import file_name
    from istc_replay.pipeline.replay import replay_read
    from istc_replay.pipeline.run import RESULT, write_run

    fleet = Path(job.fleet)
    with job_folder(fleet, job.name) as folder:
        done = replay_read(log, config, output=kept, file=folder / RESULT)
        done.summary["input"]["path"] = job.location  # not that of a copy
        write_run(done, folder, config, file_name(job.location), products=job.products)
        _write_tables(done, folder)
        _check(done, folder, job.products)
        status, error = ("done", "") if done.exit_code in (0, 1) else ("inconclusive", _lacks(done))
        told = {"status": status, "error": error, "code": done.exit_code, "location": job.location}
        receipt = seal(folder, job.name, {**facts, **told})
        publish(folder, fleet, job.name)
    shutil.rmtree(kept, ignore_errors=True)
    ended = {"status": status, "error": error, "code": done.exit_code}
    return {**ended, "log_sha256": log.sha256, "receipt_sha256": receipt}


def _write_tables(done: Replay, folder: Path) -> None:
    """Write what `export` writes of a result."""
    from istc_replay.export.audit import audit_tables
    from istc_replay.export.tables import result_tables, write_tables

    audited = {}
    if done.audit is not None:
        audited = {**audit_tables(done.audit), "against_plan": done.audit.against_plan}
    write_tables(audited | result_tables(done.result), folder / "tables", ["parquet"])


def _check(done: Replay, folder: Path, products: tuple[str, ...]) -> None:
    """See that what is on the disk is what was to be written."""
    import polars as pl

    if sha256_of(folder / "result.mcap") != done.sha256:
        raise ExportError(f"{folder / 'result.mcap'}: is not what was written; check the disk")
    for product in products:
        if not (folder / product).stat().st_size:
            raise ExportError(f"{folder / product}: is empty; check the disk")
    for table in (folder / "tables").glob("*.parquet"):
        with table.open("rb") as file:  # its path may look like a glob
            pl.read_parquet_schema(file)


def _lacks(done: Replay) -> str:
    """Say in a line why a log is not done in full."""
    source, windows = done.summary["input"], done.summary["windows"]
    reasons = []
    if not source["complete"]:
        problems = [f"{p['code']}: {p['detail']}" for p in source["problems"]]
        reasons.append("the log is incomplete" + (f": {problems[0]}" if problems else ""))
    lacking = [w for w in windows if w["status"] not in ("certified", "nothing_to_plan")]
    if lacking or not any(w["status"] == "certified" for w in windows):
        first = (lacking or windows)[0]
        why = f": {first['reason']}" if first["reason"] else ""
        which = f"window {first['index']} is {first['status'].replace('_', ' ')}{why}"
        count = len(lacking) or len(windows)
        reasons.append(f"{count} of {len(windows)} windows are not certified in full; {which}")
    return _line("; ".join(reasons))


def _place(error: OSError) -> Path:
    return Path(os.fsdecode(error.filename) if error.filename is not None else tempfile.gettempdir())


def _is_full(folder: str) -> bool:
    """Tell whether a disk is so full that a solver's files, or a result, may have failed for it."""
    try:
        return shutil.disk_usage(folder).free < _FULL_BYTES
    except OSError:
        return False


def _failure(error: BaseException, job: Job) -> dict[str, Any]:
    # An ExportError is raised from the OSError that it tells of.
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, OSError):
        cause = cause.__context__
    if cause is not None and cause.errno in _STOPS:
        told = str(error) if isinstance(error, IstcReplayError) else str(refused(_place(cause), cause))
        return {"status": "stop", "error": _line(told), "code": 2}
    if full := [place for place in (job.fleet, tempfile.gettempdir()) if _is_full(place)]:
        told = f"{full[0]}: the disk is full; free some space, then call again"
        return {"status": "stop", "error": _line(told), "code": 2}
    if isinstance(error, IstcReplayError):
        return {"status": "failed", "error": _line(str(error)), "code": error.exit_code}
    if isinstance(error, MemoryError):
        return {"status": "lost", "error": "out of memory", "code": 4}
    return {"status": "failed", "error": _line(f"internal error: {type(error).__name__}: {error}"), "code": 4}


def _line(text: str) -> str:
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return shown if len(shown) <= _LINE_CHARACTERS else shown[: _LINE_CHARACTERS - 4] + " ..."


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _reset_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_mb() -> float:
    """Peak memory since the last reset; since the process began where the system cannot tell."""
    with suppress(OSError, IndexError, ValueError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
