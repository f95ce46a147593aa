"""Time a fleet on the same logs: one process in a loop, pools of one and two, a Dask cluster of two.

Prints for each: wall and processor seconds, logs a second, what a log costs beside its method's
own time, and the peak memory of the largest process and of all together. Then the books: what the
driver spends on a log, a second call on whole outputs, and the report.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

sys.path.insert(0, str(Path(__file__).parent))

from fleet_logs import write_logs

from istc_replay.config import parse_config
from istc_replay.fleet.cell import Limits
from istc_replay.fleet.drive import Fleet, Orders
from istc_replay.fleet.engine import Engine, LocalEngine
from istc_replay.fleet.inputs import find_logs
from istc_replay.fleet.report import write_report

FAST = '[corridors]\nmode = "fast"\n'
LIMITS = Limits(4000.0, 600.0)


class Watch:
    """The memory and processor time of this process and all below it, while the block lasts."""

    def __init__(self) -> None:
        self.largest_mb = self.total_mb = self.own_s = self.all_s = 0.0
        self._seen: dict[int, float] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Watch:
        self._own, self._wall = time.process_time(), time.perf_counter()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.wall_s = time.perf_counter() - self._wall
        self.own_s = time.process_time() - self._own
        self._stop.set()
        self._thread.join()
        self.all_s = self.own_s + sum(self._seen.values())

    def _watch(self) -> None:
        me = psutil.Process()
        while not self._stop.wait(0.1):
            total = largest = 0.0
            for process in [me, *me.children(recursive=True)]:
                try:
                    used = process.memory_info().rss / 2**20
                    times = process.cpu_times()
                except psutil.Error:
                    continue
                total, largest = total + used, max(largest, used)
                if process.pid != me.pid:
                    self._seen[process.pid] = times.user + times.system
            self.total_mb, self.largest_mb = max(self.total_mb, total), max(self.largest_mb, largest)


def plain_loop(logs: list[str], folder: Path) -> None:
    """What a user's own loop would do: each log read, planned and written in this one process."""
    from istc_replay.fleet.execute import do_job
    from istc_replay.fleet.inputs import stamp_of
    from istc_replay.fleet.jobs import Job, version

    for log in logs:
        job = Job(log, Path(log).stem, stamp_of(log), str(folder), FAST, version(), ())
        outcome = do_job(job)
        if outcome.status != "done":
            raise SystemExit(f"{log}: {outcome.error}")


def fleet(logs: list[str], folder: Path, make: Callable[[], Engine]) -> None:
    """A fleet with this engine."""
    summary = Fleet(folder, Orders(FAST, products=())).run(logs, make)
    if summary.counts["done"] != len(logs):
        raise SystemExit(f"{summary.counts}: {summary.named}")


def jobs_s(folder: Path) -> float:
    """Processor seconds that the jobs themselves took, by the manifest."""
    ended = [json.loads(line) for line in (folder / "fleet.jsonl").read_text().splitlines()]
    return sum(entry["cpu_s"] for entry in ended if entry["event"] == "done")


def row(name: str, count: int, watch: Watch, jobs: float | None) -> None:
    """Print a row of the table."""
    beside = "-" if jobs is None else f"{1000 * (watch.all_s - jobs) / count:.0f}"
    driver = f"{1000 * watch.own_s / count:.0f}" if jobs is not None else "-"
    print(
        f"| {name} | {watch.wall_s:.1f} | {watch.all_s:.1f} | {count / watch.wall_s:.2f} | "
        f"{count / watch.all_s:.2f} | {beside} | {driver} | {watch.largest_mb:.0f} | {watch.total_mb:.0f} |",
        flush=True,
    )


def dask(jobs: int) -> Callable[[], Engine]:
    """A Dask cluster of this machine."""

    def make() -> Any:
        from istc_replay.fleet.dask_engine import DaskEngine

        return DaskEngine(None, jobs, LIMITS, 2)

    return make


def main() -> None:
    """Run the trials on the same logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--no-dask", action="store_true")
    options = parser.parse_args()
    parse_config(FAST)
    work = Path(tempfile.mkdtemp(prefix="istc-bench-fleet-"))
    try:
        write_logs(work / "in", options.logs)
        logs, count = find_logs([str(work / "in")]), options.logs
        beside = ("beside the jobs, CPU ms a log", "driver, CPU ms a log")
        heads = ("engine", "wall s", "CPU s", "logs/s", "logs/CPU s", *beside, "largest MB", "all MB")
        print("| " + " | ".join(heads) + " |")
        print("|---|---|---|---|---|---|---|---|---|")
        with Watch() as watch:
            plain_loop(logs, work / "loop")
        row("a loop in one process", count, watch, None)
        engines = {
            f"local, {n} process{'es'[: 2 * n - 2]}": (lambda n=n: LocalEngine(n, LIMITS)) for n in (1, 2)
        }
        if not options.no_dask:
            engines["Dask, 2 workers"] = dask(2)
        for number, (name, make) in enumerate(engines.items()):
            with Watch() as watch:
                fleet(logs, work / f"fleet{number}", make)
            row(name, count, watch, jobs_s(work / f"fleet{number}"))
        with Watch() as watch:
            fleet(logs, work / "fleet1", engines["local, 1 process"])
        print(
            f"\nsecond call, all whole: {1000 * watch.all_s / count:.1f} CPU ms a log, {watch.wall_s:.2f} s"
        )
        with Watch() as watch:
            write_report(work / "fleet1")
        print(f"report: {1000 * watch.all_s / count:.1f} CPU ms a log")
        size = sum(f.stat().st_size for f in (work / "fleet1" / "logs").rglob("*") if f.is_file())
        print(f"outputs without view and report: {size / count / 1024:.0f} KiB a log")
        print(f"manifest: {(work / 'fleet1' / 'fleet.jsonl').stat().st_size / count:.0f} bytes a log")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"this process at its peak: {peak:.0f} MB; cores: {os.cpu_count()}")
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    main()
