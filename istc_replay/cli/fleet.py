"""`istc-replay fleet`: its logs, `fleet status` and `fleet report`."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, config_option, print_lines

if TYPE_CHECKING:
    from collections.abc import Callable

    from istc_replay.fleet.drive import Orders
    from istc_replay.fleet.engine import Engine
    from istc_replay.fleet.progress import Progress
    from istc_replay.fleet.telling import Summary

_INTERRUPTED = {signal.SIGINT: 130, signal.SIGTERM: 143}
#: Logs that are named at the end; the manifest and the report have them all.
_NAMED = 50


class _Group(click.Group):
    """A group whose first word may be a log: then it is the command that does logs."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = ["run", *args]
        return super().parse_args(ctx, args)

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write_usage(ctx.command_path, "LOGS... -o DIR [OPTIONS] | status DIR | report DIR")

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        self.commands["run"].format_options(ctx, formatter)
        self.format_commands(ctx, formatter)


@click.group(cls=_Group)
def fleet() -> None:
    """Replay many LOGS into one folder, resumable: a second call does what is not done and whole.

    \b
    Example:  istc-replay fleet night/ -o results --jobs 4
              istc-replay fleet status results
              istc-replay fleet report results

    LOGS are files, folders (all .mcap files below them), globs, @FILE for a list, and URLs where
    fsspec is installed. A log named status or report is reached as ./status.

    The folder gets logs/NAME/ for every log, fleet.jsonl (what became of each) and fleet.log.
    Exit codes: 0 all done; 3 some are inconclusive; 4 some failed; 130 or 143 stopped: call again.
    """


@fleet.command(hidden=True)
@click.argument("logs", nargs=-1)
@click.option("-o", "--output", type=FILE, required=True, help="Folder of the fleet.")
@config_option
@click.option("--list", "lists", type=FILE, multiple=True, help="File that lists logs, one a line.")
@click.option("--engine", type=click.Choice(["local", "dask"]), default="local", show_default=True)
@click.option("--scheduler", help="Dask scheduler, as tcp://host:8786; without it a local cluster is made.")
@click.option("--jobs", type=click.IntRange(1, 1024), help="Processes of this machine.  [default: its cores]")
@click.option(
    "--memory-mb", type=click.FloatRange(64), help="Memory of one job.  [default: its share of 80 %]"
)
@click.option(
    "--time-s", type=click.FloatRange(1), default=3600.0, show_default=True, help="Emergency stop of one job."
)
@click.option(
    "--tries", type=click.IntRange(1, 10), default=2, show_default=True, help="Tries where a worker dies."
)
@click.option("--skip", default="", help="Leave out: view, report, or both with a comma.")
@click.option(
    "--cut", type=click.IntRange(0), default=32, show_default=True, help="Most windows of a job; 0: all."
)
@click.option("--retry-failed", is_flag=True, help="Do logs again that failed.")
@click.option("--force", is_flag=True, help="Do all logs again.")
def run(
    logs: tuple[str, ...], output: Path, config_path: Path | None, lists: tuple[Path, ...], **options: Any
) -> int:
    """Do the logs."""
    from istc_replay.fleet.drive import Fleet
    from istc_replay.fleet.inputs import find_logs

    if not logs and not lists:
        raise click.UsageError("no logs are given")
    if options["scheduler"] and options["engine"] != "dask":
        raise click.UsageError("--scheduler needs --engine dask")
    found = find_logs(logs, lists, leave_out=output)
    if not found:
        raise click.UsageError(f"{output} is the folder of the outputs: nothing in it is a log")
    line = _Line()
    at_work = Fleet(output, _orders(config_path, options), line)
    caught: list[int] = []

    def stop(number: int, _frame: object) -> None:
        caught.append(number)
        at_work.stop("interrupted; what was finished is kept, call again to go on")

    for number in _INTERRUPTED:
        signal.signal(number, stop)
    with line:
        summary = at_work.run(found, _engine(options))
    print_lines(_summary_lines(summary, output))
    if summary.stopped:
        click.echo(f"istc-replay: {tell.line(summary.stopped)}", err=True)
        return _INTERRUPTED[signal.Signals(caught[0])] if caught else 2
    return summary.worst_code


