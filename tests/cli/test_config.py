"""`istc-replay config` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

from ..support.commands import ROOT, Command


def test_the_explained_configuration_is_a_configuration(call: Command, tmp_path: Path) -> None:
    file = tmp_path / "my.toml"
    file.write_text(call("config").stdout)
    done = call("config", file)
    assert done.returncode == 0
    assert done.stdout == file.read_text()
    assert json.loads(call("config", "--schema").stdout) == json.loads(
        (ROOT / "schemas" / "config.schema.json").read_text()
    )
