"""Results as they are shown, judged and written as tables: whole, or where they are long in parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from istc_replay.ingest.result import load_result_folder, read_result, result_file
from istc_replay.ingest.result_states import plan_parts, recorded_states, result_parts, window_states

if TYPE_CHECKING:
    from collections.abc import Callable

    from istc_replay.datatypes import Result

#: Windows of a part; a result of no more is read whole.
PART_WINDOWS = 16


@dataclass(frozen=True, slots=True)
class Reading:
    """A result that is read: `result` is without its states where there are `parts`."""

    source: Path
    result: Result
    parts: Callable[[], Iterator[Result]] | None = None

    @property
    def states(self) -> Callable[[Sequence[int]], pl.DataFrame] | None:
        """Gives the states of some windows, where the result is without them."""
        return None if self.parts is None else self._states

    def each(self) -> Iterator[Result]:
        """The parts of the result, each with some of its windows."""
        return iter([self.result]) if self.parts is None else self.parts()

    def of(self, windows: Sequence[int]) -> Result:
        """The result with the states of some windows at least."""
        return self.result if self.parts is None else replace(self.result, states=self._states(windows))

    def recorded(self) -> pl.DataFrame:
        """All recorded states."""
        if self.parts is None:
            return self.result.states.filter(pl.col("source") == "recorded")
        return recorded_states(self.source, self.result)

    def plans(self) -> Iterator[Result]:
        """All states but the recorded ones, each once, with the tables of their windows."""
        if self.parts is None:
            states = self.result.states.filter(pl.col("source") != "recorded")
            return iter([replace(self.result, states=states)])
        return plan_parts(self.source, self.result, PART_WINDOWS)

    def vehicles(self) -> dict[str, int]:
        """Everybody of whom there is a state, with the time of the first [ns]."""
        first: dict[str, int] = {}
        for part in self.each():
            for vehicle_id, time_ns in part.states.group_by("vehicle_id").agg(pl.col("time_ns").min()).rows():
                first[vehicle_id] = min(time_ns, first.get(vehicle_id, time_ns))
        return first

    def _states(self, windows: Sequence[int]) -> pl.DataFrame:
        return window_states(self.source, self.result, windows)


def read_in_parts(source: Path) -> Reading:
    """Read a result's folder or file; of the states of a long one no more than some windows' are held.

    Raises
    ------
    LogError
        As `read_result` does.
    """
    file = result_file(source)
    head = load_result_folder(source, states=False)
    if len(head.summary.get("windows") or ()) <= PART_WINDOWS:
        return Reading(file, replace(head, states=read_result(file).states))
    return Reading(file, head, lambda: result_parts(file, head, PART_WINDOWS))
