"""`istc-replay bench`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from istc_replay import tell
from istc_replay.cli.common import Progress, config_option, print_lines

if TYPE_CHECKING:
    from istc_replay.config import Config


@click.command()
@click.option("--table", type=click.Choice(["iii", "iv"]), help="One of the paper's tables; both otherwise.")
@click.option("--scene", "scenes", multiple=True, help="A sample's name, in place of a table; repeatable.")
@click.option("--scaling", is_flag=True, help="The dense crossings by their number of vehicles instead.")
@click.option("--runs", default=5, show_default=True, type=click.IntRange(1, 100), help="Runs of each scene.")
@click.option("--fast", is_flag=True, help="Leave the proof of the bound out.")
@click.option("--perturb", default=0, type=click.IntRange(0, 1000), help="Replay N perturbed copies instead.")
@click.option(
    "--steps",
    multiple=True,
    help="Plan in steps too, HORIZON/STRIDE in seconds such as 8/4; repeatable.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Write bench.json and pictures to this folder."
)
@click.option(
    "--format",
    "kind",
    default="png",
    show_default=True,
    type=click.Choice(["png", "svg", "pdf"]),
    help="Format of the pictures.",
)
@config_option
def bench(
    table: str | None,
    scenes: tuple[str, ...],
    scaling: bool,
    runs: int,
    fast: bool,
    perturb: int,
    steps: tuple[str, ...],
    as_json: bool,
    output: Path | None,
    kind: str,
    config_path: Path | None,
) -> int:
    """Measure the paper's tables here, beside the paper's figures and CL-CBS's.

    \b
    Example:  istc-replay bench --table iii
    """
    from istc_replay import bench as measuring
    from istc_replay.config import load_config

    config = load_config(config_path)
    if fast:
        config = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    if scaling:
        names = measuring.scaling_names()
    else:
        names = scenes or tuple(
            name for key, names in measuring.TABLES.items() if table in (None, key) for name in names
        )
    if perturb:
        return _perturbed(names, perturb, config, as_json)
    if steps:
        return _in_steps(names, [_step(text) for text in steps], config, as_json)
    return _measured(names, runs, config, as_json, output, kind, scaling)


def _perturbed(names: tuple[str, ...], count: int, config: Config, as_json: bool) -> int:
    from istc_replay import bench as measuring

    with Progress("bench") as progress:
        found = [
            measuring.robustness(name, count, config, lambda what: progress(what, 0, 1))
            for name in names
            if name.startswith("dense")
        ]
    print_lines([json.dumps({"perturbed": found}, indent=1)] if as_json else tell.robustness_lines(found))
    return 0 if all(f["certified_and_arrived"] == f["perturbed"] for f in found) else 4


def _step(text: str) -> tuple[float, float]:
    """Horizon and stride [s]."""
    horizon, _, stride = text.partition("/")
    try:
        step = float(horizon), float(stride)
    except ValueError:
        step = 0.0, 0.0
    if not 0.0 < step[1] <= step[0] < 1e4:
        raise click.BadParameter(
            f"'{text}' is no HORIZON/STRIDE in seconds, such as 8/4, the stride no longer than the horizon",
            param_hint="'--steps'",
        )
    return step


def _in_steps(names: tuple[str, ...], steps: list[tuple[float, float]], config: Config, as_json: bool) -> int:
    from dataclasses import asdict

    from istc_replay.bench_steps import bench_steps, table

    with Progress("bench") as progress:
        rows = bench_steps(names, steps, config, lambda what: progress(what, 0, 1))
    if as_json:
        click.echo(json.dumps({"steps": [asdict(row) for row in rows]}, indent=1))
    else:
        print_lines(tell.table_lines(table(rows)))
        for row in rows:
            print_lines(f"  {row.name}, window {reason}" for reason in row.reasons)
    return 0 if all(row.sound == row.windows and row.arrived == row.vehicles for row in rows) else 4


def _measured(
    names: tuple[str, ...],
    runs: int,
    config: Config,
    as_json: bool,
    output: Path | None,
    kind: str,
    scaling: bool,
) -> int:
    from dataclasses import asdict

    from istc_replay import bench as measuring

    others = measuring.peers()
    with Progress("bench") as progress:
        rows, results = measuring.bench(names, config, runs, lambda what: progress(what, 0, 1))
    plain = [asdict(row) for row in rows]
    if output is not None:
        from istc_replay.export.bench_files import write_bench

        written = write_bench(output, plain, others, results, kind, scaling=scaling)  # type: ignore[arg-type]
    if as_json:
        click.echo(json.dumps({"rows": plain, "others": others}, indent=1))
    else:
        print_lines(tell.table_lines(measuring.table(rows, others)))
        for source in others["sources"].values():
            click.echo(f"  {tell.line(source)}")
        if output is not None:
            click.echo(f"  {len(written)} files in {output}")
    return 0 if all(row.certified and row.arrived for row in rows) else 4
