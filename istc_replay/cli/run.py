"""`istc-replay run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, config_option, print_lines
from istc_replay.errors import ExportError, IstcReplayError

if TYPE_CHECKING:
    from istc_replay.pipeline.live import LiveView


@click.command()
@click.argument("logs", nargs=-1, required=True, type=FILE)
@config_option
@click.option(
    "-o", "--output", type=FILE, default=Path("results"), show_default=True, help="Folder of the results."
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    help="Windows planned at once; one where windows are handed over.",
)
@click.option("--road", type=FILE, help="Lanes and road edges beside the log (GeoJSON, docs/formats.md).")
@click.option("--view", is_flag=True, help="Watch the windows in Rerun while they are solved.")
@click.option("--connect", metavar="URL", help="Watch them in the Rerun viewer that runs there.")
def run(
    logs: tuple[Path, ...],
    config_path: Path | None,
    output: Path,
    jobs: int,
    road: Path | None,
    view: bool,
    connect: str | None,
) -> int:
    """Replay LOGS: per log result.mcap, view.rrd, report.html and summary.json.

    \b
    Example:  istc-replay run sample_logs/intersection_turn_first.mcap -o results

    A long log is planned window by window; a run that was stopped goes on where it was.
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline.run import result_folders, run_log

    config = load_config(config_path)
    if road is not None:
        ingest = config.ingest.model_copy(update={"road_file": str(road)})
        config = config.model_copy(update={"ingest": ingest})
    folders = result_folders(logs, output)
    live = _live_view(connect) if view or connect else None
    worst = 0
    for path, folder in folders.items():
        with Progress(path.name) as progress:
            try:
                done = run_log(path, folder, config, progress, jobs, live, reading=progress.bytes)
            except IstcReplayError as error:
                # Of many logs, one that fails does not stop the others.
                if len(folders) == 1:
                    raise
                click.echo(f"istc-replay: {tell.line(error)}", err=True)
                worst = max(worst, error.exit_code)
                continue
        print_lines(tell.run_lines(done.summary, folder))
        worst = max(worst, done.exit_code)
    if live is not None and live.lost:
        click.echo(f"istc-replay: the view was lost: {tell.line(live.lost)}", err=True)
    return worst


def _live_view(connect: str | None) -> LiveView | None:
    """A viewer to watch in; without a screen the run goes on unwatched, and says so."""
    from istc_replay.export.rerun.viewer import start_viewer
    from istc_replay.pipeline.live import LiveView

    try:
        return LiveView(connect or start_viewer())
    except ExportError as error:
        click.echo(f"istc-replay: not watched: {tell.line(error)}", err=True)
        return None
