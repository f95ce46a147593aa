"""What came of a log's windows, kept packed: unpacked, a long log's would not fit into memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from istc_replay.datatypes import WindowOutcome, WindowPlan

#: Outcomes unpacked at once: what goes through the windows in step finds them there.
_UNPACKED = 4


class Outcomes(Sequence["WindowOutcome"]):
    """Outcomes of windows in their order, each unpacked when it is asked for.

    Parameters
    ----------
    indices : sequence of int
        The windows.
    load : callable
        Gives the outcome of a window.
    """

    def __init__(self, indices: Sequence[int], load: Callable[[int], WindowOutcome]) -> None:
        self._indices = tuple(indices)
        self._load = lru_cache(_UNPACKED)(load)

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, place: int) -> WindowOutcome: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[WindowOutcome]: ...
    def __getitem__(self, place: int | slice) -> WindowOutcome | Sequence[WindowOutcome]:
        if isinstance(place, slice):
            return [self._load(index) for index in self._indices[place]]
        return self._load(self._indices[place])


class Plans(Sequence["WindowPlan"]):
    """The plans of outcomes, each taken when it is asked for."""

    def __init__(self, outcomes: Sequence[WindowOutcome]) -> None:
        self._outcomes = outcomes

    def __len__(self) -> int:
        return len(self._outcomes)

    @overload
    def __getitem__(self, place: int) -> WindowPlan: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[WindowPlan]: ...
    def __getitem__(self, place: int | slice) -> WindowPlan | Sequence[WindowPlan]:
        if isinstance(place, slice):
            return [outcome.plan for outcome in self._outcomes[place]]
        return self._outcomes[place].plan
