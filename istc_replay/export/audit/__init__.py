"""The audit as files: Parquet tables, JSON, HTML, Markdown, JUnit XML and XQAR."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file, prepare_folder
from istc_replay.export.audit.junit import audit_junit
from istc_replay.export.audit.markdown import audit_markdown
from istc_replay.export.audit.page import audit_html
from istc_replay.export.audit.record import (
    Severity,
    audit_exit_code,
    audit_schema,
    audit_summary,
    audit_tables,
    json_bytes,
)
from istc_replay.export.audit.xqar import audit_xqar
from istc_replay.export.tables import write_tables
from istc_replay.safety.log_audit import Audit

__all__ = [
    "FORMATS",
    "AuditFormat",
    "Severity",
    "audit_exit_code",
    "audit_html",
    "audit_junit",
    "audit_markdown",
    "audit_schema",
    "audit_summary",
    "audit_tables",
    "audit_xqar",
    "write_audit",
]

AuditFormat = Literal["html", "md", "json", "junit", "xqar", "parquet"]
FORMATS: tuple[AuditFormat, ...] = ("html", "md", "json", "junit", "xqar", "parquet")


def write_audit(
    audit: Audit,
    folder: Path,
    formats: Sequence[AuditFormat],
    *,
    version: str,
    fail_on: Severity = "serious",
    clips: Mapping[str, Path] | None = None,
) -> list[Path]:
    """Write an audit: audit.html, audit.md, audit.json, audit.junit.xml, audit.xqar, tables as Parquet.

    Parameters
    ----------
    audit : Audit
        The audit.
    folder : Path
        Made where it is missing.
    formats : sequence of {"html", "md", "json", "junit", "xqar", "parquet"}
        What to write.
    version : str
        That of the program, told in audit.xqar.
    fail_on : {"minor", "serious", "critical"}
        The least severity that fails a JUnit test case.
    clips : mapping of str to Path, optional
        Clips of the log that the report leads to, by the id of an encounter or finding.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ExportError
        If a format is not one of these, or a file cannot be written.
    """
    writers: Mapping[str, tuple[str, Callable[[], bytes]]] = {
        "html": ("audit.html", lambda: audit_html(audit, clips).encode()),
        "md": ("audit.md", lambda: audit_markdown(audit).encode()),
        "json": ("audit.json", lambda: json_bytes(audit_summary(audit))),
        "junit": ("audit.junit.xml", lambda: audit_junit(audit, fail_on)),
        "xqar": ("audit.xqar", lambda: audit_xqar(audit, version)),
    }
    for format_ in formats:
        if format_ not in FORMATS:
            raise ExportError(f"no format of an audit is named {format_!r}; there are {', '.join(FORMATS)}")
    prepare_folder(folder)
    written = []
    for format_ in formats:
        if format_ == "parquet":
            written += write_tables(audit_tables(audit), folder, ["parquet"])
            continue
        name, content = writers[format_]
        with atomic_file(folder / name) as temporary:
            temporary.write_bytes(content())
        written.append(folder / name)
    return written
