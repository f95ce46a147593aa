"""`istc-replay recover`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, print_lines


@click.command()
@click.argument("log", type=FILE)
@click.argument("out", type=FILE)
def recover(log: Path, out: Path) -> None:
    """Write everything intact in LOG, a damaged log, to OUT: a whole log with indexes and statistics.

    What is lost is told with its place. The exit code is 0 once OUT is written; 3 if LOG is no MCAP.

    \b
    Example:  istc-replay recover crashed.mcap whole.mcap
    """
    from istc_replay.pipeline.recover import recover_log

    with Progress(log.name) as progress:
        copied = recover_log(log, out, progress.bytes)
    print_lines(tell.copied_lines(copied))
