"""Jobs on a Dask cluster: many machines that share the output folder, and nothing else."""

from __future__ import annotations

import logging
import queue
import select
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from istc_replay.errors import UsageError
from istc_replay.fleet.cell import Cell, Limits
from istc_replay.fleet.engine import Ended, EngineLostError
from istc_replay.fleet.jobs import Job, Outcome

#: A log that a worker cannot see is sent to it if it is no larger than this.
_SENT_BYTES = 512 << 20
#: Without any worker, or without the scheduler, for so long the fleet stops.
_PATIENCE_S = 120.0
_CONNECT_S = 30.0
_WATCH_S = 0.1


class DaskEngine:
    """A Dask cluster.

    The log is read where the worker sees it, with the size and time of change that the driver
    sees; else its bytes are sent. Each worker does its job in a supervised process of its own, as
    the local engine does: a log that crashes does not take the worker along.

    Parameters
    ----------
    scheduler : str or None
        Its address; None makes a cluster on this machine, with its dashboard on 127.0.0.1.
    jobs : int
        Workers of that cluster.
    limits : Limits
        Of each job.
    tries : int
        How many workers may die of one job.

    Raises
    ------
    UsageError
        If Dask is not installed, or the scheduler does not answer.
    """

    def __init__(self, scheduler: str | None, jobs: int, limits: Limits, tries: int) -> None:
        try:
            import dask
            from distributed import Client
        except ImportError:
            raise UsageError("--engine dask needs Dask; install istc-replay[dask]") from None
        self._limits = limits
        self._cluster: Any = None
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._futures: dict[Any, Job] = {}
        self._threads, self._counted, self._seen = 0, 0.0, time.monotonic()
        dask.config.set({"distributed.scheduler.allowed-failures": tries - 1})
        try:
            if scheduler is None:
                self._cluster = _local_cluster(jobs, limits)
            self._client = Client(self._cluster or scheduler, timeout=_CONNECT_S)
        except (OSError, ValueError, RuntimeError, TimeoutError) as error:
            what = "the local cluster did not start" if scheduler is None else "no Dask scheduler answers"
            raise UsageError(f"--scheduler {scheduler or 'none'}: {what}: {error}") from None
        self.note = f"Dask dashboard: {self._client.dashboard_link}"

    def free(self) -> int:
        """How many more jobs keep every worker busy, and one waiting beside some."""
        now = time.monotonic()
        if now - self._counted > 2.0:
            self._counted = now
            with suppress(Exception):  # a scheduler that is gone is seen by `wait`
                self._threads = sum(self._client.nthreads().values())
            if self._threads:
                self._seen = now
        return self._threads + self._threads // 2 - len(self._futures)

    def begin(self, job: Job) -> None:
        """Take a job."""
        self._submit(job, None)

    def wait(self, seconds: float) -> list[Ended]:
        """Wait for jobs to end, at most so long.

        Raises
        ------
        EngineLostError
            If the scheduler, or every worker, has been gone for too long.
        """
        ended = []
        with suppress(queue.Empty):
            future = self._ended.get(timeout=seconds)
            while True:
                answer = self._answer(future)
                if answer is not None:
                    ended.append(answer)
                future = self._ended.get_nowait()
        if self._client.status != "running":
            raise EngineLostError("the Dask scheduler is gone; start it, and call again to go on")
        if not self._threads and time.monotonic() - self._seen > _PATIENCE_S:
            raise EngineLostError("the Dask scheduler has no workers; start some, and call again")
        return ended

    def close(self) -> None:
        """Give up all that is under way."""
        with suppress(Exception):
            self._client.cancel(list(self._futures), force=True)
        with suppress(Exception):
            self._client.close(timeout=5)
        if self._cluster is not None:
            with suppress(Exception):
                self._cluster.close(timeout=10)

    def _submit(self, job: Job, content: bytes | None) -> None:
        sent = None if content is None else self._client.scatter(content, hash=False)
        limits = (self._limits.memory_mb, self._limits.time_s)
        future = self._client.submit(work, job.to_dict(), sent, limits, pure=False)
        self._futures[future] = job
        future.add_done_callback(self._ended.put)

    def _answer(self, future: Any) -> Ended | None:
        job = self._futures.pop(future, None)
        if job is None:
            return None
        try:
            outcome = Outcome.from_dict(future.result(timeout=_CONNECT_S))
        except Exception as error:  # whatever Dask says of a worker that died
            return Ended(job, Outcome("lost", f"its Dask worker died: {type(error).__name__}", 4))
        if outcome.status != "away":
            return Ended(job, outcome)
        return self._send(job, outcome)

    def _send(self, job: Job, outcome: Outcome) -> Ended | None:
        """Do a job anew with the log's bytes sent along."""
        path = Path(job.location)
        try:
            size = path.stat().st_size
            if size <= _SENT_BYTES:
                self._submit(job, path.read_bytes())
                return None
        except OSError as error:
            return Ended(job, Outcome("failed", f"cannot be read: {error.strerror}", 3))
        reason = f"{outcome.error}; at {size >> 20} MiB it is too large to be sent: share its folder"
        return Ended(job, Outcome("failed", reason, 3, worker=outcome.worker))


def _local_cluster(jobs: int, limits: Limits) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=jobs,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        memory_limit=f"{limits.memory_mb:.0f}MB",
        silence_logs=logging.CRITICAL,
    )


# --- on the worker ---------------------------------------------------------------------------

_idle: list[tuple[tuple[float, float], Cell]] = []
_lock = threading.Lock()


def work(job: dict[str, Any], content: bytes | None, limits: tuple[float, float]) -> dict[str, Any]:
    """Do a job in a supervised process; runs on a Dask worker."""
    with _cell(limits) as cell:
        cell.begin(Job.from_dict(job), content)
        while (outcome := cell.poll()) is None:
            select.select([cell], [], [], _WATCH_S)
    return outcome.to_dict()


@contextmanager
def _cell(limits: tuple[float, float]) -> Iterator[Cell]:
    with _lock:
        kept = next((entry for entry in _idle if entry[0] == limits), None)
        if kept is not None:
            _idle.remove(kept)
    cell = Cell(Limits(*limits)) if kept is None else kept[1]
    try:
        yield cell
    except BaseException:
        cell.stop()
        raise
    with _lock:
        _idle.append((limits, cell))
