"""The manifest: an append-only file of JSON lines that says what became of every log."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from istc_replay.errors import ExportError, LogError, UsageError

NAME = "fleet.jsonl"
SCHEMA = "istc-replay.fleet.v1"
#: Events that end a log.
ENDINGS = ("done", "inconclusive", "failed")

Entry = dict[str, Any]


@dataclass(slots=True)
class Books:
    """What a manifest says: the last event of every log, and the last call of the fleet."""

    ends: dict[str, Entry] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    call: Entry = field(default_factory=dict)
    end: Entry | None = None
    queued: dict[str, None] = field(default_factory=dict)
    running: dict[str, Entry] = field(default_factory=dict)
    ended_now: list[Entry] = field(default_factory=list)
    torn: int = 0

    def take(self, entry: Entry) -> None:
        """Enter one event."""
        event = entry.get("event")
        if event == "fleet":
            self.call, self.end = entry, None
            self.queued, self.running, self.ended_now = {}, {}, []
        elif event == "stopped":
            self.end = entry
            self.running = {}
        elif event == "queued":
            self.queued[entry["log"]] = None
            self.names[entry["log"]] = entry["folder"]
        elif event in ("begun", "again"):
            self.running.pop(entry["log"], None)
            if event == "begun":
                self.running[entry["log"]] = entry
        elif event in ENDINGS:
            self.ends[entry["log"]] = entry
            self.names[entry["log"]] = entry["folder"]
            self.running.pop(entry["log"], None)
            if self.queued.pop(entry["log"], 0) is None:
                self.ended_now.append(entry)


def read_manifest(folder: Path) -> Books:
    """Read a fleet's manifest; lines that are torn are counted, not obeyed.

    Raises
    ------
    LogError
        If there is none, or it is not a manifest of this schema.
    """
    path = folder / NAME
    try:
        books = _read(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}; `istc-replay fleet` writes it") from None
    if not books.call:
        raise LogError(f"{path}: is not the manifest of a fleet, or nothing of it is intact")
    return books


def _read(path: Path) -> Books:
    books = Books()
    with path.open("rb") as file:
        for entry in _entries(file, books):
            books.take(entry)
    return books


def _entries(file: IO[bytes], books: Books) -> Iterator[Entry]:
    for line in file:
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            whole = line.endswith(b"\n") and _is_entry(entry)
        except (ValueError, RecursionError):
            whole = False
        if not whole:
            books.torn += 1
        elif entry["event"] == "fleet" and entry.get("schema") != SCHEMA:
            found = str(entry.get("schema"))[:80]
            raise LogError(f"{file.name}: has schema {found!r}, not {SCHEMA}; choose another folder")
        else:
            yield entry


def _is_entry(entry: Any) -> bool:
    if not isinstance(entry, dict) or not isinstance(entry.get("event"), str):
        return False
    needs = {"queued": ("log", "folder"), "begun": ("log",), "again": ("log",)}
    needs |= dict.fromkeys(ENDINGS, ("log", "folder"))
    return all(isinstance(entry.get(name), str) for name in needs.get(entry["event"], ()))


class Manifest:
    """A manifest that this process alone writes.

    Raises
    ------
    UsageError
        If another fleet writes to the folder.
    ExportError
        If it cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
        self._flushed = True
        try:
            self._file = self._path.open("ab", buffering=0)
        except OSError as error:
            raise ExportError(f"{self._path}: cannot be written: {error.strerror}") from None
        try:
            self._lock(folder)
            self.books = _read(self._path)
            if not self.books.call and self.books.torn > 1:
                raise LogError(f"{self._path}: is not the manifest of a fleet; choose another folder")
            self._end_torn_line()
        except BaseException:
            self._file.close()
            raise

    def _lock(self, folder: Path) -> None:
        for _ in range(20):
            with suppress(BlockingIOError):
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            # `fleet status` holds it for an instant.
            time.sleep(0.05)
        raise UsageError(f"{folder}: another fleet is at work here; wait for it, or choose another folder")

    def append(self, *entries: Entry, flush: bool = True) -> None:
        """Write entries, all or none, and flush them to the disk, or leave that to `flush`.

        Raises
        ------
        ExportError
            If the disk is full or fails; what it could not take is not there.
        """
        at = round(time.time(), 3)
        text = "".join(json.dumps({**entry, "at": at}, allow_nan=False) + "\n" for entry in entries)
        size = self._path.stat().st_size
        try:
            _write_all(self._file, text.encode())
        except OSError as error:
            os.ftruncate(self._file.fileno(), size)
            raise self._refused(error) from None
        for entry in entries:
            self.books.take({**entry, "at": at})
        self._flushed = False
        if flush:
            self.flush()

    def flush(self) -> None:
        """See that every entry is on the disk; many at once cost as much as one.

        Raises
        ------
        ExportError
            If the disk fails.
        """
        if self._flushed:
            return
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._refused(error) from None
        self._flushed = True

    def _refused(self, error: OSError) -> ExportError:
        return ExportError(
            f"{self._path}: cannot be written: {error.strerror}; free some space, then call again"
        )

    def close(self) -> None:
        """Give the folder free for another fleet."""
        self._file.close()

    def _end_torn_line(self) -> None:
        """End the line that a killed writer left; what follows must not be glued to it."""
        with self._path.open("rb") as file:
            if file.seek(0, os.SEEK_END):
                file.seek(-1, os.SEEK_END)
                torn = file.read(1) != b"\n"
            else:
                torn = False
        if torn:
            _write_all(self._file, b"\n")


def _write_all(file: Any, data: bytes) -> None:
    view = memoryview(data)
    while view:
        written = file.write(view)
        if not written:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        view = view[written:]


def is_held(folder: Path) -> bool:
    """Tell whether a fleet is at work in a folder, on this machine or one that shares its locks."""
    try:
        with (folder / NAME).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def this_process() -> str:
    """Host and process id, to be written down."""
    return f"{socket.gethostname()}/{os.getpid()}"
