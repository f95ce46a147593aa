"""The process that does jobs one after the other: JSON lines in, JSON lines out.

Started as `python -m istc_replay.fleet.worker MEMORY_MB TIME_S`; it ends with the process that
started it.
"""

from __future__ import annotations

import base64
import faulthandler
import json
import os
import resource
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

#: The driver stops a job at its time limit; where the driver is gone, this much later the kernel does.
_GRACE_S = 30.0


def main(memory_mb: float, time_s: float) -> None:
    """Do jobs until the input ends.

    Parameters
    ----------
    memory_mb : float
        The process may grow by this much past what it has when it is ready.
    time_s : float
        The longest time of one job.
    """
    answers = _own_channel()
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    jobs: list[dict[str, Any]] = []
    ready = threading.Condition()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, jobs, ready), daemon=True).start()
    from istc_replay.fleet.execute import do_job
    from istc_replay.fleet.jobs import Job
    from istc_replay.pipeline.libraries import import_method

    import_method()
    _bound_memory(memory_mb)
    _tell(answers, {"ready": True})
    while True:
        with ready:
            ready.wait_for(lambda: bool(jobs))
            told = jobs.pop()
        content = told.get("content")
        signal.setitimer(signal.ITIMER_REAL, time_s + _GRACE_S)
        outcome = do_job(Job.from_dict(told["job"]), None if content is None else base64.b64decode(content))
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _tell(answers, {"outcome": outcome.to_dict()})


def _own_channel() -> IO[bytes]:
    """Keep stdout for answers alone: what solvers print goes to stderr."""
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)
    return answers


def _listen(source: IO[bytes], jobs: list[dict[str, Any]], ready: threading.Condition) -> None:
    """Take jobs; when the driver is gone, end this process and its solver at once."""
    for line in source:
        with ready:
            jobs.append(json.loads(line))
            ready.notify()
    with suppress(OSError):
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(1)


def _tell(answers: IO[bytes], message: dict[str, Any]) -> None:
    answers.write(json.dumps(message).encode() + b"\n")


def _bound_memory(memory_mb: float) -> None:
    """Let allocations fail where the process, or a solver it starts, grows past its limit.

    The driver watches the resident memory as well; this holds where memory grows too fast for it.
    """
    held_kb = 0
    with suppress(OSError, IndexError, ValueError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmData:"):
                held_kb = int(line.split()[1])
    if held_kb:
        most = held_kb * 1024 + int(memory_mb * 2**20)
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        if hard == resource.RLIM_INFINITY or most < hard:
            resource.setrlimit(resource.RLIMIT_DATA, (most, most))


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]))
