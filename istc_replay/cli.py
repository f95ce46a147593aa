"""The command line: the only place that prints.

Results go to stdout, everything else to stderr. Heavy modules are imported by the command that
needs them, so that help is instant.
"""

from __future__ import annotations

import json
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import click

from istc_replay import __version__, tell
from istc_replay.errors import IstcReplayError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_INTERNAL_ERROR = 4
_INTERRUPTED = 130
_TABLE_FORMATS: tuple[Literal["parquet", "csv"], ...] = ("parquet", "csv")
_FIGURE_FORMATS: tuple[Literal["png", "svg", "pdf"], ...] = ("png", "svg", "pdf")
_AUDIT_FORMATS: tuple[Literal["parquet", "json", "md", "junit"], ...] = ("parquet", "json", "md", "junit")
_SEVERITIES: tuple[Literal["minor", "serious", "critical"], ...] = ("minor", "serious", "critical")
_FILE = click.Path(path_type=Path)
_Format = TypeVar("_Format", bound=str)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code: an error is one line on stderr."""
    given = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in given
    try:
        code = cli.main(
            args=[a for a in given if a != "--debug"], standalone_mode=False, prog_name="istc-replay"
        )
        sys.exit(code if isinstance(code, int) else 0)
    except click.exceptions.Abort:
        _fail("interrupted; what was finished is kept", _INTERRUPTED)
    except KeyboardInterrupt:
        _fail("interrupted; what was finished is kept", _INTERRUPTED)
    except click.ClickException as error:
        _fail(error.format_message(), 2)
    except IstcReplayError as error:
        if debug:
            traceback.print_exc()
        _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # The reader of stdout has gone, as with `| head`: nothing is left to tell it.
        sys.stderr.close()
        sys.exit(0)
    except MemoryError:
        _fail("out of memory; cut the log into shorter spans", _INTERNAL_ERROR)
    except Exception as error:
        if debug:
            traceback.print_exc()
        _fail(f"internal error: {type(error).__name__}: {error}; --debug shows where", _INTERNAL_ERROR)


def _fail(message: str, code: int) -> None:
    click.echo(f"istc-replay: {tell.line(message)}", err=True)
    sys.exit(code)


def _print(lines: Iterable[str]) -> None:
    for text in lines:
        click.echo(text)


def _chosen(formats: str, known: Sequence[_Format]) -> list[_Format]:
    """Read a list with commas."""
    parts = [part.strip() for part in formats.split(",")]
    unknown = [part for part in parts if part not in known]
    if unknown:
        raise click.UsageError(f"--format {formats}: {unknown[0]!r} is not one of {', '.join(known)}")
    return [name for name in known if name in parts]


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="istc-replay")
def cli() -> None:
    """Replay recorded multi-vehicle MCAP logs: what happened, how close it was, and what a coordinated
    plan would have done.

    Every command takes --debug to show the traceback of an error.
    """


@cli.command()
@click.argument("logs", nargs=-1, required=True, type=_FILE)
@click.option("-c", "--config", "config_path", type=_FILE, help="Configuration (TOML).")
@click.option(
    "-o", "--output", type=_FILE, default=Path("results"), show_default=True, help="Folder of the results."
)
@click.option("--view", is_flag=True, help="Open the view when done.")
def run(logs: tuple[Path, ...], config_path: Path | None, output: Path, view: bool) -> int:
    """Replay LOGS: per log result.mcap, view.rrd, report.html and summary.json.

    \b
    Example:  istc-replay run sample_logs/intersection_turn_first.mcap -o results
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline import result_folders, run_log

    config = load_config(config_path)
    folders = result_folders(logs, output)
    worst = 0
    for path, folder in folders.items():
        with _Progress(path.name) as progress:
            try:
                done = run_log(path, folder, config, progress)
            except IstcReplayError as error:
                # Of many logs, one that fails does not stop the others.
                if len(folders) == 1:
                    raise
                click.echo(f"istc-replay: {tell.line(error)}", err=True)
                worst = max(worst, error.exit_code)
                continue
        _print(tell.run_lines(done.summary, folder))
        worst = max(worst, done.exit_code)
    if view:
        for folder in folders.values():
            _show(folder)
    return worst


class _Progress:
    """One line on a terminal's stderr that tells what is being done; silent elsewhere."""

    def __init__(self, name: str) -> None:
        self._name = tell.line(name)
        self._shown = sys.stderr.isatty()

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            click.echo("\r\x1b[K", nl=False, err=True)

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._shown:
            share = f" window {min(done + 1, total)} of {total}:" if total > 1 else ""
            click.echo(f"\r\x1b[K{self._name}:{share} {what}", nl=False, err=True)


@cli.command()
@click.argument("log", type=_FILE)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-c", "--config", "config_path", type=_FILE, help="Configuration (TOML).")
def info(log: Path, as_json: bool, config_path: Path | None) -> int:
    """Tell what LOG holds: channels and how they are read, vehicles, spans, rates, problems.

    \b
    Example:  istc-replay info sample_logs/intersection_osi.mcap
    """
    from istc_replay.config import load_config
    from istc_replay.ingest.log import read_log

    read = read_log(log, load_config(config_path))
    facts = tell.log_facts(read)
    if as_json:
        click.echo(json.dumps(facts, indent=1))
    else:
        _print(tell.info_lines(facts))
    return 0 if read.complete else 3


