"""`istc-replay audit`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, chosen_formats, print_lines

_AUDIT_FORMATS: tuple[Literal["parquet", "json", "md", "junit"], ...] = ("parquet", "json", "md", "junit")
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
    "--format", "formats", default="parquet,json,md", show_default=True, help="parquet, json, md, junit."
)
@click.option("-c", "--config", "config_path", type=FILE, help="Configuration (TOML), for a log.")
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
    from istc_replay.config import load_config
    from istc_replay.ingest.result import is_result
    from istc_replay.pipeline.audit import audit_read, certify_again

    chosen = chosen_formats(formats, _AUDIT_FORMATS)
    if is_result(source):
        if output is not None or config_path is not None:
            raise click.UsageError(f"{source} is a result: certifying it anew takes no -o and no -c")
        certificates, code = certify_again(source)
        print_lines(tell.certificate_lines(certificates))
        return code
    text, code, files = audit_read(source, load_config(config_path), output, chosen, fail_on)
    print_lines(tell.line(text_line) for text_line in text.splitlines())
    print_lines(tell.line(file) for file in files)
    return code
