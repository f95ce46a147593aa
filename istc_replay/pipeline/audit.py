"""Auditing a log, and certifying a result's plans anew."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from istc_replay.datatypes import Verdict

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from istc_replay.config import Config
    from istc_replay.datatypes import Certificate


def audit_read(
    source: Path,
    config: Config,
    folder: Path | None,
    formats: Sequence[Literal["parquet", "json", "md", "junit"]],
    fail_on: Literal["minor", "serious", "critical"],
) -> tuple[str, int, list[Path]]:
    """Audit a log: what it found as Markdown, the exit code, and the files if a folder is given."""
    from istc_replay.export.audit_files import audit_exit_code, audit_markdown, write_audit
    from istc_replay.ingest.log import read_log
    from istc_replay.safety.log_audit import audit_log

    log = read_log(source, config)
    found = audit_log(log, config)
    files = [] if folder is None else write_audit(found, log, folder, formats, fail_on)
    return audit_markdown(found, log), audit_exit_code(found, log, fail_on), files


def certify_again(source: Path) -> tuple[tuple[Certificate, ...], int]:
    """Certify a result's plans from its file; exit code 1 where a check fails, 3 where one is in doubt."""
    from istc_replay.config import parse_config
    from istc_replay.ingest.result import load_result_folder
    from istc_replay.safety.certificate import certify, overall

    result = load_result_folder(source)
    certificates = certify(result, parse_config(result.config_toml))
    if not certificates:
        return (), 3
    return certificates, {Verdict.FAIL: 1, Verdict.INCONCLUSIVE: 3}.get(overall(certificates), 0)
