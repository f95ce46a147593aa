"""A log as read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from istc_replay.datatypes.scene import StaticScene

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the input that is damaged, not understood or left out.

    `code` is a stable lower_snake_case word, `detail` one line for people, `offset` the byte in
    the file where one is known.
    """

    code: str
    detail: str
    offset: int | None = None


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """One channel of a log, as `info` tells it.

    `understood_as` is None where it is not read; `reason` says why nothing of it is used. The log
    times `first_ns` and `last_ns` are None without messages.
    """

    topic: str
    schema: str
    schema_encoding: str
    message_encoding: str
    messages: int
    understood_as: str | None
    reason: str = ""
    first_ns: int | None = None
    last_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A log as read: the states table (see `states.STATES_SCHEMA`) and what else it told."""

    path: str
    sha256: str
    complete: bool
    messages: int
    attachments: int
    metadata: int
    chunks: int
    start_ns: int | None
    end_ns: int | None
    channels: tuple[ChannelInfo, ...]
    states: pl.DataFrame
    scene: StaticScene
    problems: tuple[Problem, ...]
    time_source: str = "header"
    road_sha256: str = ""  # of the road file beside it
