"""Fleets on a Dask cluster: of this machine, and of two hosts that share the output folder alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import pytest

from istc_replay.fleet.manifest import read_manifest

from .conftest import FAST, FAULTS, RunFleet, outputs, wait_for

pytest.importorskip("distributed", reason="Dask is not installed")

CLI = [sys.executable, "-c", "from istc_replay.cli import main; main()", "fleet"]
OPTIONS = ["--engine", "dask", "--skip", "view,report"]


def config_file(folder: Path) -> Path:
    file = folder / "fast.toml"
    file.write_text(FAST)
    return file


def environment() -> dict[str, str]:
    """Processes that do jobs fail at logs named crash*."""
    path = os.pathsep.join([str(FAULTS), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}


def test_a_local_cluster_gives_what_processes_give_and_names_the_log_that_crashes(
    done: Path, fleet_logs: ModuleType, tmp_path: Path
) -> None:
    logs = tmp_path / "logs"
    fleet_logs.write_logs(logs, 2)
    (logs / "crash.mcap").write_bytes(fleet_logs.varied_log(1))
    command = [*CLI, str(logs), "-o", "dask", "-c", str(config_file(tmp_path)), "--jobs", "1", *OPTIONS]
    ended = subprocess.run(
        command, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=300, check=False
    )
    assert ended.returncode == 4, ended.stderr
    assert "3 logs: 2 done, 1 failed" in ended.stdout
    assert "crash.mcap: its worker was killed by SIGSEGV" in ended.stdout
    assert len(outputs(tmp_path / "dask")) > 2
    assert outputs(tmp_path / "dask").items() <= outputs(done).items()
    assert "Dask dashboard: http://127.0.0.1:" in (tmp_path / "dask/fleet.log").read_text()


def test_a_scheduler_that_does_not_answer_is_an_error(tmp_path: Path, four_logs: Path) -> None:
    from istc_replay.errors import UsageError
    from istc_replay.fleet import dask_engine
    from istc_replay.fleet.cell import Limits

    patience = dask_engine._CONNECT_S
    dask_engine._CONNECT_S = 1.0
    try:
        with pytest.raises(UsageError, match="no Dask scheduler answers"):
            dask_engine.DaskEngine("tcp://127.0.0.1:9", 1, Limits(1000.0, 60.0), 2)
    finally:
        dask_engine._CONNECT_S = patience


# --- two hosts -------------------------------------------------------------------------------


@dataclass
class Hosts:
    """Three network namespaces on one bridge: a hub with scheduler and driver, and two workers.

    The workers have mounts and host names of their own, and cannot see the folder of the inputs.
    """

    inputs: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    names: tuple[str, ...] = ("istc-hub", "istc-a", "istc-b")

    def network(self) -> None:
        hub = self.names[0]
        for name in self.names:
            run("ip", "netns", "add", name)
            run("ip", "-n", name, "link", "set", "lo", "up")
        run("ip", "-n", hub, "link", "add", "br0", "type", "bridge")
        run("ip", "-n", hub, "addr", "add", "10.77.0.1/24", "dev", "br0")
        run("ip", "-n", hub, "link", "set", "br0", "up")
        for number, name in enumerate(self.names[1:], start=2):
            port = f"port{number}"
            run("ip", "-n", hub, "link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", name)
            run("ip", "-n", hub, "link", "set", port, "master", "br0", "up")
            run("ip", "-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", "eth0")
            run("ip", "-n", name, "link", "set", "eth0", "up")

    def start(self, where: str, *command: str, apart: bool = False) -> subprocess.Popen[bytes]:
        prefix = ["ip", "netns", "exec", where]
        if apart:
            hide = f"hostname {where} && mount -t tmpfs none '{self.inputs}' && exec \"$@\""
            prefix += ["unshare", "--mount", "--uts", "sh", "-c", hide, "sh"]
        process = subprocess.Popen(
            [*prefix, *command], env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.processes.append(process)
        return process

    def cluster(self) -> None:
        python = (sys.executable, "-m")
        scheduler = ("distributed.cli.dask_scheduler", "--host", "10.77.0.1", "--no-dashboard")
        self.start(self.names[0], *python, *scheduler)
        for name in self.names[1:]:
            self.worker(name)

    def worker(self, name: str) -> subprocess.Popen[bytes]:
        arguments = ("tcp://10.77.0.1:8786", "--nworkers", "1", "--nthreads", "1", "--no-dashboard")
        place = ("--local-directory", f"/dev/shm/{name}")  # noqa: S108
        command = (sys.executable, "-m", "distributed.cli.dask_worker", *arguments, *place)
        return self.start(name, *command, apart=True)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        for name in self.names:
            for pid in run("ip", "netns", "pids", name, check=False).split():
                subprocess.run(["kill", "-9", pid], check=False)
            run("ip", "netns", "del", name, check=False)
            shutil.rmtree(f"/dev/shm/{name}", ignore_errors=True)  # noqa: S108


def fleet_command(hosts: Hosts, folder: Path) -> list[str]:
    command = [*CLI, str(hosts.inputs), "-o", str(folder / "out"), "-c", str(config_file(folder)), *OPTIONS]
    return [*command, "--scheduler", "tcp://10.77.0.1:8786", "--memory-mb", "2000"]


def run(*command: str, check: bool = True) -> str:
    return subprocess.run(command, check=check, capture_output=True, text=True).stdout


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[Hosts]:
    """Two hosts and a hub, up and running."""
    if os.geteuid() != 0 or not shutil.which("ip") or not shutil.which("unshare"):
        pytest.skip("network namespaces need root, iproute2 and util-linux")
    inputs = tmp_path / "logs"
    inputs.mkdir()
    made = Hosts(inputs)
    try:
        try:
            made.network()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no network namespaces here: {error.stderr}")
        made.cluster()
        yield made
    finally:
        made.close()


@pytest.mark.slow
def test_two_hosts_share_nothing_but_the_output_folder(
    hosts: Hosts, run_fleet: RunFleet, fleet_logs: ModuleType, tmp_path: Path
) -> None:
    fleet_logs.write_logs(hosts.inputs, 8)
    (hosts.inputs / "crash.mcap").write_bytes(fleet_logs.varied_log(1))
    command = fleet_command(hosts, tmp_path)
    driver = hosts.start(hosts.names[0], *command)
    # Once logs come back, one host is gone, and returns.
    wait_for(tmp_path / "out", 2)
    lost = hosts.processes[2]
    for pid in run("ip", "netns", "pids", hosts.names[2]).split():
        subprocess.run(["kill", "-9", pid], check=False)
    lost.wait()
    hosts.worker(hosts.names[2])
    assert driver.wait(timeout=600) == 4
    books = read_manifest(tmp_path / "out")
    ended = {Path(end["log"]).stem: end for end in books.ends.values()}
    done = {name for name, end in ended.items() if end["event"] == "done"}
    assert done == {f"log_{i:05d}" for i in range(8)}
    assert "SIGSEGV" in ended["crash"]["error"]
    workers = {end["worker"].split("/")[0] for end in ended.values() if end["event"] == "done"}
    assert workers == set(hosts.names[1:]), json.dumps(sorted(workers))
    (hosts.inputs / "crash.mcap").unlink()
    run_fleet(tmp_path / "local", hosts.inputs)
    assert outputs(tmp_path / "out") == outputs(tmp_path / "local")


@pytest.mark.slow
def test_a_scheduler_that_is_killed_loses_nothing(
    hosts: Hosts, run_fleet: RunFleet, fleet_logs: ModuleType, tmp_path: Path
) -> None:
    fleet_logs.write_logs(hosts.inputs, 6)
    command = fleet_command(hosts, tmp_path)
    driver = hosts.start(hosts.names[0], *command)
    wait_for(tmp_path / "out", 2)
    hosts.processes[0].kill()
    assert driver.wait(timeout=300) == 2
    books = read_manifest(tmp_path / "out")
    assert books.end is not None
    assert "the Dask scheduler is gone" in books.end["reason"]
    assert 2 <= len(books.ended_now) < 6
    done_before = {end["log"]: end["at"] for end in books.ends.values()}
    hosts.close()
    hosts.processes.clear()
    hosts.network()
    hosts.cluster()
    assert hosts.start(hosts.names[0], *command).wait(timeout=600) == 0
    books = read_manifest(tmp_path / "out")
    assert {log: books.ends[log]["at"] for log in done_before} == done_before
    run_fleet(tmp_path / "local", hosts.inputs)
    assert outputs(tmp_path / "out") == outputs(tmp_path / "local")
