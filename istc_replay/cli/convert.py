"""`istc-replay convert`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, config_option, print_lines


@click.command()
@click.argument("recording", type=FILE)
@click.argument("out", type=FILE)
@click.option(
    "--types", type=FILE, multiple=True, help="SUMO's file that declares the vTypes; may be given again."
)
@click.option("--net", type=FILE, help="SUMO's network: its lanes go into the log.")
@config_option
def convert(
    recording: Path, out: Path, types: tuple[Path, ...], net: Path | None, config_path: Path | None
) -> int:
    """Write RECORDING, of another format, to OUT as an MCAP log that every command reads.

    RECORDING is a CommonRoad scenario (XML), SUMO's floating car data (XML, also .gz), or a table of
    states (.csv, .tsv, .parquet), whose columns [ingest.columns] of the configuration can name.

    \b
    Example:  istc-replay convert fcd.xml traffic.mcap --types routes.rou.xml --net net.xml
              istc-replay convert tracks.csv tracks.mcap
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline.convert import convert_recording

    with Progress(recording.name) as progress:
        done = convert_recording(recording, out, load_config(config_path), types, progress.bytes, net)
    print_lines(tell.converted_lines(done))
    return 0 if done.complete else 3
