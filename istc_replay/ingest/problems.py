"""Collecting what is wrong with a log, so that a million faults make a few lines."""

from __future__ import annotations

from istc_replay.datatypes import Problem

#: How many faults of one kind are told one by one, and how many kinds of one code are told apart.
_TOLD = 5
_KINDS = 50


def quoted(text: str, limit: int = 80) -> str:
    """Quote text from a log on one line, without control characters and no longer than limit."""
    return repr(text if len(text) <= limit else text[: limit - 1] + "…")


class Problems:
    """A list of problems of bounded length: a few of each kind, then how many more there are.

    `lost` tells whether any of them means that a part of the log is missing; `first_loss` is the
    first such detail.
    """

    def __init__(self) -> None:
        self.lost = False
        self.first_loss = ""
        self._told: dict[tuple[str, str], list[Problem]] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._kinds: dict[str, int] = {}

    def add(self, code: str, detail: str, offset: int | None = None, kind: str = "", times: int = 1) -> None:
        """Tell a fault that is there so many times; `kind` keeps apart what shares a code, such as topics."""
        key = (code, kind)
        if key not in self._counts:
            if self._kinds.get(code, 0) >= _KINDS:
                key = (code, "")
            self._kinds[code] = self._kinds.get(code, 0) + 1
        told = self._told.setdefault(key, [])
        self._counts[key] = self._counts.get(key, 0) + times
        if len(told) < _TOLD and not (told and told[-1].detail == detail):
            told.append(Problem(code, detail, offset))

    def lose(self, code: str, detail: str, offset: int | None = None, kind: str = "") -> None:
        """Tell a fault for which a part of the log is missing."""
        self.lost = True
        self.first_loss = self.first_loss or detail
        self.add(code, detail, offset, kind)

    def found(self) -> tuple[Problem, ...]:
        """Return the problems in the order in which their kinds were first met."""
        found: list[Problem] = []
        for key, told in self._told.items():
            more = self._counts[key] - len(told)
            found += told
            if more:
                of_kind = f" ({key[1]})" if key[1] else ""
                found.append(Problem(key[0], f"{more} more of this kind{of_kind}", None))
        return tuple(found)
