"""Issues of the data: what is wrong, of whom, and the spans of time that cannot be trusted for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Issue:
    """Something wrong with the data of some bodies in a span of time.

    `doubtful` says that states in the span cannot be trusted; a gap has none to doubt.
    """

    rule: str
    bodies: tuple[int, ...]
    start_ns: int
    worst_ns: int
    end_ns: int
    value: float
    unit: str
    threshold: float
    source: str
    detail: str
    doubtful: bool = True


def doubtful_spans(issues: list[Issue], count: int) -> list[IntArray]:
    """(n, 2) merged spans of doubtful data, one array a body."""
    spans: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for issue in sorted(issues, key=lambda issue: issue.start_ns):
        if not issue.doubtful:
            continue
        for row in issue.bodies:
            if spans[row] and issue.start_ns <= spans[row][-1][1]:
                start, end = spans[row][-1]
                spans[row][-1] = (start, max(end, issue.end_ns))
            else:
                spans[row].append((issue.start_ns, issue.end_ns))
    return [np.asarray(own, dtype=np.int64).reshape(-1, 2) for own in spans]


def is_doubtful(spans: IntArray, start_ns: IntArray, end_ns: IntArray) -> NDArray[np.bool_]:
    """(n,) whether spans of time touch doubtful ones."""
    if spans.shape[0] == 0:
        return np.zeros(np.shape(start_ns), dtype=bool)
    # Doubtful spans are disjoint and sorted: the first that ends late enough decides.
    row = np.searchsorted(spans[:, 1], start_ns)
    inside = row < spans.shape[0]
    return np.asarray(inside & (spans[np.minimum(row, spans.shape[0] - 1), 0] <= end_ns))
