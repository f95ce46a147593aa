"""A supervised worker process: its crash, its hunger and its hang each name the job that it had."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

import psutil

from istc_replay.fleet.jobs import Job, Outcome
from istc_replay.fleet.manifest import this_process

#: A process is replaced after this many jobs: libraries that it loads do not give all back.
JOBS_A_PROCESS = 50
_START_S = 120.0
_ANSWER_LIMIT = 1 << 20
_MIB = 1 << 20
#: What of a dead process's last lines tells why.
_LAST_WORDS = re.compile(r"Fatal Python error:|terminate called|memory allocation|\w*(Error|Exception)\b")


@dataclass(frozen=True, slots=True)
class Limits:
    """What one job may take."""

    memory_mb: float
    time_s: float


class Cell:
    """One place of work: a process with at most one job at a time, started anew when it has died.

    Parameters
    ----------
    limits : Limits
        Of each job.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._process: subprocess.Popen[bytes] | None = None
        self._errors = _appended_file()
        self._received = b""
        self._ready = False
        self._done = 0
        self._began = 0.0
        self._peak_mb = 0.0
        self.job: Job | None = None

    def begin(self, job: Job, content: bytes | None = None) -> None:
        """Hand a job to the process."""
        if self._process is None or self._process.poll() is not None or self._done >= JOBS_A_PROCESS:
            self._start()
        self.job, self._began, self._peak_mb = job, time.monotonic(), 0.0
        self._errors.truncate(0)
        message = {"job": job.to_dict()}
        if content is not None:
            message["content"] = base64.b64encode(content).decode()  # type: ignore[assignment]
        # A process that dies now is seen by `poll`.
        with suppress(BrokenPipeError, OSError):
            stdin = self._process.stdin if self._process else None
            if stdin is not None:
                stdin.write(json.dumps(message).encode() + b"\n")
                stdin.flush()

    def fileno(self) -> int:
        """The descriptor that is readable when the process has answered or died."""
        if self._process is None or self._process.stdout is None:
            raise ValueError("the cell has no process")
        return self._process.stdout.fileno()

    def poll(self) -> Outcome | None:
        """Give the outcome of the job, None while it lasts; enforces the limits."""
        if self.job is None or self._process is None:
            return None
        ended = self._receive()
        if ended is not None:
            return self._end(ended)
        if self._process.poll() is not None:
            return self._end(self._lost(self._death()))
        return self._over_limits()

    def stop(self) -> None:
        """End the process and everything that it started."""
        self._kill()
        self.job = None
        self._errors.close()

    def _start(self) -> None:
        self._kill()
        command = [sys.executable, "-P", "-m", "istc_replay.fleet.worker"]
        command += [str(self._limits.memory_mb), str(self._limits.time_s)]
        self._process = subprocess.Popen(  # noqa: S603, this interpreter with numbers
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            start_new_session=True,  # Ctrl-C is for the driver, and the solver dies with the worker
            env={**os.environ, "OMP_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1"},
        )
        self._received, self._ready, self._done = b"", False, 0

    def _receive(self) -> Outcome | None:
        """Read what the process has said so far."""
        while self._process is not None and select.select([self.fileno()], [], [], 0)[0]:
            block = os.read(self.fileno(), 1 << 16)
            if not block:
                self._process.wait()
                return self._lost(self._death())
            self._received += block
            while b"\n" in self._received:
                line, _, self._received = self._received.partition(b"\n")
                message = json.loads(line)
                if "outcome" in message:
                    return Outcome.from_dict(message["outcome"])
                # Importing the libraries is not the job's time.
                self._ready, self._began = True, time.monotonic()
            if len(self._received) > _ANSWER_LIMIT:
                self._kill()
                return self._lost("its worker said what no worker says")
        return None

    def _over_limits(self) -> Outcome | None:
        spent = time.monotonic() - self._began
        limit = self._limits.time_s if self._ready else _START_S
        if spent > limit:
            self._kill()
            what = "emergency stop after" if self._ready else "its worker did not start within"
            return self._end(self._lost(f"{what} {limit:g} s"))
        with suppress(psutil.Error):
            pid = self._process.pid if self._process else 0
            used_mb = psutil.Process(pid).memory_info().rss / _MIB
            self._peak_mb = max(self._peak_mb, used_mb)
            if used_mb > self._limits.memory_mb:
                self._kill()
                reason = (
                    f"took {used_mb:.0f} MB of memory, more than the limit of {self._limits.memory_mb:g} MB"
                )
                return self._end(self._lost(reason))
        return None

    def _end(self, outcome: Outcome) -> Outcome:
        self.job = None
        self._done += 1
        if outcome.status in ("lost", "unstarted"):
            self._kill()
        return outcome

    def _lost(self, reason: str) -> Outcome:
        seconds = round(time.monotonic() - self._began, 3)
        status = "lost" if self._ready else "unstarted"
        return Outcome(
            status, reason, 4, seconds=seconds, peak_mb=round(self._peak_mb, 1), worker=this_process()
        )

    def _death(self) -> str:
        """Say how the process died, with the last of what it had to say."""
        code = self._process.returncode if self._process else None
        how = f"its worker ended with code {code}"
        if code is not None and code < 0:
            with suppress(ValueError):
                how = f"its worker was killed by {signal.Signals(-code).name}"
        said = self._last_words()
        return f"{how}: {said}" if said else how

    def _last_words(self) -> str:
        self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, self._errors.tell() - 20_000))
        lines = self._errors.read().decode("utf-8", "replace").splitlines()
        for line in reversed(lines):
            if _LAST_WORDS.match(line):
                return "".join(c for c in line if c.isprintable())[:200]
        return ""

    def _kill(self) -> None:
        process = self._process
        if process is None:
            return
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self._process = None


def _appended_file() -> IO[bytes]:
    """A nameless file for what a process says, which may be emptied while the process writes."""
    file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115, it lives as long as the cell
    fcntl.fcntl(file, fcntl.F_SETFL, fcntl.fcntl(file, fcntl.F_GETFL) | os.O_APPEND)
    return file


def default_jobs() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def default_memory_mb(jobs: int) -> float:
    """A job's share of four fifths of the machine's memory."""
    return float(round(0.8 * psutil.virtual_memory().total / _MIB / jobs))
