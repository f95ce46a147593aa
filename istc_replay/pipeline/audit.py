"""Auditing a log or a result."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from istc_replay.config import Config
    from istc_replay.datatypes import Result
    from istc_replay.export.audit import AuditFormat, Severity
    from istc_replay.safety.log_audit import Audit


def audit_path(source: Path, config: Config | None = None) -> Audit:
    """Audit a log, or a result by its folder or its file.

    Parameters
    ----------
    source : Path
        A log, a result.mcap, or the folder of one.
    config : Config, optional
        Settings; of a result by default those that it was made with, of a log the defaults.
    """
    from istc_replay.config import Config
    from istc_replay.ingest.log import read_log
    from istc_replay.ingest.result import is_result, load_result_folder
    from istc_replay.safety.log_audit import audit_log

    if is_result(source):
        return audit_loaded(load_result_folder(source), config)
    settings = config or Config()
    return audit_log(read_log(source, settings), settings)


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
) -> tuple[str, int, list[Path]]:
    """Audit a log or result: what was found as Markdown, the exit code, the files if a folder is given."""
    from istc_replay import __version__
    from istc_replay.export.audit import audit_exit_code, audit_markdown, write_audit

    found = audit_path(source, config)
    files = []
    if folder is not None:
        files = write_audit(found, folder, formats, version=__version__, fail_on=fail_on)
    return audit_markdown(found), audit_exit_code(found, fail_on), files
