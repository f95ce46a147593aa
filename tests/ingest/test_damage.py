"""Every kind of damage of scripts/damage-table: what is intact is read, and what is not is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from istc_replay.config import parse_config
from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log

from ..support.scripts import load_script

#: Kinds that take a second each to make and read; `scripts/damage-table` measures all of them.
SLOW = ("million", "000 ", "GiB", "small")
KINDS, config_of = load_script("damage_kinds").KINDS, load_script("damage_table").config_of


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(
            kind, id=kind.name, marks=pytest.mark.slow if any(word in kind.name for word in SLOW) else ()
        )
        for kind in KINDS
    ],
)
def test_damage_costs_only_what_it_hit_and_is_told(kind: Any, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(kind.data())
    if kind.intact == -1:
        with pytest.raises(LogError) as error:
            read_log(path)
        assert "\n" not in str(error.value)
        return
    log = read_log(path, parse_config(config_of(kind.fields)))
    assert kind.codes <= {problem.code for problem in log.problems}
    if kind.intact is not None:
        assert log.messages == kind.intact
    if kind.codes & {"truncated", "chunk_crc", "chunk_damaged", "record_damaged", "chunk_too_long"}:
        assert not log.complete
    for problem in log.problems:
        assert len(problem.detail) < 1000
        assert "\n" not in problem.detail
