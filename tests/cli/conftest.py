"""The command line as a user calls it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.commands import FAST, SAMPLES, TURN_FIRST, Command


@pytest.fixture(scope="session")
def call() -> Command:
    """Run `istc-replay` with these arguments in a process of its own; options are subprocess.run's."""

    def run(
        *arguments: str | Path, cwd: Path | None = None, **options: object
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", "from istc_replay.cli import main; main()", *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=cwd,
            timeout=300,
            check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            **options,  # type: ignore[call-overload]
        )

    return run


@pytest.fixture(scope="session")
def replayed(
    call: Command, tmp_path_factory: pytest.TempPathFactory
) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Every sample log run in one call, and the folder of the results."""
    output = tmp_path_factory.mktemp("results")
    return call("run", *SAMPLES, "-o", output), output


@pytest.fixture(scope="session")
def result(call: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one result, run fast; not to be changed."""
    folder = tmp_path_factory.mktemp("result")
    (folder / "fast.toml").write_text(FAST)
    done = call("run", TURN_FIRST, "-c", folder / "fast.toml", "-o", folder)
    assert done.returncode == 0, done.stderr
    return folder / TURN_FIRST.stem
