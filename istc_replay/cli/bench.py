"""`istc-replay bench`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import Progress, config_option, print_lines


@click.command()
@click.option("--table", type=click.Choice(["iii", "iv"]), help="One of the paper's tables; both otherwise.")
@click.option("--scene", "scenes", multiple=True, help="A sample's name, in place of a table; repeatable.")
@click.option("--runs", default=5, show_default=True, type=click.IntRange(1, 100), help="Runs of each scene.")
@click.option("--fast", is_flag=True, help="Leave the proof of the bound out.")
@click.option("--perturb", default=0, type=click.IntRange(0, 1000), help="Replay N perturbed copies instead.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@config_option
def bench(
    table: str | None,
    scenes: tuple[str, ...],
    runs: int,
    fast: bool,
    perturb: int,
    as_json: bool,
    config_path: Path | None,
) -> int:
    """Measure the paper's tables here, beside the paper's figures and CL-CBS's.

    \b
    Example:  istc-replay bench --table iii
    """
    from dataclasses import asdict

    from istc_replay import bench as measuring
    from istc_replay.config import load_config

    config = load_config(config_path)
    if fast:
        config = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    names = scenes or tuple(
        name for key, names in measuring.TABLES.items() if table in (None, key) for name in names
    )
    others = measuring.peers()
    with Progress("bench") as progress:

        def told(what: str) -> None:
            progress(what, 0, 1)

        if perturb:
            found = [
                measuring.robustness(name, perturb, config, told)
                for name in names
                if name.startswith("dense")
            ]
            print_lines(
                [json.dumps({"perturbed": found}, indent=1)] if as_json else tell.robustness_lines(found)
            )
            return 0 if all(f["certified_and_arrived"] == f["perturbed"] for f in found) else 4
        rows = measuring.bench(names, config, runs, told)
    if as_json:
        click.echo(json.dumps({"rows": [asdict(row) for row in rows], "others": others}, indent=1))
    else:
        print_lines(tell.table_lines(measuring.table(rows, others)))
        for source in others["sources"].values():
            click.echo(f"  {tell.line(source)}")
    return 0 if all(row.certified and row.arrived for row in rows) else 4
