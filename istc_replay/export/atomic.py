"""Writing outputs whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from istc_replay.errors import ExportError

_REMEDIES = {
    errno.ENOSPC: "free some space or choose another folder",
    errno.EDQUOT: "free some space or choose another folder",
    errno.EFBIG: "raise the limit of file sizes or choose another folder",
    errno.EISDIR: "remove that folder or choose another name",
    errno.EACCES: "choose a folder that you may write to",
    errno.EPERM: "choose a folder that you may write to",
    errno.EROFS: "choose a folder that you may write to",
}
_REMEDY = "choose another folder"


def prepare_folder(path: Path) -> Path:
    """Make a folder and its parents where they are missing, and return its path.

    Raises
    ------
    ExportError
        If it cannot be made, is a file, or cannot be written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise refused(path, error) from None
    return path


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary file beside `path` to write to; it becomes `path` when the block ends well.

    The temporary file exists, is empty, and has the suffix of `path`. Whatever ends the block
    otherwise, the temporary file is removed and what stood at `path` before stays as it was.

    Raises
    ------
    ExportError
        If anything in the block, or the renaming, fails with an OSError: no such folder, not
        writable, disk full, a folder in the way.
    """
    temporary: Path | None = None
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        temporary = _new_file(path)
        yield temporary
        _flush_to_disk(temporary)
        temporary.replace(path)
    except BaseException as error:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise refused(path, error) from None
        raise


def _new_file(path: Path) -> Path:
    handle, name = tempfile.mkstemp(prefix=".istc-", suffix=path.suffix, dir=path.parent)
    # mkstemp's file is its owner's alone; an output has the modes of any new file.
    mask = os.umask(0)
    os.umask(mask)
    try:
        os.fchmod(handle, 0o666 & ~mask)
    finally:
        os.close(handle)
    return Path(name)


def _flush_to_disk(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def refused(path: Path, error: OSError) -> ExportError:
    """Tell of an output that cannot be written: the path, why, and the remedy."""
    why = error.strerror or str(error) or type(error).__name__
    remedy = _REMEDIES.get(error.errno or 0, _REMEDY)
    return ExportError(f"{path}: cannot be written: {why}; {remedy}")
