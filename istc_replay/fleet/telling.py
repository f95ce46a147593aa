"""What a call of a fleet tells: its sum, and fleet.log."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from istc_replay.fleet.inputs import Source
from istc_replay.fleet.manifest import ENDINGS, Entry, Manifest
from istc_replay.fleet.progress import Progress

LOG_NAME = "fleet.log"
#: How often the progress is written to fleet.log.
_TOLD_S = 30.0


@dataclass(frozen=True, slots=True)
class Summary:
    """What a call has come to: the entry of every log that ended, and what stopped it, if anything."""

    total: int
    counts: dict[str, int]
    named: list[Entry]
    worst_code: int
    stopped: str

    @classmethod
    def of(cls, sources: Sequence[Source], manifest: Manifest, stopped: str) -> Summary:
        """Sum up, over all logs of the call whether done in it or before."""
        entries = [manifest.books.ends.get(source.location) for source in sources]
        # Logs that still wait have the entry of an earlier call, if any.
        waiting = manifest.books.queued
        ended = [entry for entry in entries if entry is not None and entry["log"] not in waiting]
        counts = {status: sum(e["event"] == status for e in ended) for status in ENDINGS}
        named = [entry for entry in ended if entry["event"] != "done"]
        worst = max((int(entry.get("code", 0)) for entry in ended), default=0)
        return cls(len(sources), counts, named, worst, stopped)


class CallLog:
    """fleet.log: what happened when, for people; the manifest is the truth."""

    def __init__(self, folder: Path, progress: Progress, tell: Callable[[Progress, str], None]) -> None:
        self._path, self._progress, self._tell = folder / LOG_NAME, progress, tell
        self._told = time.monotonic()

    def say(self, text: str) -> None:
        """Write a line."""
        self._write(text)
        self._tell(self._progress, text)

    def ended(self, status: str, location: str, error: str, seconds: float) -> None:
        """Count a log and write its line."""
        self._progress.ended(status)
        text = f"{status}: {location} ({seconds:.1f} s)" + (f": {error}" if error else "")
        self._write(text)
        self._tell(self._progress, text if status != "done" else "")

    def tick(self) -> None:
        """Write the progress now and then."""
        self._tell(self._progress, "")
        if time.monotonic() - self._told >= _TOLD_S:
            self._told = time.monotonic()
            self._write(self._progress.line())

    def _write(self, text: str) -> None:
        shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
        stamp = time.strftime("%Y-%m-%d %H:%M:%S")
        # A disk without room for this line has its own error elsewhere.
        with suppress(OSError), self._path.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{stamp} {shown}\n")
