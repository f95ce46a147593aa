"""What the commands share: types of arguments, lists of formats, lines, and progress."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from istc_replay import tell

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: Characters of a bar, and the least time between two pictures of it [s].
_BAR, _REDRAW_S = 30, 0.1

FILE = click.Path(path_type=Path)
_Format = TypeVar("_Format", bound=str)

config_option = click.option("-c", "--config", "config_path", type=FILE, help="Configuration (TOML).")


def print_lines(lines: Iterable[str]) -> None:
    """Print lines on stdout."""
    for text in lines:
        click.echo(text)


def chosen_formats(formats: str, known: Sequence[_Format]) -> list[_Format]:
    """Read a list with commas."""
    parts = [part.strip() for part in formats.split(",")]
    unknown = [part for part in parts if part not in known]
    if unknown:
        raise click.UsageError(f"--format {formats}: {unknown[0]!r} is not one of {', '.join(known)}")
    return [name for name in known if name in parts]


class Progress:
    """One line on a terminal's stderr that tells what is being done, and how fast; silent elsewhere."""

    def __init__(self, name: str) -> None:
        self._name = tell.line(name)
        self._shown = sys.stderr.isatty()
        self._first: tuple[float, int] | None = None
        self._began = self._last = time.monotonic()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            click.echo("\r\x1b[K", nl=False, err=True)

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._shown:
            share = f" window {min(done + 1, total)} of {total}:" if total > 1 else ""
            click.echo(f"\r\x1b[K{self._name}:{share} {what}{self._rate(done, total)}", nl=False, err=True)

    def _rate(self, done: int, total: int) -> str:
        """Windows a minute since the first that was planned here, and how long the rest will take."""
        if total <= 1:
            return ""
        if self._first is None:
            self._first = time.monotonic(), done
        since, before = self._first
        if done <= before or done >= total:
            return ""
        seconds = (time.monotonic() - since) / (done - before)
        return f", {60.0 / seconds:.3g} windows/min, {seconds * (total - done):.0f} s left"

    def bytes(self, done: int, total: int) -> None:
        """Show how much of a file is read, and how fast; called as often as one likes."""
        now = time.monotonic()
        if not self._shown or now - self._last < _REDRAW_S or not total:
            return
        self._last = now
        filled = round(_BAR * done / total)
        bar = "#" * filled + "." * (_BAR - filled)
        rate = done / 2**20 / max(now - self._began, 1e-3)
        left_s = (total - done) / max(done, 1) * (now - self._began)
        text = f"{self._name}: [{bar}] {done / total:4.0%} {rate:.0f} MiB/s, {left_s:.0f} s left"
        click.echo(f"\r\x1b[K{text}", nl=False, err=True)
