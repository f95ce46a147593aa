"""What does the jobs: processes of this machine here, a cluster in `dask_engine`."""

from __future__ import annotations

import select
import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from istc_replay.fleet.cell import Cell, Limits
from istc_replay.fleet.jobs import Job, Outcome


@dataclass(frozen=True, slots=True)
class Ended:
    """A job that has ended, one way or another."""

    job: Job
    outcome: Outcome


class EngineLostError(Exception):
    """The engine can do no more jobs; those under way are given up."""


class Engine(Protocol):
    """Does jobs at several places at once; `note` tells the user of it, if there is anything to tell."""

    note: str

    def free(self) -> int:
        """How many more jobs it would take."""

    def begin(self, job: Job) -> None:
        """Take a job."""

    def wait(self, seconds: float) -> list[Ended]:
        """Wait for jobs to end, at most so long."""

    def close(self) -> None:
        """End all that is under way, at once."""


class LocalEngine:
    """Supervised processes of this machine.

    Parameters
    ----------
    jobs : int
        Their number.
    limits : Limits
        Of each job.
    """

    #: How often the processes' memory is looked at.
    _WATCH_S = 0.1

    def __init__(self, jobs: int, limits: Limits) -> None:
        self._cells = [Cell(limits) for _ in range(jobs)]
        self.note = ""

    def free(self) -> int:
        """How many processes have nothing to do."""
        return sum(cell.job is None for cell in self._cells)

    def begin(self, job: Job) -> None:
        """Hand a job to a process that has none."""
        next(cell for cell in self._cells if cell.job is None).begin(job)

    def wait(self, seconds: float) -> list[Ended]:
        """Wait for jobs to end, at most so long."""
        ended: deque[Ended] = deque()
        until = time.monotonic() + seconds
        while not ended and (left := until - time.monotonic()) > 0:
            busy = [cell for cell in self._cells if cell.job is not None]
            if not busy:
                time.sleep(min(left, self._WATCH_S))
                continue
            select.select(busy, [], [], min(left, self._WATCH_S))
            for cell in busy:
                job = cell.job
                outcome = cell.poll()
                if job is not None and outcome is not None:
                    ended.append(Ended(job, outcome))
        return list(ended)

    def close(self) -> None:
        """End every process and what it started."""
        for cell in self._cells:
            cell.stop()
