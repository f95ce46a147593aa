"""Auditing a log or a result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from istc_replay.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.config import Config
    from istc_replay.datatypes import Result
    from istc_replay.export.audit import AuditFormat, Severity
    from istc_replay.pipeline.reading import Reading
    from istc_replay.safety.log_audit import Audit

#: What a clip has on either side of its encounter or finding.
_CLIP_NS = 3 * NS_PER_S


def audit_path(
    source: Path, config: Config | None = None, reading: Callable[[int, int], None] | None = None
) -> Audit:
    """Audit a log, or a result by its folder or its file.

    Parameters
    ----------
    source : Path
        A log, a result.mcap, or the folder of one.
    config : Config, optional
        Settings; of a result by default those that it was made with, of a log the defaults.
    reading : callable, optional
        Told the bytes of a log that are read, and their number.
    """
    from istc_replay.config import Config
    from istc_replay.ingest.log import read_log
    from istc_replay.ingest.result import is_result
    from istc_replay.pipeline.reading import read_in_parts
    from istc_replay.safety.log_audit import audit_log

    if is_result(source):
        return audit_reading(read_in_parts(source), config)
    settings = config or Config()
    return audit_log(read_log(source, settings, reading), settings)


def audit_reading(found: Reading, config: Config | None = None) -> Audit:
    """Audit a result that is read, part by part where it is long."""
    from istc_replay.config import parse_config
    from istc_replay.safety.result_audit import audit_result

    settings = config or parse_config(found.result.config_toml)
    return audit_result(found.result, settings, found.recorded(), found.plans())


def audit_loaded(result: Result, config: Config | None = None) -> Audit:
    """Audit a result that has been loaded."""
    from istc_replay.config import parse_config
    from istc_replay.safety.result_audit import audit_result

    return audit_result(result, config or parse_config(result.config_toml))


def audit_read(
    source: Path,
    config: Config | None,
    folder: Path | None,
    formats: Sequence[AuditFormat],
    fail_on: Severity,
    clips: int = 0,
    *,
    as_json: bool = False,
    reading: Callable[[int, int], None] | None = None,
) -> tuple[str, int, list[Path]]:
    """Audit a log or result: what was found as Markdown or JSON, the exit code, the files if there are any.

    Parameters
    ----------
    source : Path
        A log, a result.mcap or its folder.
    config : Config, optional
        Settings; those of the result, or the defaults, otherwise.
    folder : Path, optional
        Where files go; none are written otherwise.
    formats : sequence of AuditFormat
        Which files.
    fail_on : Severity
        From which severity on the exit code is 1.
    clips : int
        So many serious encounters and findings of single vehicles, worst first, get a clip of the
        log, which the report leads to.
    as_json : bool
        Whether to tell it as JSON.
    reading : callable, optional
        Told the bytes of the log that are read, and their number.
    """
    from istc_replay import __version__
    from istc_replay.export.audit import audit_exit_code, audit_markdown, audit_summary, write_audit
    from istc_replay.export.audit.record import json_bytes

    found = audit_path(source, config, reading)
    files: list[Path] = []
    if folder is not None:
        file = source / "result.mcap" if source.is_dir() else source
        cut = write_clips(found, file, folder, clips)
        files = write_audit(found, folder, formats, version=__version__, fail_on=fail_on, clips=cut)
        files += [folder / path for path in cut.values()]
    text = json_bytes(audit_summary(found)).decode() if as_json else audit_markdown(found)
    return text, audit_exit_code(found, fail_on), files


def write_clips(audit: Audit, source: Path, folder: Path, most: int) -> dict[str, Path]:
    """Cut the log about serious encounters and findings, with 3 s to either side.

    Parameters
    ----------
    audit : Audit
        The audit of the log.
    source : Path
        Its file.
    folder : Path
        The clips go to its folder `clips`, each named after its encounter or finding.
    most : int
        The worst come first, and no more than these.

    Returns
    -------
    dict of str to Path
        Paths relative to the folder, by the id of the encounter, or of the finding of one vehicle.
    """
    from istc_replay.export.atomic import prepare_folder
    from istc_replay.pipeline.clip import Between, clip_log

    spans = clip_spans(audit, most)
    if spans:
        prepare_folder(folder / "clips")
    written = {}
    for name, (start_ns, end_ns) in spans.items():
        written[name] = Path("clips") / f"{name}.mcap"
        clip_log(source, folder / written[name], Between(f"{start_ns}ns", f"{end_ns}ns"), audit.config)
    return written


def clip_spans(audit: Audit, most: int) -> dict[str, tuple[int, int]]:
    """Spans of log time about serious encounters and findings, worst first, the ends not included."""
    import polars as pl

    from istc_replay.safety.rules import worst_first

    severe = worst_first(audit.findings.filter(pl.col("severity").is_in(["serious", "critical"])))
    encounters = {row["encounter_id"]: row for row in audit.encounters.iter_rows(named=True)}
    spans: dict[str, tuple[int, int]] = {}
    for row in severe.iter_rows(named=True):
        name = row["encounter_id"] or row["finding_id"]
        if name in spans or len(spans) >= most:
            continue
        whole = encounters.get(row["encounter_id"], row)
        states = audit.log.states.filter(
            pl.col("vehicle_id").is_in(row["vehicles"]),
            pl.col("time_ns").is_between(whole["start_ns"], whole["end_ns"]),
        )
        # The clock of the states may be another one than that of the log.
        low, high = states["log_time_ns"].min(), states["log_time_ns"].max()
        if isinstance(low, int) and isinstance(high, int):
            spans[name] = (low - _CLIP_NS, high + _CLIP_NS + 1)
    return spans
