"""`istc-replay view`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE


@click.command()
@click.argument("result", type=FILE)
@click.option("--save", type=FILE, help="Write the view to this .rrd instead of opening it.")
def view(result: Path, save: Path | None) -> None:
    """Open RESULT (a result's folder or result.mcap) in Rerun.

    \b
    Example:  istc-replay view results/intersection_turn_first
    """
    if save is None:
        show(result)
        return
    from istc_replay.export.rerun_view import save_view

    save_view(result, save)
    click.echo(tell.line(save))


def show(result: Path) -> None:
    """Open a result in the native viewer."""
    from istc_replay.export.rerun_view import show_view

    show_view(result)
