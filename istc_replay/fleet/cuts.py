"""Long logs: cut into ranges of windows that are done in parallel, then joined."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

from istc_replay.fleet.jobs import Job, Outcome


@dataclass(slots=True)
class _Cut:
    whole: Job
    left: int
    seconds: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0


@dataclass(slots=True)
class Cuts:
    """The long logs of a fleet whose windows are being done."""

    _cuts: dict[str, _Cut] = field(default_factory=dict)

    def cut(self, job: Job, windows: int) -> list[Job]:
        """Cut a log into jobs of at most `job.cut` windows each, of equal size but for one window."""
        parts = -(-windows // job.cut)
        bounds = [windows * i // parts for i in range(parts + 1)]
        self._cuts[job.location] = _Cut(job, parts)
        return [replace(job, windows=span) for span in pairwise(bounds)]

    def part_ended(self, job: Job, outcome: Outcome) -> Job | None:
        """Count a part; gives the job that joins them when it was the last."""
        cut = self._cuts[job.location]
        cut.left -= 1
        self._count(cut, outcome)
        return replace(cut.whole, cut=0) if cut.left == 0 else None

    def given_up(self, job: Job) -> bool:
        """Tell whether a part belongs to a log that has failed already."""
        return job.windows is not None and job.location not in self._cuts

    def log_ended(self, job: Job, outcome: Outcome) -> Outcome:
        """Close a log's cut, if there is one; its outcome has the effort of all parts."""
        cut = self._cuts.pop(job.location, None)
        if cut is None:
            return outcome
        self._count(cut, outcome)
        return replace(outcome, seconds=cut.seconds, cpu_s=cut.cpu_s, peak_mb=cut.peak_mb)

    def _count(self, cut: _Cut, outcome: Outcome) -> None:
        cut.seconds = round(cut.seconds + outcome.seconds, 3)
        cut.cpu_s = round(cut.cpu_s + outcome.cpu_s, 3)
        cut.peak_mb = max(cut.peak_mb, outcome.peak_mb)
