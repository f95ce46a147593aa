"""A result as read back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from istc_replay.datatypes.scene import StaticScene

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """A result as read back from a result.mcap, the same truth that every view shows.

    Tables have the columns of the contract (see `states.py`); positions of `states` are box
    centres in the map frame. `corridors` and `obstacles` are in the window's corridor frame.
    """

    path: str
    states: pl.DataFrame
    corridors: pl.DataFrame
    obstacles: pl.DataFrame
    solves: pl.DataFrame
    certificates: pl.DataFrame
    findings: pl.DataFrame
    scene: StaticScene
    summary: dict[str, Any]
    config_toml: str
