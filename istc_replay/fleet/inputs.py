"""What a fleet reads: files, globs, folders, lists of them, and URLs."""

from __future__ import annotations

import glob
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from istc_replay.errors import LogError, UsageError
from istc_replay.pipeline.run import folder_name

#: Bytes that are copied or hashed at a time.
_BLOCK = 1 << 20
_STEM_BYTES = 120


@dataclass(frozen=True, slots=True)
class Source:
    """One log: where it is (an absolute path or a URL), and the name of its folder in the fleet."""

    location: str
    name: str


def find_logs(
    arguments: Sequence[str], lists: Sequence[Path] = (), leave_out: Path | None = None
) -> list[str]:
    """Find the logs that arguments name, each once, in the order of the arguments.

    Parameters
    ----------
    arguments : sequence of str
        Files, folders (every `.mcap` file below them), globs (`**` goes into folders), `@FILE`
        for a list, URLs where fsspec is installed.
    lists : sequence of Path
        Text files with one such argument a line; empty lines and lines that begin with `#` are
        skipped, relative paths count from the list's folder.
    leave_out : Path, optional
        A folder whose files are no logs, such as that of the outputs.

    Returns
    -------
    list of str
        Absolute paths and URLs.

    Raises
    ------
    UsageError
        If an argument names nothing, or a URL cannot be read for want of a package.
    """
    found: dict[str, None] = {}
    for argument in arguments:
        if argument.startswith("@") and not os.path.lexists(argument):
            found |= dict.fromkeys(_listed(Path(argument[1:])))
        else:
            found |= dict.fromkeys(_named(argument, Path.cwd()))
    for file in lists:
        found |= dict.fromkeys(_listed(file))
    if leave_out is None:
        return list(found)
    outputs = os.path.join(os.path.abspath(leave_out), "")  # noqa: PTH100, PTH118
    return [log for log in found if not log.startswith(outputs)]


def _listed(file: Path) -> Iterator[str]:
    try:
        lines = file.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError as error:
        raise UsageError(f"{file}: the list cannot be read: {error.strerror}") from None
    for line in lines:
        text = line.strip()
        if text and not text.startswith("#"):
            yield from _named(text, file.absolute().parent)


def _named(text: str, base: Path) -> list[str]:
    if is_url(text):
        return _remote(text)
    path = Path(os.path.abspath(base / text))  # noqa: PTH100, resolve() would follow links
    if path.is_dir():
        logs = sorted(str(file) for file in path.rglob("*.mcap") if file.is_file())
        if not logs:
            raise UsageError(f"{text}: no .mcap file is in this folder")
        return logs
    if glob.has_magic(text) and not os.path.lexists(path):
        logs = sorted(file for file in _matching(str(base / text)) if Path(file).is_file())
        if not logs:
            raise UsageError(f"{text}: no file matches")
        return [os.path.abspath(file) for file in logs]  # noqa: PTH100
    if not path.exists():
        raise UsageError(f"{text}: there is no such file or folder")
    return [str(path)]


def _matching(pattern: str) -> list[str]:
    return glob.glob(pattern, recursive=True)  # noqa: PTH207, Path.glob takes no absolute pattern


def is_url(text: str) -> bool:
    """Tell whether a text is a URL, such as s3://bucket/log.mcap."""
    return "://" in text and len(text.split("://", 1)[0]) > 1


def _remote(url: str) -> list[str]:
    fs, path = _file_system(url)
    try:
        if glob.has_magic(path):
            logs = sorted(fs.unstrip_protocol(name) for name in fs.glob(path))
        elif fs.isdir(path):
            logs = sorted(fs.unstrip_protocol(n) for n in fs.find(path) if n.endswith(".mcap"))
        else:
            return [url]
    except Exception as error:  # each file system has its own errors
        raise UsageError(f"{url}: cannot be listed: {_why(error)}") from None
    if not logs:
        raise UsageError(f"{url}: no log is there")
    return logs


def _file_system(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise UsageError(f"{url}: URLs need fsspec; install istc-replay[url]") from None
    try:
        fs, path = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise UsageError(f"{url}: {error}") from None
    except ValueError as error:
        raise UsageError(f"{url}: {error}; fsspec reads {', '.join(fsspec.available_protocols())}") from None
    return fs, path


def name_sources(locations: Iterable[str], taken: dict[str, str]) -> list[Source]:
    """Give each log a folder name: its stem, with a hash of its location where another log has that.

    Parameters
    ----------
    locations : iterable of str
        From `find_logs`.
    taken : dict of str to str
        Names given before, by location: they stay.
    """
    used = {name.casefold() for name in taken.values()}
    sources = []
    for location in locations:
        name = taken.get(location)
        if name is None:
            name = _stem(location)
            if name.casefold() in used:
                name = f"{name}-{hashlib.sha256(os.fsencode(location)).hexdigest()[:12]}"
            used.add(name.casefold())
        sources.append(Source(location, name))
    return sources


def file_name(location: str) -> str:
    """Name of a log's file, without its folders."""
    path = urlsplit(location).path if is_url(location) else location
    return Path(path).name or "log.mcap"


def _stem(location: str) -> str:
    stem = "".join(c if c.isprintable() else "_" for c in folder_name(Path(file_name(location))))
    if len(os.fsencode(stem)) <= _STEM_BYTES:
        return stem
    digest = hashlib.sha256(os.fsencode(stem)).hexdigest()[:12]
    return f"{os.fsencode(stem)[: _STEM_BYTES - 13].decode('utf-8', 'ignore')}-{digest}"


def stamp_of(location: str) -> str:
    """What tells without reading it that a log has not changed: its size and time of change.

    Raises
    ------
    LogError
        If it cannot be found.
    """
    if is_url(location):
        fs, path = _file_system(location)
        try:
            return str(fs.ukey(path))
        except Exception as error:
            raise LogError(f"{location}: cannot be found: {_why(error)}") from None
    try:
        status = os.stat(location)  # noqa: PTH116
    except OSError as error:
        raise LogError(f"{location}: cannot be found: {error.strerror}") from None
    return f"{status.st_size}:{status.st_mtime_ns}"


@contextmanager
def local_file(location: str, content: bytes | None) -> Iterator[Path]:
    """Give a log as a local file of its own name: in place, or a copy that goes when the block ends.

    Parameters
    ----------
    location : str
        Absolute path or URL.
    content : bytes or None
        The log's bytes, where they were sent along.
    """
    if content is None and not is_url(location):
        yield Path(location)
        return
    with tempfile.TemporaryDirectory(prefix="istc-fleet-") as folder:
        path = Path(folder) / file_name(location)
        if content is not None:
            path.write_bytes(content)
        else:
            _fetch(location, path)
        yield path


def _fetch(url: str, path: Path) -> None:
    fs, remote = _file_system(url)
    try:
        source = fs.open(remote, "rb")
    except Exception as error:
        raise LogError(f"{url}: cannot be read: {_why(error)}") from None
    with source, path.open("wb") as file:
        while block := _read(source, url):
            file.write(block)


def _read(source: Any, url: str) -> bytes:
    try:
        return bytes(source.read(_BLOCK))
    except Exception as error:
        raise LogError(f"{url}: cannot be read: {_why(error)}") from None


def sha256_of(path: Path) -> str:
    """Hash a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _why(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
