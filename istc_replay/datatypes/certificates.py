"""What a check of a plan says."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """The outcome of one check; inconclusive is never pass."""

    PASS = "pass"  # noqa: S105
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
    NOT_APPLICABLE = "not_applicable"


@dataclass(frozen=True, slots=True)
class Certificate:
    """One check of one plan: its verdict, the least margin, and the witness.

    `margin` is in `unit`, negative where the check fails; `time_s` (from the window's start),
    `vehicles` and `detail` name the place of the least margin.
    """

    window: int
    check: str
    verdict: Verdict
    margin: float | None
    unit: str
    time_s: float | None = None
    vehicles: tuple[str, ...] = ()
    detail: str = ""
