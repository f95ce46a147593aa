"""Fleets of small logs, each planned for real in fast mode."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import pytest

from istc_replay.errors import LogError
from istc_replay.fleet.cell import Limits
from istc_replay.fleet.drive import Fleet, Orders
from istc_replay.fleet.engine import LocalEngine
from istc_replay.fleet.inputs import find_logs
from istc_replay.fleet.manifest import read_manifest
from istc_replay.fleet.telling import Summary

from ..support.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
FAST = '[corridors]\nmode = "fast"\n'
FAULTS = Path(__file__).parent / "faults"

RunFleet = Callable[..., Summary]


@pytest.fixture(scope="session")
def fleet_logs() -> ModuleType:
    """The generator of logs."""
    return load_script("fleet_logs")


@pytest.fixture(scope="session")
def four_logs(fleet_logs: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of four logs, not to be changed."""
    folder = tmp_path_factory.mktemp("four")
    fleet_logs.write_logs(folder, 4)
    return folder


@pytest.fixture(scope="session")
def run_fleet() -> RunFleet:
    """Do logs in a folder with one process, result and tables alone; options are those of `Orders`."""

    def run(
        output: Path,
        *logs: Path,
        jobs: int = 1,
        limits: Limits = Limits(4000.0, 60.0),  # noqa: B008
        **orders: object,
    ) -> Summary:
        options = {"config_toml": FAST, "products": (), **orders}
        fleet = Fleet(output, Orders(**options))  # type: ignore[arg-type]
        return fleet.run(find_logs([str(log) for log in logs]), lambda: LocalEngine(jobs, limits))

    return run


@pytest.fixture(scope="session")
def done(run_fleet: RunFleet, four_logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The four logs, done; not to be changed."""
    folder = tmp_path_factory.mktemp("fleet")
    summary = run_fleet(folder, four_logs)
    assert (summary.counts["done"], summary.worst_code) == (4, 0), summary.named
    return folder


@pytest.fixture
def again(done: Path, tmp_path: Path) -> Path:
    """The four logs, done, in a folder that may be changed."""
    return Path(shutil.copytree(done, tmp_path / "again"))


@pytest.fixture
def with_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that do jobs fail at logs named crash*, hang*, hungry* and abort*."""
    known = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(FAULTS), *([known] if known else [])]))


def outputs(folder: Path) -> dict[str, bytes]:
    """What must repeat byte for byte: results and tables, by their place."""
    files = (folder / "logs").rglob("*")
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in files
        if file.suffix in (".mcap", ".parquet")
    }


def wait_for(folder: Path, ended: int) -> None:
    """Wait until so many logs of a fleet have ended."""
    for _ in range(3000):
        with suppress(LogError):
            if len(read_manifest(folder).ended_now) >= ended:
                return
        time.sleep(0.1)
    raise TimeoutError(f"{folder}: {ended} logs did not end in time")
