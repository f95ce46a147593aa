"""A log's outputs: a folder that is there whole, with a receipt of every file, or not at all."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file, refused
from istc_replay.fleet.inputs import sha256_of

RECEIPT = "receipt.json"
SCHEMA = "istc-replay.receipt.v1"
#: What renaming a folder says of one that stands there; two workers may have got the same job.
_IN_THE_WAY = (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR)
_TRIES = 5
#: Folders of jobs under way, and of outputs that are being replaced.
_UNDER_WAY, _REPLACED = ".istc-job-", ".istc-old-"


def logs_folder(fleet: Path) -> Path:
    """The folder that holds a folder for every log."""
    return fleet / "logs"


def job_key(log_sha256: str, config_sha256: str, version: str) -> str:
    """What a job's outputs follow from, as one hash."""
    return hashlib.sha256(f"{log_sha256} {config_sha256} {version}".encode()).hexdigest()


@contextmanager
def job_folder(fleet: Path, name: str) -> Iterator[Path]:
    """Give a folder of a temporary name for a job's outputs; whatever is left of it goes at the end.

    Raises
    ------
    ExportError
        If it cannot be made.
    """
    parent = logs_folder(fleet)
    try:
        parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f"{_UNDER_WAY}{name}-", dir=parent))
        folder.chmod(0o755)
    except OSError as error:
        raise refused(parent, error) from None
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def seal(folder: Path, name: str, facts: dict[str, Any]) -> str:
    """Write the receipt of a job's outputs as the last of them; returns its hash.

    Parameters
    ----------
    folder : Path
        The job's folder, everything in it written.
    name : str
        The folder's name once it is in place.
    facts : dict
        What else the receipt tells, the key among it.
    """
    files = {
        file.relative_to(folder).as_posix(): {"bytes": file.stat().st_size, "sha256": sha256_of(file)}
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }
    text = json.dumps({"schema": SCHEMA, "name": name, **facts, "files": files}, indent=1) + "\n"
    with atomic_file(folder / RECEIPT) as file:
        file.write_text(text, encoding="utf-8")
    for inner in (*(f for f in folder.rglob("*") if f.is_dir()), folder):
        _flush_folder(inner)
    return hashlib.sha256(text.encode()).hexdigest()


def publish(folder: Path, fleet: Path, name: str) -> None:
    """Put a sealed folder in its place; one that stands there goes.

    Raises
    ------
    ExportError
        If it cannot be moved.
    """
    place = logs_folder(fleet) / name
    try:
        replace_folder(folder, place)
    except OSError as error:
        raise refused(place, error) from None


def replace_folder(folder: Path, place: Path) -> None:
    """Move a folder to a place; one that stands there goes, and comes back with `recover` after a kill."""
    old: list[Path] = []
    for _ in range(_TRIES):
        try:
            folder.rename(place)
            break
        except OSError as error:
            if error.errno not in _IN_THE_WAY:
                raise
        old.append(Path(tempfile.mkdtemp(prefix=f"{_REPLACED}{place.name}-", dir=place.parent)))
        with suppress(FileNotFoundError):
            place.rename(old[-1] / place.name)
    else:
        raise OSError(errno.EBUSY, "something else keeps writing it")
    _flush_folder(place.parent)
    for replaced in old:
        shutil.rmtree(replaced, ignore_errors=True)


def read_receipt(folder: Path) -> dict[str, Any] | None:
    """Read the receipt of a log's outputs; None where there is none that is whole."""
    try:
        receipt = json.loads((folder / RECEIPT).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    whole = (
        isinstance(receipt, dict)
        and receipt.get("schema") == SCHEMA
        and isinstance(receipt.get("files"), dict)
        and all(isinstance(receipt.get(k), str) for k in ("name", "key", "log_sha256", "status"))
    )
    return receipt if whole else None


def whole_receipt(folder: Path) -> dict[str, Any] | None:
    """Give the receipt of outputs of which every file is as it was written, byte for byte."""
    receipt = read_receipt(folder)
    if receipt is None:
        return None
    for name, told in receipt["files"].items():
        path = folder / name
        try:
            if path.stat().st_size != told["bytes"] or sha256_of(path) != told["sha256"]:
                return None
        except (OSError, TypeError, KeyError, ValueError):
            return None
    return receipt


def recover(fleet: Path) -> None:
    """Tidy up after a fleet that was killed: finished outputs go to their place, what is half-written goes.

    A job seals its folder before it moves it, so that a sealed one is finished.
    """
    parent = logs_folder(fleet)
    if not parent.is_dir():
        return
    for folder in sorted(parent.glob(f"{_UNDER_WAY}*")):
        receipt = whole_receipt(folder)
        if receipt is not None and Path(receipt["name"]).name == receipt["name"]:
            with suppress(ExportError):
                publish(folder, fleet, receipt["name"])
        shutil.rmtree(folder, ignore_errors=True)
    for folder in sorted(parent.glob(f"{_REPLACED}*")):
        for old in folder.iterdir():
            if not os.path.lexists(parent / old.name):
                old.rename(parent / old.name)
        shutil.rmtree(folder, ignore_errors=True)


def _flush_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
