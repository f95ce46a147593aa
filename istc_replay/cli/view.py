"""`istc-replay view`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from istc_replay import tell
from istc_replay.cli.common import FILE

if TYPE_CHECKING:
    from istc_replay.pipeline.view import View


@click.command()
@click.argument("result", type=FILE)
@click.option("--web", is_flag=True, help="Show it in the browser, from 127.0.0.1, until Ctrl-C.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of --web; a free one otherwise.")
@click.option("--save", type=FILE, help="Write the view to this .rrd file.")
@click.option("--bundle", type=FILE, help="Write a folder that any static web server shows, offline.")
@click.option("--connect", metavar="URL", help="Show it in the Rerun viewer that runs there.")
@click.option("--at", metavar="TIME", help="Open at seconds from the first window, or a date and time.")
@click.option("--finding", metavar="ID", help="Open where this finding is worst, close to its vehicles.")
@click.option("--focus", metavar="ID", multiple=True, help="Show this vehicle in full; again for more.")
def view(
    result: Path,
    web: bool,
    port: int,
    save: Path | None,
    bundle: Path | None,
    connect: str | None,
    at: str | None,
    finding: str | None,
    focus: tuple[str, ...],
) -> None:
    """Look at RESULT (a result's folder or result.mcap) in Rerun.

    \b
    Example:  istc-replay view results/intersection_turn_first --at 4.2
    """
    if sum([web, save is not None, bundle is not None, connect is not None]) > 1:
        raise click.UsageError("give one of --web, --save, --bundle and --connect")
    if save is not None and (at is not None or finding is not None):
        raise click.UsageError("--save: an .rrd file does not say where it opens; use --bundle or --web")
    from istc_replay.pipeline.view import open_view

    opened = open_view(result, at=at, finding=finding, focus=focus)
    if save is not None:
        opened.save(save)
        click.echo(tell.line(save))
    elif bundle is not None:
        opened.bundle(bundle)
        click.echo(f"{tell.line(bundle)}: python -m http.server --bind 127.0.0.1 -d {tell.line(bundle)}")
    elif web:
        _serve(opened, port)
    else:
        opened.show(connect)


def _serve(opened: View, port: int) -> None:
    from istc_replay.export.rerun.viewer import has_screen

    with opened.served(port) as server:
        url = f"http://127.0.0.1:{server.server_port}/"
        click.echo(f"{url}  (Ctrl-C ends it)")
        if has_screen():
            click.launch(url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            click.echo("", err=True)
