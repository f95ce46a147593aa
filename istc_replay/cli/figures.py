"""`istc-replay figures`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, chosen_formats

_FIGURE_FORMATS: tuple[Literal["png", "svg", "pdf"], ...] = ("png", "svg", "pdf")


@click.command()
@click.argument("result", type=FILE)
@click.option("-o", "--output", type=FILE, required=True, help="Folder of the pictures.")
@click.option("--format", "formats", default="png", show_default=True, help="png, svg, pdf, with commas.")
def figures(result: Path, output: Path, formats: str) -> None:
    """Draw RESULT (its folder or result.mcap) as the paper draws its results, window by window.

    \b
    Example:  istc-replay figures results/intersection_turn_first -o pictures --format svg,pdf
    """
    from istc_replay.pipeline.figures import write_figures

    for file in write_figures(result, output, chosen_formats(formats, _FIGURE_FORMATS)):
        click.echo(tell.line(file))
