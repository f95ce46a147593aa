"""Windows that are done, kept while a long run lasts, so that a killed one goes on where it was."""

from __future__ import annotations

import hashlib
import json
import shutil
from typing import TYPE_CHECKING, Protocol

import zstandard

from istc_replay.errors import LogError
from istc_replay.plain import from_plain, to_plain

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from istc_replay.datatypes import WindowOutcome

_PREFIX = ".istc-work-"
#: No window's outcome is larger than this when unpacked.
_LARGEST = 2**30


def packed(outcome: WindowOutcome) -> bytes:
    """An outcome as bytes that `unpacked` reads back to the same values."""
    text = json.dumps(to_plain(outcome), separators=(",", ":"))
    return zstandard.ZstdCompressor(level=3).compress(text.encode())


def unpacked(data: bytes) -> WindowOutcome:
    """Read an outcome back; nothing but data types is made of it.

    Raises
    ------
    LogError
        If the bytes are damaged.
    """
    try:
        text = zstandard.ZstdDecompressor().decompress(data, max_output_size=_LARGEST)
        outcome: WindowOutcome = from_plain(json.loads(text))
    except (zstandard.ZstdError, ValueError, RecursionError) as error:
        raise LogError(f"not a stored window: {error}") from None
    return outcome


def clear_work(output: Path) -> None:
    """Remove what runs into an output folder have kept."""
    for folder in output.glob(_PREFIX + "*"):
        shutil.rmtree(folder, ignore_errors=True)


class Store(Protocol):
    """Where outcomes are kept, by the indices of their windows."""

    def holds(self, index: int) -> bool:
        """Whether a window is done."""

    def load(self, index: int) -> WindowOutcome:
        """A window that is done."""

    def save(self, outcome: WindowOutcome) -> None:
        """Keep a window."""


class Memory:
    """Keeps outcomes packed in memory, while a run lasts."""

    def __init__(self) -> None:
        self._packed: dict[int, bytes] = {}

    def holds(self, index: int) -> bool:
        """Whether a window is done."""
        return index in self._packed

    def load(self, index: int) -> WindowOutcome:
        """A window that is done."""
        return unpacked(self._packed[index])

    def save(self, outcome: WindowOutcome) -> None:
        """Keep a window."""
        self._packed[outcome.plan.scenario.window.index] = packed(outcome)


class WorkFolder:
    """Keeps outcomes in a folder of their own within the output folder.

    Its name follows from the log, the settings in force and the versions: an outcome of another
    run is never taken.

    Parameters
    ----------
    output : Path
        The output folder.
    log_sha256, config_toml, versions
        What an outcome follows from.
    """

    def __init__(self, output: Path, log_sha256: str, config_toml: str, versions: Mapping[str, str]) -> None:
        told = json.dumps([log_sha256, config_toml, sorted(versions.items())])
        self._folder = output / (_PREFIX + hashlib.sha256(told.encode()).hexdigest()[:24])

    def holds(self, index: int) -> bool:
        """Whether a window is done; it is not where its file is damaged."""
        try:
            return self.load(index).plan.scenario.window.index == index
        except LogError:
            return False

    def load(self, index: int) -> WindowOutcome:
        """A window that is done.

        Raises
        ------
        LogError
            If it is not, or its file is damaged.
        """
        try:
            return unpacked(self._file(index).read_bytes())
        except OSError as error:
            raise LogError(f"{self._file(index)}: not a stored window: {error}; run again") from None

    def save(self, outcome: WindowOutcome) -> None:
        """Keep a window.

        Raises
        ------
        ExportError
            If it cannot be written.
        """
        from istc_replay.export.atomic import atomic_file, prepare_folder

        prepare_folder(self._folder)
        with atomic_file(self._file(outcome.plan.scenario.window.index)) as file:
            file.write_bytes(packed(outcome))

    def _file(self, index: int) -> Path:
        return self._folder / f"{index:07d}.json.zst"
