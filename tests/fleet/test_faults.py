"""Kills and full disks at random moments: nothing finished is lost, nothing is half-written."""

from __future__ import annotations

import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from istc_replay.errors import LogError
from istc_replay.fleet.manifest import read_manifest
from istc_replay.fleet.outputs import whole_receipt

from .conftest import FAST, outputs

ROUNDS = 20
SCRIPT = "from istc_replay.cli import main; main()"


class Trial:
    """A fleet of a few logs as a process, to be disturbed, and what it gives undisturbed."""

    def __init__(self, folder: Path, logs: Path, wanted: dict[str, bytes], seconds: float) -> None:
        self.folder, self.logs, self.wanted, self.seconds = folder, logs, wanted, seconds
        # Beside the disk, where the folder is on one of its own.
        self.config = folder.parent.parent / "fast.toml"
        self.config.write_text(FAST)

    def start(self, *options: str, **how: object) -> subprocess.Popen[str]:
        command = ["fleet", str(self.logs), "-o", str(self.folder), "-c", str(self.config), "--jobs", "2"]
        return subprocess.Popen(
            [sys.executable, "-c", SCRIPT, *command, "--skip", "view,report", *options],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            **how,  # type: ignore[call-overload]
        )

    def check(self) -> dict[str, int]:
        """See that every folder is whole, and give the receipts by name; a receipt made anew is another."""
        found = {}
        for folder in (self.folder / "logs").glob("[!.]*"):
            assert whole_receipt(folder) is not None, folder
            found[folder.name] = (folder / "receipt.json").stat().st_ino
        with suppress(LogError):  # it may not have come to its first line
            ended = {end["folder"] for end in read_manifest(self.folder).ends.values()}
            assert ended <= set(found)
        return found

    def resume(self, *options: str) -> None:
        """Call again; the outputs must be those of an undisturbed fleet, and what was done must stay."""
        before = self.check()
        process = self.start(*options)
        _, error = process.communicate(timeout=300)
        assert process.returncode == 0, error
        after = self.check()
        assert {name: after[name] for name in before} == before
        assert outputs(self.folder) == self.wanted
        assert not list((self.folder / "logs").glob(".*"))
        assert not list((self.folder / "parts").glob("*"))


@pytest.fixture(scope="module")
def undisturbed(four_logs: Path, done: Path) -> tuple[Path, dict[str, bytes], float]:
    """The logs, the outputs of a fleet that nobody disturbs, and about its seconds."""
    books = read_manifest(done)
    return four_logs, outputs(done), books.ended_now[-1]["at"] - books.call["at"]


@pytest.fixture
def trial(undisturbed: tuple[Path, dict[str, bytes], float], tmp_path: Path) -> Trial:
    """A fleet to be disturbed."""
    return Trial(tmp_path / "fleets" / "out", *undisturbed)


def rounds() -> list[object]:
    """One round always, the rest in the long checks; the round is the seed."""
    return [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, ROUNDS))]


@pytest.mark.parametrize("seed", rounds())
def test_a_killed_driver_loses_nothing_that_was_finished(trial: Trial, seed: int) -> None:
    process = trial.start()
    time.sleep(random.Random(seed).uniform(0.2, 1.1) * trial.seconds)
    process.kill()
    process.communicate()
    wait_for_workers(process.pid)
    trial.resume()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(ROUNDS))
def test_a_killed_worker_is_replaced(trial: Trial, seed: int) -> None:
    process = trial.start()
    time.sleep(random.Random(seed).uniform(0.2, 0.9) * trial.seconds)
    with suppress(psutil.Error):
        workers = [
            p for p in psutil.Process(process.pid).children() if "fleet.worker" in " ".join(p.cmdline())
        ]
        if workers:
            random.Random(seed).choice(workers).kill()
    _, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    assert outputs(trial.folder) == trial.wanted
    trial.resume()


