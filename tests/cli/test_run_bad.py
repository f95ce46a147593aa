"""`istc-replay run` on bad input: one line that says so, and nothing half written."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

from ..support.commands import FAST, TURN_FIRST, Command, expect_failure


def test_a_missing_log_is_one_line(call: Command, tmp_path: Path) -> None:
    expect_failure(call("run", tmp_path / "none.mcap", "-o", tmp_path), 3, "none.mcap", "no such file")


def test_a_file_that_is_no_mcap_is_one_line(call: Command, tmp_path: Path) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("hello\n")
    expect_failure(call("run", text, "-o", tmp_path / "out"), 3, "text.mcap", "not an MCAP")


def test_an_unknown_config_key_names_the_known_ones(call: Command, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text("[corridors]\narea_wait = 1\n")
    done = call("run", TURN_FIRST, "-c", config, "-o", tmp_path)
    expect_failure(done, 2, "corridors.area_wait", "area_weight")
    config.write_text('[corridors]\narea_weight = "much"\n')
    expect_failure(call("config", config), 2, "corridors.area_weight", "'much'")


def test_a_folder_that_cannot_be_written_is_one_line(call: Command, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    expect_failure(call("run", TURN_FIRST, "-o", tmp_path / "file" / "out"), 2, "cannot be written")


def test_two_logs_for_one_folder_are_refused(call: Command, tmp_path: Path) -> None:
    copy = tmp_path / TURN_FIRST.name
    copy.write_bytes(TURN_FIRST.read_bytes())
    expect_failure(call("run", TURN_FIRST, copy, "-o", tmp_path), 2, "another log writes to")


def test_a_full_disk_leaves_nothing_half_written(call: Command, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text(FAST)

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    done = call("run", TURN_FIRST, "-c", config, "-o", tmp_path / "out", preexec_fn=limited)
    assert done.returncode in (2, 4), (done.stdout, done.stderr)
    assert len(done.stderr.strip().splitlines()) == 1
    assert list((tmp_path / "out" / TURN_FIRST.stem).iterdir()) == []


def test_a_log_without_vehicles_names_its_schemas(call: Command, tmp_path: Path) -> None:
    from mcap.writer import Writer

    log = tmp_path / "other.mcap"
    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"float64 x")
        channel = writer.register_channel("/imu", "cdr", schema)
        writer.add_message(channel, 0, b"\x00\x01\x00\x00" + b"\x00" * 8, 0)
        writer.finish()
    expect_failure(call("run", log, "-o", tmp_path / "out"), 3, "no vehicle states", "sensor_msgs/msg/Imu")
