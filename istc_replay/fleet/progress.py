"""How far a fleet is: counts, rate and remaining time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

#: The rate is that of the last so many logs.
_RECENT = 200


@dataclass(slots=True)
class Progress:
    """Counts of one call of a fleet.

    Parameters
    ----------
    total : int
        Logs of the call.
    whole : int
        Logs that an earlier call has done, and that are whole.
    """

    total: int
    whole: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    clock: Callable[[], float] = time.monotonic
    _ends: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT + 1))

    def __post_init__(self) -> None:
        self._ends.append(self.clock())

    def ended(self, status: str) -> None:
        """Count a log that has ended."""
        self.counts[status] = self.counts.get(status, 0) + 1
        self._ends.append(self.clock())

    @property
    def left(self) -> int:
        """Logs that have not ended."""
        return self.total - self.whole - sum(self.counts.values())

    @property
    def rate_per_s(self) -> float | None:
        """Logs a second of late; None before the first."""
        if len(self._ends) < 2:
            return None
        span = self.clock() - self._ends[0]
        return (len(self._ends) - 1) / span if span > 0 else None

    @property
    def remaining_s(self) -> float | None:
        """Time that the rest will take at this rate."""
        rate = self.rate_per_s
        return None if rate is None else self.left / rate

    def line(self) -> str:
        """Tell it in a line."""
        return progress_line(self.total, self.whole, self.counts, self.rate_per_s, self.remaining_s)


def progress_line(
    total: int,
    whole: int,
    counts: Mapping[str, int],
    rate_per_s: float | None,
    remaining_s: float | None,
) -> str:
    """Tell counts, rate and remaining time in a line."""
    ended = whole + sum(counts.values())
    parts = [f"{ended} of {total} logs"]
    told = [f"{counts[s]} {s}" for s in ("done", "inconclusive", "failed") if counts.get(s)]
    if whole:
        told.append(f"{whole} from before")
    if told:
        parts[0] += f" ({', '.join(told)})"
    if rate_per_s is not None:
        parts.append(f"{rate_per_s:.2f}/s" if rate_per_s >= 0.1 else f"{rate_per_s * 60:.1f}/min")
    if remaining_s is not None and ended < total:
        parts.append(f"{duration(remaining_s)} left")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """A time in two units, such as 3 min 20 s."""
    whole = round(seconds)
    for size, name, smaller, its_name in (
        (86400, "d", 3600, "h"),
        (3600, "h", 60, "min"),
        (60, "min", 1, "s"),
    ):
        if whole >= size:
            return f"{whole // size} {name} {whole % size // smaller} {its_name}"
    return f"{whole} s"