@pytest.mark.parametrize("kibibytes", [60, pytest.param(2, marks=pytest.mark.slow)])
def test_a_file_that_may_not_grow_stops_the_fleet(trial: Trial, kibibytes: int) -> None:
    limit = kibibytes << 10
    process = trial.start(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    _, error = process.communicate(timeout=300)
    assert process.returncode == 2
    assert "raise the limit of file sizes" in error or "free some space" in error
    assert len(error.splitlines()) == 1
    assert trial.check() == {}
    trial.resume()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Mount a disk of so many KiB, or give it another size."""
    if os.geteuid() != 0:
        pytest.skip("a disk of its own needs root")
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = False

    def sized(kibibytes: int) -> Path:
        nonlocal mounted
        option = f"{'remount,' if mounted else ''}size={kibibytes}k"
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", option, "none", disk], check=False)
        if done.returncode:
            pytest.skip("nothing can be mounted here")
        mounted = True
        return disk

    yield sized
    if mounted:
        subprocess.run(["umount", "-l", disk], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(ROUNDS))
def test_a_full_disk_stops_the_fleet_and_loses_nothing(
    undisturbed: tuple[Path, dict[str, bytes], float], small_disk: Callable[[int], Path], seed: int
) -> None:
    size = sum(map(len, undisturbed[1].values())) >> 10
    disk = small_disk(int(random.Random(seed).uniform(0.02, 1.0) * size))
    trial = Trial(disk / "out", *undisturbed)
    process = trial.start()
    _, error = process.communicate(timeout=300)
    assert process.returncode == 2, error
    assert "free some space" in error
    assert len(error.splitlines()) == 1
    small_disk(200_000)
    trial.resume()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(ROUNDS))
def test_a_killed_scheduler_loses_nothing_that_was_finished(
    trial: Trial, seed: int, unused_port: int
) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    address = f"tcp://127.0.0.1:{unused_port}"
    dask = ("--engine", "dask", "--scheduler", address)
    cluster = start_cluster(unused_port)
    try:
        process = trial.start(*dask)
        time.sleep(random.Random(seed).uniform(0.5, 2.0) * trial.seconds)
        cluster[0].kill()
        _, error = process.communicate(timeout=300)
        assert process.returncode == 0 or "scheduler" in error
    finally:
        stop(cluster)
    trial.check()
    cluster = start_cluster(unused_port)
    try:
        trial.resume(*dask)
    finally:
        stop(cluster)


@pytest.fixture
def unused_port() -> int:
    """A port that nobody listens on."""
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def start_cluster(port: int) -> list[subprocess.Popen[bytes]]:
    """A scheduler and two workers on 127.0.0.1."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    python = [sys.executable, "-m"]
    scheduler = [
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        str(port),
        "--no-dashboard",
    ]
    worker = ["distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--no-dashboard"]
    return [
        subprocess.Popen([*python, *command, "--no-dashboard"], **quiet)  # type: ignore[call-overload]
        for command in (scheduler, worker, worker)
    ]


def stop(cluster: list[subprocess.Popen[bytes]]) -> None:
    """End a cluster and everything that it started."""
    for process in reversed(cluster):
        with suppress(psutil.Error):
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
        process.kill()
        process.wait()


def wait_for_workers(driver: int) -> None:
    """Wait until the processes of a driver that is gone have ended, as they must by themselves."""
    for _ in range(300):
        if not [p for p in psutil.process_iter() if orphan_of(p, driver)]:
            return
        time.sleep(0.1)
    raise AssertionError("a worker outlived its driver")


def orphan_of(process: psutil.Process, driver: int) -> bool:
    with suppress(psutil.Error):
        mine = os.environ.get("PYTEST_CURRENT_TEST", "")
        told = process.environ() if "istc_replay.fleet.worker" in process.cmdline() else {}
        return told.get("PYTEST_CURRENT_TEST") == mine and process.ppid() != driver
    return False
