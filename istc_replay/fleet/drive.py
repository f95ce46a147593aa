"""Driving a fleet: what is to be done, who does it, and the books of it."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from istc_replay.config import parse_config
from istc_replay.errors import LogError, UsageError
from istc_replay.export.atomic import prepare_folder
from istc_replay.fleet.cuts import Cuts
from istc_replay.fleet.engine import Ended, Engine, EngineLostError
from istc_replay.fleet.inputs import Source, is_url, name_sources, sha256_of, stamp_of
from istc_replay.fleet.jobs import Job, Outcome, config_sha256, products_key, version
from istc_replay.fleet.manifest import ENDINGS, SCHEMA, Entry, Manifest, this_process
from istc_replay.fleet.outputs import job_key, logs_folder, recover, whole_receipt
from istc_replay.fleet.progress import Progress
from istc_replay.fleet.telling import CallLog, Summary
from istc_replay.pipeline.run import RUN_OUTPUTS

#: Files hashed at once where an earlier call is checked.
_CHECKERS = 4
#: Pauses between looks for outputs that a worker of another host has published.
_LOOKS_S = (0.0, 0.5, 1.0, 2.0, 0.0)
#: Workers that die one after the other before they take a job, until the fleet stops.
_STARTS = 8


@dataclass(frozen=True, slots=True)
class Orders:
    """How a fleet is to be done.

    `tries` bounds how often a log may cost its worker the life; `retry_failed` does failed logs
    again, `force` all; `products` are made beside result.mcap, summary.json and the tables; a log
    of more than `cut` windows is cut into jobs of as many (0: never).
    """

    config_toml: str = ""
    products: tuple[str, ...] = RUN_OUTPUTS
    tries: int = 2
    retry_failed: bool = False
    force: bool = False
    cut: int = 32


@dataclass(slots=True)
class Fleet:
    """A call of a fleet; `run` does it.

    Parameters
    ----------
    folder : Path
        Of the outputs and the books.
    orders : Orders
        How.
    tell : callable
        Told the progress whenever it changes, and a line on what happened, if anything.
    """

    folder: Path
    orders: Orders
    tell: Callable[[Progress, str], None] = lambda _progress, _line: None
    stop_reason: str = ""
    _tries: dict[tuple[str, tuple[int, int] | None], int] = field(default_factory=dict)
    _cuts: Cuts = field(default_factory=Cuts)
    _ready: deque[Job] = field(default_factory=deque)
    _unstarted: int = 0
    _config_hash: str = ""

    def stop(self, reason: str) -> None:
        """Stop soon; jobs under way are given up, to be done by the next call."""
        self.stop_reason = self.stop_reason or reason

    def run(self, locations: Sequence[str], engine: Callable[[], Engine]) -> Summary:
        """Do every log that is not done and whole.

        Parameters
        ----------
        locations : sequence of str
            From `inputs.find_logs`.
        engine : callable
            Makes the engine, if there is anything to do.

        Returns
        -------
        Summary
            Counts, and the entries of all logs of this call.

        Raises
        ------
        UsageError, ConfigError
            If another fleet is at work in the folder; if the configuration breaks a rule.
        ExportError
            If the folder cannot be written, or its disk is full. What was finished stays.
        """
        config = parse_config(self.orders.config_toml)
        config_hash = self._config_hash = products_key(config_sha256(config), self.orders.products)
        prepare_folder(self.folder)
        manifest = Manifest(self.folder)
        try:
            recover(self.folder)
            sources = name_sources(locations, manifest.books.names)
            todo, whole = self._sort_out(sources, manifest, config_hash)
            progress = Progress(len(sources), len(whole))
            call: Entry = {
                "event": "fleet",
                "schema": SCHEMA,
                "version": version(),
                "config_sha256": config_hash,
            }
            call |= {"logs": len(sources), "whole": len(whole), "driver": this_process()}
            manifest.append(call, *({"event": "queued", "log": s.location, "folder": s.name} for s in todo))
            call_log = CallLog(self.folder, progress, self.tell)
            call_log.say(f"begins: {len(sources)} logs, {len(whole)} of them done and whole")
            if todo:
                self._drive(todo, engine, manifest, call_log)
            summary = Summary.of(sources, manifest, self.stop_reason)
            manifest.append({"event": "stopped", "reason": self.stop_reason})
            call_log.say(f"ends: {progress.line()}" + (f"; {self.stop_reason}" if self.stop_reason else ""))
            return summary
        finally:
            manifest.close()

    # --- what is done --------------------------------------------------------------------------

    def _sort_out(
        self, sources: Sequence[Source], manifest: Manifest, config_hash: str
    ) -> tuple[list[Source], list[Source]]:
        """Sort logs into those to do and those that are done and whole."""
        if self.orders.force:
            return list(sources), []
        ends = manifest.books.ends

        def is_whole(source: Source) -> bool:
            end = ends.get(source.location)
            if end is None or not _is_current(end, config_hash):
                return False
            if end["event"] == "failed":
                return not self.orders.retry_failed and _unchanged(source, end)
            receipt = whole_receipt(logs_folder(self.folder) / source.name)
            key = job_key(str(end.get("log_sha256")), config_hash, version())
            return receipt is not None and receipt["key"] == key and _unchanged(source, end)

        # Hashing lets go of the interpreter, so that threads are enough.
        with ThreadPoolExecutor(_CHECKERS) as pool:
            answers = list(pool.map(is_whole, sources))
        todo = [source for source, is_done in zip(sources, answers, strict=True) if not is_done]
        return todo, [source for source, is_done in zip(sources, answers, strict=True) if is_done]

    def _drive(
        self, todo: Iterable[Source], make: Callable[[], Engine], manifest: Manifest, log: CallLog
    ) -> None:
        waiting = deque(todo)
        under_way = 0
        engine = make()
        try:
            if engine.note:
                log.say(engine.note)
            while (waiting or self._ready or under_way) and not self.stop_reason:
                while (waiting or self._ready) and engine.free() > 0 and not self.stop_reason:
                    job = (
                        self._ready.popleft() if self._ready else self._job(waiting.popleft(), manifest, log)
                    )
                    if job is None or self._cuts.given_up(job):
                        continue
                    begun = _begun(job, self._tries.get((job.location, job.windows), 0) + 1)
                    manifest.append(begun, flush=False)
                    engine.begin(job)
                    under_way += 1
                for ended in engine.wait(0.5):
                    under_way -= 1
                    self._enter(ended, manifest, log)
                manifest.flush()
                log.tick()
        except EngineLostError as error:
            self.stop(str(error))
        finally:
            engine.close()
            with suppress(OSError):
                recover(self.folder)

    def _job(self, source: Source, manifest: Manifest, log: CallLog) -> Job | None:
        """Make the job of a log; one that cannot be found has failed already."""
        orders = self.orders
        try:
            stamp = stamp_of(source.location)
        except (LogError, UsageError) as error:
            job = Job(source.location, source.name, "", str(self.folder), orders.config_toml, version())
            outcome = Outcome("failed", str(error), error.exit_code, worker=this_process())
            self._enter(Ended(job, outcome), manifest, log)
            return None
        return Job(
            location=source.location,
            name=source.name,
            stamp=stamp,
            fleet=str(self.folder.absolute()),
            config_toml=orders.config_toml,
            version=version(),
            products=orders.products,
            force=orders.force,
            cut=orders.cut,
        )

    # --- the books -----------------------------------------------------------------------------

    def _enter(self, ended: Ended, manifest: Manifest, log: CallLog) -> None:
        """Enter how a job ended; what follows from it, such as another try, gets ready."""
        job, outcome = ended.job, ended.outcome
        if outcome.status == "stop":
            return self.stop(outcome.error)
        if outcome.status == "unstarted":
            return self._not_started(job, outcome)
        self._unstarted = 0
        if self._cuts.given_up(job):
            return None
        if outcome.status == "long":
            self._ready.extend(self._cuts.cut(job, outcome.windows))
            return log.say(f"cut: {job.location}: {outcome.windows} windows, at most {job.cut} a job")
        if outcome.status == "part":
            join = self._cuts.part_ended(job, outcome)
            return None if join is None else self._ready.append(join)
        key = (job.location, job.windows)
        tries = self._tries[key] = self._tries.get(key, 0) + 1
        status, error = self._judged(job, outcome)
        if status not in ENDINGS:
            if tries < self.orders.tries:
                manifest.append({"event": "again", "log": job.location, "error": error, "try": tries})
                self._ready.append(job)
                return log.say(f"again: {job.location}: {error}")
            status, error = "failed", f"{error} (tried {tries} times)" if tries > 1 else error
        if job.windows is not None:
            error = f"windows {job.windows[0]} to {job.windows[1] - 1}: {error}"
        outcome = self._cuts.log_ended(job, outcome)
        manifest.append(self._entry(job, outcome, status, error, tries), flush=False)
        return log.ended(status, job.location, error, outcome.seconds)

    def _not_started(self, job: Job, outcome: Outcome) -> None:
        """Try again where a worker did not start, which is no log's fault; not for ever."""
        self._unstarted += 1
        self._ready.append(job)
        if self._unstarted >= _STARTS:
            self.stop(f"no worker starts: {outcome.error}; mend that, then call again")

    def _judged(self, job: Job, outcome: Outcome) -> tuple[str, str]:
        """The status and the error to enter; outputs that are not here do not count."""
        if outcome.status in ("done", "inconclusive") and not self._is_published(job, outcome):
            shared = "wrote to a folder that is not this one; it must be shared by all hosts"
            return "failed", f"{outcome.worker} {shared}"
        return outcome.status, outcome.error.removeprefix(f"{job.location}: ")

    def _is_published(self, job: Job, outcome: Outcome) -> bool:
        folder = logs_folder(self.folder)
        for pause_s in _LOOKS_S:
            with suppress(OSError):
                if sha256_of(folder / job.name / "receipt.json") == outcome.receipt_sha256:
                    return True
            # On a network file system, opening the folder makes this host look anew.
            os.close(os.open(folder, os.O_RDONLY))
            time.sleep(pause_s)
        return False

    def _entry(self, job: Job, outcome: Outcome, status: str, error: str, tries: int) -> Entry:
        return {
            "event": status,
            "log": job.location,
            "folder": job.name,
            "stamp": job.stamp,
            "log_sha256": outcome.log_sha256,
            "config_sha256": self._config_hash,
            "version": job.version,
            "receipt_sha256": outcome.receipt_sha256,
            "code": outcome.code or (4 if status == "failed" else 0),
            "error": error,
            "seconds": outcome.seconds,
            "cpu_s": outcome.cpu_s,
            "peak_mb": outcome.peak_mb,
            "tries": tries,
            "worker": outcome.worker,
        }


def _begun(job: Job, number: int) -> Entry:
    windows = {} if job.windows is None else {"windows": list(job.windows)}
    return {"event": "begun", "log": job.location, "try": number, **windows}


def _is_current(end: Entry, config_hash: str) -> bool:
    return (end.get("config_sha256"), end.get("version")) == (config_hash, version())


def _unchanged(source: Source, end: Entry) -> bool:
    """Tell whether a log is what it was: by its size and time of change, else by its content."""
    try:
        if stamp_of(source.location) == end.get("stamp"):
            return True
        if is_url(source.location) or not end.get("log_sha256"):
            return False
        return sha256_of(Path(source.location)) == str(end["log_sha256"])
    except (OSError, LogError, UsageError):
        # One that cannot be found any more: what was made of it stays.
        return bool(end["event"] != "failed")