@cli.command()
@click.argument("source", type=_FILE)
@click.option("-o", "--output", type=_FILE, help="Folder of the files; none are written without it.")
@click.option(
    "--fail-on",
    type=click.Choice(_SEVERITIES),
    default="serious",
    show_default=True,
    help="The least severity that counts as a finding for the exit code.",
)
@click.option(
    "--format", "formats", default="parquet,json,md", show_default=True, help="parquet, json, md, junit."
)
@click.option("-c", "--config", "config_path", type=_FILE, help="Configuration (TOML), for a log.")
def audit(
    source: Path,
    output: Path | None,
    fail_on: Literal["minor", "serious", "critical"],
    formats: str,
    config_path: Path | None,
) -> int:
    """Audit the recorded behaviour in SOURCE, a log; of a result, certify its plans anew.

    \b
    Example:  istc-replay audit sample_logs/intersection_turn_first.mcap -o audit --fail-on serious
    """
    from istc_replay import pipeline
    from istc_replay.config import load_config

    chosen = _chosen(formats, _AUDIT_FORMATS)
    if pipeline.is_result(source):
        if output is not None or config_path is not None:
            raise click.UsageError(f"{source} is a result: certifying it anew takes no -o and no -c")
        certificates, code = pipeline.certify_again(source)
        _print(tell.certificate_lines(certificates))
        return code
    text, code, files = pipeline.audit_read(source, load_config(config_path), output, chosen, fail_on)
    _print(tell.line(text_line) for text_line in text.splitlines())
    _print(tell.line(file) for file in files)
    return code


@cli.command()
@click.argument("source", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, help="Folder of the tables.")
@click.option(
    "--format", "formats", default="parquet", show_default=True, help="parquet, csv, or both with a comma."
)
@click.option("-c", "--config", "config_path", type=_FILE, help="Configuration (TOML), for a log.")
def export(source: Path, output: Path, formats: str, config_path: Path | None) -> int:
    """Write the tables of SOURCE, a log or a result (its folder or result.mcap).

    \b
    Example:  istc-replay export results/intersection_turn_first -o tables --format parquet,csv
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline import export_tables

    chosen = _chosen(formats, _TABLE_FORMATS)
    complete, files = export_tables(source, output, chosen, load_config(config_path))
    for file in files:
        click.echo(tell.line(file))
    return 0 if complete else 3


@cli.command()
@click.argument("scene")
@click.argument("out", type=_FILE)
@click.option("-c", "--config", "config_path", type=_FILE, help="Configuration (TOML): how to route.")
def sample(scene: str, out: Path, config_path: Path | None) -> None:
    """Write SCENE, a sample's name or a scene file (JSON), as a recorded log of uncoordinated driving.

    \b
    Example:  istc-replay sample dense_4 dense_4.mcap
    Names:    intersection_turn_first, intersection_straight_first, intersection_osi,
              intersection_odometry, dense_4, dense_6, dense_8, each of these three also with
              _obstacles and _row; the form of a scene file is schemas/scene.schema.json
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline import write_sample

    write_sample(scene, out, load_config(config_path))
    click.echo(tell.line(out))


@cli.command()
@click.argument("file", required=False, type=_FILE)
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


@cli.command()
@click.argument("result", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, help="Folder of the pictures.")
@click.option("--format", "formats", default="png", show_default=True, help="png, svg, pdf, with commas.")
def figures(result: Path, output: Path, formats: str) -> None:
    """Draw RESULT (its folder or result.mcap) as the paper draws its results, window by window.

    \b
    Example:  istc-replay figures results/intersection_turn_first -o pictures --format svg,pdf
    """
    from istc_replay.pipeline import write_figures

    for file in write_figures(result, output, _chosen(formats, _FIGURE_FORMATS)):
        click.echo(tell.line(file))


@cli.command()
@click.option("--table", type=click.Choice(["iii", "iv"]), help="One of the paper's tables; both otherwise.")
@click.option("--scene", "scenes", multiple=True, help="A sample's name, in place of a table; repeatable.")
@click.option("--runs", default=5, show_default=True, type=click.IntRange(1, 100), help="Runs of each scene.")
@click.option("--fast", is_flag=True, help="Leave the proof of the bound out.")
@click.option("--perturb", default=0, type=click.IntRange(0, 1000), help="Replay N perturbed copies instead.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-c", "--config", "config_path", type=_FILE, help="Configuration (TOML).")
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
    with _Progress("bench") as progress:

        def told(what: str) -> None:
            progress(what, 0, 1)

        if perturb:
            found = [
                measuring.robustness(name, perturb, config, told)
                for name in names
                if name.startswith("dense")
            ]
            _print([json.dumps({"perturbed": found}, indent=1)] if as_json else tell.robustness_lines(found))
            return 0 if all(f["certified_and_arrived"] == f["perturbed"] for f in found) else 4
        rows = measuring.bench(names, config, runs, told)
    if as_json:
        click.echo(json.dumps({"rows": [asdict(row) for row in rows], "others": others}, indent=1))
    else:
        _print(tell.table_lines(measuring.table(rows, others)))
        for source in others["sources"].values():
            click.echo(f"  {tell.line(source)}")
    return 0 if all(row.certified and row.arrived for row in rows) else 4


@cli.command()
@click.argument("result", type=_FILE)
@click.option("--save", type=_FILE, help="Write the view to this .rrd instead of opening it.")
def view(result: Path, save: Path | None) -> None:
    """Open RESULT (a result's folder or result.mcap) in Rerun.

    \b
    Example:  istc-replay view results/intersection_turn_first
    """
    if save is None:
        _show(result)
        return
    from istc_replay.export.rerun_view import save_view

    save_view(result, save)
    click.echo(tell.line(save))


def _show(result: Path) -> None:
    from istc_replay.export.rerun_view import show_view

    show_view(result)
