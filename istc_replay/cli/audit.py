"""`istc-replay audit`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, chosen_formats, print_lines

_AUDIT_FORMATS: tuple[Literal["html", "md", "json", "junit", "xqar", "parquet"], ...] = (
    *("html", "md", "json", "junit", "xqar", "parquet"),
)
_SEVERITIES: tuple[Literal["minor", "serious", "critical"], ...] = ("minor", "serious", "critical")


@click.command()
@click.argument("source", type=FILE)
@click.option("-o", "--output", type=FILE, help="Folder of the files; none are written without it.")
@click.option(
    "--fail-on",
    type=click.Choice(_SEVERITIES),
    default="serious",
    show_default=True,
    help="The least severity that counts as a finding for the exit code.",
)
@click.option(
    "--format",
    "formats",
    default="html,json,md,parquet",
    show_default=True,
    help=f"{', '.join(_AUDIT_FORMATS)}.",
)
@click.option(
    "--clips",
    type=click.IntRange(0),
    default=20,
    show_default=True,
    help="Clips of the log around serious findings, worst first, at most.",
)
@click.option("--json", "as_json", is_flag=True, help="Tell it as JSON (schemas/audit.schema.json).")
@click.option("-c", "--config", "config_path", type=FILE, help="Configuration (TOML); of a result, its own.")
def audit(
    source: Path,
    output: Path | None,
    fail_on: Literal["minor", "serious", "critical"],
    formats: str,
    clips: int,
    as_json: bool,
    config_path: Path | None,
) -> int:
    """Audit what SOURCE, a log or a result, recorded; of a result, its plans as well.

    \b
    Example:  istc-replay audit sample_logs/intersection_turn_first.mcap -o audit --fail-on serious
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline.audit import audit_read

    chosen = chosen_formats(formats, _AUDIT_FORMATS)
    config = None if config_path is None else load_config(config_path)
    with Progress(source.name) as progress:
        text, code, files = audit_read(
            source, config, output, chosen, fail_on, clips, as_json=as_json, reading=progress.bytes
        )
    if as_json:
        click.echo(text)
        return code
    print_lines(tell.line(text_line) for text_line in text.splitlines())
    print_lines(tell.line(file) for file in files)
    return code
