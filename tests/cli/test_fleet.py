"""`istc-replay fleet` as a user calls it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ..support.commands import Command

LOG = Path(__file__).resolve().parents[2] / "sample_logs" / "intersection_osi.mcap"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Fast mode."""
    file = tmp_path / "fast.toml"
    file.write_text('[corridors]\nmode = "fast"\n')
    return file


def test_logs_named_like_its_words_are_done_and_the_words_work(
    call: Command, config: Path, tmp_path: Path
) -> None:
    (tmp_path / "status").write_bytes(LOG.read_bytes())
    (tmp_path / "bad.mcap").write_text("no log")
    options = ("-o", "out", "-c", config, "--jobs", "1", "--skip", "view,report")
    done = call("fleet", "./status", "bad.mcap", *options, cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert "2 logs: 1 done, 1 failed" in done.stdout
    assert "bad.mcap: not an MCAP log" in done.stdout
    assert (tmp_path / "out/logs/status/result.mcap").exists()
    assert not (tmp_path / "out/logs/status/report.html").exists()
    told = call("fleet", "status", "out", cwd=tmp_path)
    assert told.stdout.startswith("finished: 2 of 2 logs (1 done, 1 failed)")
    facts = json.loads(call("fleet", "status", "out", "--json", cwd=tmp_path).stdout)
    assert facts["failed"][0]["log"] == str(tmp_path / "bad.mcap")
    # Options first, and nothing left to do.
    again = call("fleet", *options, "./status", "bad.mcap", cwd=tmp_path)
    assert again.returncode == 3
    assert call("fleet", "status", "out", cwd=tmp_path).stdout.startswith(
        "finished: 2 of 2 logs (2 from before)"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "out"], "no logs are given"),
        (["absent.mcap", "-o", "out"], "absent.mcap: there is no such file or folder"),
        ([str(LOG), "-o", "out", "--skip", "tables"], "'tables' is not one of view, report"),
        ([str(LOG), "-o", "out", "--scheduler", "tcp://x:1"], "--scheduler needs --engine dask"),
        ([str(LOG), "-o", "out", "-c", "absent.toml"], "absent.toml: cannot be read"),
        ([str(LOG), "-o", str(LOG)], "cannot be written"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(
    call: Command, arguments: list[str], message: str, tmp_path: Path
) -> None:
    done = call("fleet", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_status_of_a_folder_without_a_fleet_is_an_error(call: Command, tmp_path: Path) -> None:
    done = call("fleet", "status", tmp_path)
    assert done.returncode == 3
    assert "`istc-replay fleet` writes it" in done.stderr


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_stops_a_fleet_cleanly(number: int, code: int, config: Path, tmp_path: Path) -> None:
    arguments = ["fleet", str(LOG), "-o", str(tmp_path / "out"), "-c", str(config), "--jobs", "1"]
    script = "from istc_replay.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", script, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    manifest = tmp_path / "out/fleet.jsonl"
    for _ in range(600):
        if manifest.exists() and '"begun"' in manifest.read_text():
            break
        time.sleep(0.05)
    process.send_signal(number)
    _, error = process.communicate(timeout=30)
    assert process.returncode == code
    assert error == "istc-replay: interrupted; what was finished is kept, call again to go on\n"
    assert list((tmp_path / "out/logs").glob("*")) == list((tmp_path / "out/logs").glob(".*")) == []
    last = json.loads(manifest.read_text().splitlines()[-1])
    assert last["event"] == "stopped"
    assert "interrupted" in last["reason"]
