"""Outputs that are not where the driver looks do not count."""

from __future__ import annotations

from pathlib import Path

from istc_replay.fleet.drive import Fleet, Orders
from istc_replay.fleet.engine import Ended
from istc_replay.fleet.jobs import Job, Outcome


class Elsewhere:
    """An engine whose workers write to a folder of their own."""

    note = ""

    def __init__(self) -> None:
        self.ended: list[Ended] = []

    def free(self) -> int:
        return 1 - len(self.ended)

    def begin(self, job: Job) -> None:
        self.ended.append(Ended(job, Outcome("done", receipt_sha256="0" * 64, worker="far/1")))

    def wait(self, _seconds: float) -> list[Ended]:
        ended, self.ended = self.ended, []
        return ended

    def close(self) -> None:
        pass


def test_a_worker_that_writes_elsewhere_is_not_believed(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(b"")
    (tmp_path / "out" / "logs").mkdir(parents=True)
    summary = Fleet(tmp_path / "out", Orders()).run([str(log)], Elsewhere)
    assert [entry["error"] for entry in summary.named] == [
        "far/1 wrote to a folder that is not this one; it must be shared by all hosts"
    ]
    assert summary.counts == {"done": 0, "inconclusive": 0, "failed": 1}
