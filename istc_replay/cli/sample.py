"""`istc-replay sample`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE


@click.command()
@click.argument("scene")
@click.argument("out", type=FILE)
@click.option("-c", "--config", "config_path", type=FILE, help="Configuration (TOML): how to route.")
def sample(scene: str, out: Path, config_path: Path | None) -> None:
    """Write SCENE, a sample's name or a scene file (JSON), as a recorded log of uncoordinated driving.

    \b
    Example:  istc-replay sample dense_4 dense_4.mcap
    Names:    intersection_turn_first, intersection_straight_first, intersection_osi,
              intersection_odometry, dense_4, dense_6, dense_8, each of these three also with
              _obstacles and _row; the form of a scene file is schemas/scene.schema.json
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline.sample import write_sample

    write_sample(scene, out, load_config(config_path))
    click.echo(tell.line(out))
