"""`istc-replay export`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, chosen_formats

_FORMATS: tuple[Literal["parquet", "csv", "foxglove"], ...] = ("parquet", "csv", "foxglove")


@click.command()
@click.argument("source", type=FILE)
@click.option("-o", "--output", type=FILE, required=True, help="Folder of the files.")
@click.option(
    "--format", "formats", default="parquet", show_default=True, help="parquet, csv, foxglove, with commas."
)
@click.option("-c", "--config", "config_path", type=FILE, help="Configuration (TOML), for a log.")
def export(source: Path, output: Path, formats: str, config_path: Path | None) -> int:
    """Write the tables of SOURCE, a log or a result (its folder or result.mcap).

    foxglove is no table but the layout in which Foxglove and Lichtblick show a result.

    \b
    Example:  istc-replay export results/intersection_turn_first -o tables --format parquet,csv
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline.tables import export_files

    chosen = chosen_formats(formats, _FORMATS)
    with Progress(source.name) as progress:
        complete, files = export_files(source, output, chosen, load_config(config_path), progress.bytes)
    for file in files:
        click.echo(tell.line(file))
    return 0 if complete else 3
