"""`istc-replay compare`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, print_lines


@click.command()
@click.argument("result_a", type=FILE)
@click.argument("result_b", type=FILE)
@click.option(
    "-o", "--output", type=FILE, help="Folder of page, view and figures; none are written without it."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def compare(result_a: Path, result_b: Path, output: Path | None, as_json: bool) -> None:
    """Compare RESULT_A with RESULT_B (folders or result.mcap): what moved, who waits for whom, by how much.

    Only what differs is told. With -o, DIR gets compare.html, compare.rrd and compare.json.

    \b
    Example:  istc-replay compare results/intersection_turn_first results/intersection_straight_first
    """
    from istc_replay.comparison.words import sentences
    from istc_replay.pipeline.compare import compare_read, comparison_facts

    comparison, files = compare_read(result_a, result_b, output)
    if as_json:
        click.echo(json.dumps(comparison_facts(comparison, result_a, result_b), indent=1, allow_nan=False))
        return
    print_lines(tell.line(text) for text in sentences(comparison))
    print_lines(tell.line(file) for file in files)
