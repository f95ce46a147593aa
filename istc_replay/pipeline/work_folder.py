"""Windows that are done, kept while a long run lasts, so that a killed one goes on where it was."""

from __future__ import annotations

import hashlib
import json
import shutil
from typing import TYPE_CHECKING

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
        self._output = output
        self._folder = output / (_PREFIX + hashlib.sha256(told.encode()).hexdigest()[:24])

    def load(self, index: int) -> WindowOutcome | None:
        """A window that is done, None where it is not, or where its file is damaged."""
        try:
            outcome = unpacked(self._file(index).read_bytes())
        except (OSError, LogError):
            return None
        return outcome if outcome.plan.scenario.window.index == index else None

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

    def remove(self) -> None:
        """Remove this folder, and those that earlier runs into the same output left behind."""
        for folder in self._output.glob(_PREFIX + "*"):
            shutil.rmtree(folder, ignore_errors=True)

    def _file(self, index: int) -> Path:
        return self._folder / f"{index:07d}.json.zst"
