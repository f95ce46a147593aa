"""`istc-replay merge`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, print_lines


@click.command()
@click.argument("logs", type=FILE, nargs=-1, required=True)
@click.option("-o", "--output", type=FILE, required=True, help="The log to write.")
@click.option(
    "--apart", is_flag=True, help="Put each log's topics below its file's name: /car_1/odom of car_1.mcap."
)
def merge(logs: tuple[Path, ...], output: Path, apart: bool) -> int:
    """Write the messages of several LOGS in the order of their log times, byte for byte, as one.

    Channels that are declared alike become one, what differs stays apart; both are told.

    \b
    Example:  istc-replay merge car_1.mcap car_2.mcap -o fleet.mcap
    """
    from istc_replay.pipeline.merge import merge_logs

    with Progress(f"{len(logs)} logs") as progress:
        copied = merge_logs(logs, output, apart, progress.bytes)
    print_lines(tell.copied_lines(copied))
    return 0 if copied.complete else 3
