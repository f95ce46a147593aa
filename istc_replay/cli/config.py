"""`istc-replay config`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from istc_replay.cli.common import FILE


@click.command()
@click.argument("file", required=False, type=FILE)
@click.option("--defaults", is_flag=True, help="Print the defaults, each explained (as without FILE).")
@click.option("--schema", is_flag=True, help="Print the JSON Schema.")
def config(file: Path | None, defaults: bool, schema: bool) -> None:
    """Check a configuration FILE, and print the configuration in force, explained.

    \b
    Example:  istc-replay config > my.toml
    """
    from istc_replay.config import Config, load_config, render_config

    if schema:
        click.echo(json.dumps(Config.model_json_schema(), indent=1))
        return
    click.echo(render_config(load_config(None if defaults else file), explain=True), nl=False)
