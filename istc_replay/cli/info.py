"""`istc-replay info`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, config_option, print_lines


@click.command()
@click.argument("log", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@config_option
def info(log: Path, as_json: bool, config_path: Path | None) -> int:
    """Tell what LOG holds: channels and how they are read, vehicles, spans, rates, problems.

    \b
    Example:  istc-replay info sample_logs/intersection_osi.mcap
    """
    from istc_replay.config import load_config
    from istc_replay.ingest.log import read_log

    with Progress(log.name) as progress:
        read = read_log(log, load_config(config_path), progress.bytes)
    facts = tell.log_facts(read)
    if as_json:
        click.echo("\n".join(tell.json_lines(facts)))
    else:
        print_lines(tell.info_lines(facts))
    return 0 if read.complete else 3