def _orders(config_path: Path | None, options: dict[str, Any]) -> Orders:
    from istc_replay.config import load_config
    from istc_replay.fleet.drive import Orders
    from istc_replay.pipeline.run import RUN_OUTPUTS

    load_config(config_path)  # tells what is wrong with it, by its own name
    outputs = {output.split(".")[0]: output for output in RUN_OUTPUTS}
    skipped = [part.strip() for part in options["skip"].split(",") if part.strip()]
    for name in skipped:
        if name not in outputs:
            raise click.UsageError(f"--skip {options['skip']}: {name!r} is not one of {', '.join(outputs)}")
    return Orders(
        config_toml="" if config_path is None else config_path.read_text(encoding="utf-8"),
        products=tuple(output for name, output in outputs.items() if name not in skipped),
        tries=options["tries"],
        retry_failed=options["retry_failed"],
        force=options["force"],
        cut=options["cut"],
    )


def _engine(options: dict[str, Any]) -> Callable[[], Engine]:
    from istc_replay.fleet.cell import Limits, default_jobs, default_memory_mb
    from istc_replay.fleet.engine import LocalEngine

    jobs = options["jobs"] or default_jobs()
    limits = Limits(options["memory_mb"] or default_memory_mb(jobs), options["time_s"])
    if options["engine"] == "local":
        return lambda: LocalEngine(jobs, limits)

    def cluster() -> Engine:
        from istc_replay.fleet.dask_engine import DaskEngine

        return DaskEngine(options["scheduler"], jobs, limits, options["tries"])

    return cluster


def _summary_lines(summary: Summary, output: Path) -> list[str]:
    told = ", ".join(f"{count} {status}" for status, count in summary.counts.items() if count)
    lines = [f"{summary.total} logs: {told or 'none is done'}"]
    lines += [
        f"  {entry['event']}: {tell.line(entry['log'])}: {tell.line(entry['error'])}"
        for entry in summary.named[:_NAMED]
    ]
    if len(summary.named) > _NAMED:
        lines.append(f"  {len(summary.named) - _NAMED} more are in {tell.line(output / 'fleet.jsonl')}")
    lines.append(
        f"  results in {tell.line(output)}; istc-replay fleet report {tell.line(output)} sums them up"
    )
    return lines


class _Line:
    """The progress on a terminal's stderr, one line that is written over; logs that fail stay above it."""

    def __init__(self) -> None:
        self._shown = sys.stderr.isatty()
        self._at = 0.0

    def __enter__(self) -> _Line:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            click.echo("\r\x1b[K", nl=False, err=True)

    def __call__(self, progress: Progress, text: str) -> None:
        if not self._shown or (not text and time.monotonic() - self._at < 0.5):
            return
        self._at = time.monotonic()
        above = f"{tell.line(text)}\n" if text else ""
        click.echo(f"\r\x1b[K{above}{progress.line()}", nl=False, err=True)


@fleet.command()
@click.argument("folder", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def status(folder: Path, as_json: bool) -> int:
    """Tell how far the fleet of FOLDER is, while it runs or after.

    \b
    Example:  istc-replay fleet status results
    """
    import json

    from istc_replay.fleet.status import fleet_status, status_lines

    facts = fleet_status(folder)
    if as_json:
        click.echo(json.dumps(facts, indent=1))
    else:
        print_lines(tell.line(text) for text in status_lines(facts))
    return 0


@fleet.command()
@click.argument("folder", type=FILE)
def report(folder: Path) -> int:
    """Write FOLDER/report: a page over all logs, and one Parquet data set of all their tables.

    \b
    Example:  istc-replay fleet report results
    """
    from istc_replay.cli.common import Progress as Step
    from istc_replay.fleet.report import write_report

    with Step("report") as step:
        page = write_report(folder, lambda what: step(what, 0, 1))
    click.echo(tell.line(page))
    return 0
