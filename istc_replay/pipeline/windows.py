"""Planning the windows of a log, one after the other or in parallel processes."""

from __future__ import annotations

import os
import threading
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING

from istc_replay.errors import ScenarioError, SolveError
from istc_replay.pipeline.outcomes import Outcomes
from istc_replay.pipeline.work_folder import Memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future

    from istc_replay.config import Config
    from istc_replay.coordinate import Planners
    from istc_replay.datatypes import Log, WindowOutcome, WindowPlan
    from istc_replay.pipeline.work_folder import Store, WorkFolder
    from istc_replay.windows import LogPart

#: Windows handed to each process ahead of its work; more would only take memory.
_AHEAD = 2


def silent(_stage: str, _done: int, _total: int) -> None:
    """Report no progress."""


def plan_windows(
    log: Log,
    config: Config,
    indices: Iterable[int] | None = None,
    *,
    jobs: int = 1,
    work: WorkFolder | None = None,
    progress: Callable[[str, int, int], None] = silent,
    seen: Callable[[WindowOutcome], None] = lambda _: None,
) -> Outcomes:
    """Plan and certify windows of a log; each follows from its part of the log and the settings alone.

    Any cut of the windows into calls, jobs or machines gives the same outcomes: `assemble` joins
    them. `work_folder.packed` makes bytes of an outcome.

    Parameters
    ----------
    log : Log
        What was read.
    config : Config
        The settings.
    indices : iterable of int, optional
        Windows wanted, by index (`windows.window_spans` lists them); all otherwise.
    jobs : int
        Parallel processes; windows that are handed over are planned in turn, whatever the number.
    work : WorkFolder, optional
        Keeps every window that is done, and gives those that an earlier run has done.
    progress : callable
        Told what is being done, the windows done and their number.
    seen : callable
        Shown every window as soon as it is done.

    Raises
    ------
    ScenarioError
        If the log has no vehicle, or is shorter than one time unit.
    SolveError
        If a solver is missing, or a process dies.

    Returns
    -------
    Outcomes
        In the order of the indices.
    """
    from istc_replay.windows import log_parts, settled_config, window_spans

    config = settled_config(log, config)
    chained = config.window.start == "handed_over"
    spans = window_spans(log, config)
    wanted = [span[2] for span in spans] if indices is None else list(indices)
    kept: Store = work if work is not None and len(spans) > 1 else Memory()
    found = [index for index in wanted if kept.holds(index)]
    if chained and wanted != list(range(len(wanted))):
        raise ScenarioError(
            f"{log.path}: windows that are handed over follow from each other: plan them from the first on, "
            'or set window.start to "recording"'
        )
    if chained:  # what is done from the first on; a later one would follow from another plan
        found = list(range(next((index for index in wanted if index not in found), len(wanted))))
    parts = log_parts(log, config, sorted(set(wanted) - set(found)))
    outcomes = Outcomes(wanted, kept.load)
    count = len(found)

    def told(what: str) -> None:
        progress(what, count, len(wanted))

    for index in found:
        seen(kept.load(index))
    told("corridors")
    left = len(wanted) - len(found)
    if chained or min(jobs, left) <= 1:
        last = kept.load(found[-1]).plan if chained and found else None
        solved = _in_turn(parts, config, told, last)
    else:
        solved = _apart(parts, config, min(jobs, left))
    for outcome in solved:
        kept.save(outcome)
        count += 1
        seen(outcome)
        told("corridors")
    return outcomes


def _in_turn(
    parts: Iterable[LogPart], config: Config, told: Callable[[str], None], before: WindowPlan | None
) -> Iterator[WindowOutcome]:
    from istc_replay.coordinate import Planners

    planners = Planners(config)
    for part in parts:
        outcome = _outcome(part, config, planners, told, before)
        if config.window.start == "handed_over":
            before = outcome.plan
        yield outcome


def _outcome(
    part: LogPart,
    config: Config,
    planners: Planners,
    told: Callable[[str], None],
    before: WindowPlan | None = None,
) -> WindowOutcome:
    from istc_replay.coordinate import plan_part
    from istc_replay.datatypes import SOUND
    from istc_replay.fallback import carried_on
    from istc_replay.pipeline.judge import judged

    plan = plan_part(part, config, planners, told, before)
    told("certifying")
    outcome = judged(plan, part, config, before)
    if before is None or outcome.plan.status in SOUND:
        return outcome
    shifted = carried_on(outcome.plan, before, part, config)
    if shifted is None:
        return outcome
    kept = judged(shifted, part, config, before)
    return kept if kept.plan.status in SOUND else outcome


# --- parallel processes ----------------------------------------------------------------------


def _apart(parts: Iterable[LogPart], config: Config, jobs: int) -> Iterator[WindowOutcome]:
    """Outcomes as they come; at most a few parts are cut ahead of the work."""
    import multiprocessing

    # A fresh process each: a fork would take locks of running threads along.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin, initargs=(config,))
    waiting: set[Future[WindowOutcome]] = set()
    try:
        for part in parts:
            waiting.add(pool.submit(_solve, part))
            if len(waiting) >= jobs * _AHEAD:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        while waiting:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
    except BrokenProcessPool:
        raise SolveError(
            "a process that planned windows died, for want of memory perhaps; "
            "run again to go on from the windows that are done, with fewer --jobs"
        ) from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_of_process: tuple[Config, Planners] | None = None


def _begin(config: Config) -> None:
    """Prepare a process: its solvers, and its end when the process that started it is gone."""
    import signal

    from istc_replay.coordinate import Planners

    global _of_process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _of_process = config, Planners(config)


def _end_with_parent() -> None:
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _solve(part: LogPart) -> WindowOutcome:
    if _of_process is None:
        raise SolveError("a process that plans windows was not prepared")
    config, planners = _of_process
    return _outcome(part, config, planners, lambda _: None)
