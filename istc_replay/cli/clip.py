"""`istc-replay clip`."""

from __future__ import annotations

from pathlib import Path

import click

from istc_replay import tell
from istc_replay.cli.common import FILE, Progress, config_option, print_lines


@click.command()
@click.argument("log", type=FILE)
@click.argument("out", type=FILE)
@click.option("--from", "start", help="Where the span starts; the log's start without it.")
@click.option("--to", "end", help="Where it ends, not included; the log's end without it.")
@click.option("--around", "moment", help="A moment; the span is --margin before and after it.")
@click.option("--finding", "finding_id", help="The id of an audit's finding; the span is around it.")
@click.option("--audit", type=FILE, help="What `audit -o` wrote, or a result; LOG is audited without it.")
@click.option(
    "--margin", "margin_s", type=click.FloatRange(0, 1e9), default=5.0, show_default=True, help="[s]"
)
@config_option
def clip(
    log: Path,
    out: Path,
    start: str | None,
    end: str | None,
    moment: str | None,
    finding_id: str | None,
    audit: Path | None,
    margin_s: float,
    config_path: Path | None,
) -> int:
    """Write what LOG holds of a span of log time to OUT, byte for byte.

    A moment is seconds from the log's start (12.5), nanoseconds (1700000000000000000ns) or a date and
    time (2026-05-01T10:00:00Z). Static transforms, scenes and what publishers keep stay from before the
    span too, and so do all attachments and metadata.

    \b
    Example:  istc-replay clip sample_logs/intersection_osi.mcap clip.mcap --from 2 --to 6.5
              istc-replay clip log.mcap close.mcap --finding 6f1c2a3b --audit audit
    """
    from istc_replay.config import load_config
    from istc_replay.pipeline.clip import Around, Between, clip_log

    ways = ((start or end) is not None, moment is not None, finding_id is not None)
    if sum(ways) != 1:
        raise click.UsageError("give one of --from and --to, --around, or --finding")
    if audit is not None and finding_id is None:
        raise click.UsageError("--audit goes with --finding")
    span = Between(start, end) if ways[0] else Around(margin_s, moment, finding_id, audit)
    with Progress(log.name) as progress:
        copied = clip_log(log, out, span, load_config(config_path), progress.bytes)
    print_lines(tell.copied_lines(copied))
    return 0 if copied.complete else 3
