"""Shared fixtures: one small plan made by exact motion, the result read back from its file, a viewer."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from istc_replay.datatypes import Certificate, Log, Result, WindowPlan

from .support.exact import exact_certificates, exact_log, exact_plan
from .support.results import CONFIG_TOML, repeated_bytes
from .support.summary import summary_of

#: Fixtures too dear to be made by each of several workers.
_DEAR = ("replayed", "done", "table_iii")


def pytest_itemcollected(item: pytest.Item) -> None:
    """Give the tests of a dear fixture to one worker (`pytest -n 2 --dist loadgroup`)."""
    for name in _DEAR:
        if name in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.xdist_group(name))


def _beside(folder: str) -> Path:
    """A folder of what is shared beside the repository."""
    path = Path(__file__).resolve().parents[1] / "../shared" / folder
    if not path.is_dir():
        pytest.skip(f"the reference {folder} are not beside this repository")
    return path


@pytest.fixture(scope="session")
def shared_logs() -> Path:
    """The reference logs beside the repository."""
    return _beside("logs")


@pytest.fixture(scope="session")
def shared_scenarios() -> Path:
    """The reference scenes beside the repository."""
    return _beside("scenarios")


@pytest.fixture(scope="session")
def synthetic_plan() -> tuple[Log, list[WindowPlan]]:
    """A log of three cars over 6 s and the plan of its one window (see `support.exact`)."""
    return exact_log(), [exact_plan()]


@pytest.fixture(scope="session")
def synthetic_certificates() -> list[Certificate]:
    """The checks of `synthetic_plan`; one of them fails."""
    return exact_certificates()


@pytest.fixture(scope="session")
def synthetic_summary(
    synthetic_plan: tuple[Log, list[WindowPlan]], synthetic_certificates: list[Certificate]
) -> dict[str, Any]:
    """The summary of `synthetic_plan`, with its timings."""
    log, (plan,) = synthetic_plan
    return summary_of(log, plan, synthetic_certificates)


@pytest.fixture(scope="session")
def synthetic_bytes(
    synthetic_plan: tuple[Log, list[WindowPlan]],
    synthetic_certificates: list[Certificate],
    synthetic_summary: dict[str, Any],
) -> bytes:
    """The result.mcap of `synthetic_plan`."""
    from istc_replay.export.result_mcap import Contents, result_bytes

    log, plans = synthetic_plan
    provenance = {"istc-replay": "0.1.0", "input_sha256": log.sha256}
    return result_bytes(
        Contents(log, plans, synthetic_certificates, synthetic_summary, CONFIG_TOML, provenance)
    )


@pytest.fixture(scope="session")
def synthetic_result(synthetic_bytes: bytes) -> Result:
    """`synthetic_plan` as every view reads it: the result read back from its file."""
    from istc_replay.ingest.result import read_result

    return read_result(synthetic_bytes)


@pytest.fixture(scope="session")
def long_bytes(
    synthetic_plan: tuple[Log, list[WindowPlan]],
    synthetic_certificates: list[Certificate],
    synthetic_summary: dict[str, Any],
) -> bytes:
    """The result.mcap of `synthetic_plan` five times in a row."""
    log, (plan,) = synthetic_plan
    return repeated_bytes(log, plan, synthetic_certificates, synthetic_summary, 5)


@pytest.fixture(scope="session")
def viewer_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[bytes]]:
    """A headless viewer, started with the product's own command line; skips where there is no drawing."""
    from rerun.experimental import ViewerClient

    from istc_replay.export.rerun.viewer import free_port, rerun_command

    port = free_port()
    log = tmp_path_factory.mktemp("viewer") / "log.txt"
    command = rerun_command("--headless", "--port", str(port), "--window-size", "1600x1000")
    with log.open("w") as out:
        process = subprocess.Popen(
            [*command, "--hide-welcome-screen", "--memory-limit", "1GB"],
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    process.url = f"rerun+http://127.0.0.1:{port}/proxy"  # type: ignore[attr-defined]
    try:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline and process.poll() is None:
            try:
                ViewerClient.connect(process.url).get_state()  # type: ignore[attr-defined]
            except Exception:  # whatever it is, the viewer is not up yet
                time.sleep(0.3)
            else:
                break
        else:
            words = log.read_text(errors="replace").strip().splitlines() or ["no word"]
            pytest.skip(f"Rerun's viewer does not start here (no Vulkan in software?): {words[-1]}")
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=20)


@pytest.fixture
def viewer(viewer_process: Any) -> Iterator[Any]:
    """A client of the headless viewer; what a test opens is closed after it."""
    from rerun.experimental import ViewerClient

    client = ViewerClient.connect(viewer_process.url)
    yield client
    if client.get_state().recordings:
        client.close("all")
