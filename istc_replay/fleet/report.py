"""The report of a fleet: one Parquet data set over all logs, and a page."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from istc_replay.export.atomic import atomic_file, refused
from istc_replay.export.fleet_page import FleetFigures, fleet_page
from istc_replay.fleet.distributions import distributions
from istc_replay.fleet.figures import (
    LOGS_SCHEMA,
    PROBLEMS_SCHEMA,
    WINDOWS_SCHEMA,
    entry_row,
    problem_rows,
    read_summary,
    summary_row,
    window_rows,
)
from istc_replay.fleet.manifest import Books, read_manifest
from istc_replay.fleet.outputs import logs_folder, replace_folder
from istc_replay.fleet.progress import duration

FOLDER = "report"
#: Logs whose tables go into one file of the data set.
_BATCH = 500
#: Encounters that the page lists; the data set has them all.
_ENCOUNTERS = 2000
_SEVERITIES = ("minor", "serious", "critical")


def write_report(folder: Path, told: Callable[[str], None] = lambda _: None) -> Path:
    """Write `report/` of a fleet's folder: `tables/*/*.parquet` and `index.html`.

    It may be written while the fleet runs: then it is that of the logs that have ended.

    Parameters
    ----------
    folder : Path
        The fleet's.
    told : callable
        Told what is being done.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    LogError
        If there is no manifest.
    ExportError
        If it cannot be written; a report from before stays as it was.
    """
    books = read_manifest(folder)
    try:
        with tempfile.TemporaryDirectory(prefix=".istc-report-", dir=folder) as temporary:
            work = Path(temporary) / FOLDER
            tables = work / "tables"
            tables.mkdir(parents=True)
            told("tables")
            names = sorted(e["folder"] for e in books.ends.values() if e["event"] != "failed")
            _join_tables(logs_folder(folder), names, tables)
            told("figures")
            _write_figures(folder, books, tables)
            told("page")
            with atomic_file(work / "index.html") as file:
                file.write_text(fleet_page(_figures(folder, books, tables)), encoding="utf-8")
            replace_folder(work, folder / FOLDER)
    except (OSError, pl.exceptions.PolarsError) as error:
        cause = error if isinstance(error, OSError) else OSError(str(error))
        raise refused(folder / FOLDER, cause) from None
    return folder / FOLDER / "index.html"


# --- the data set ----------------------------------------------------------------------------


def _join_tables(logs: Path, names: Sequence[str], tables: Path) -> None:
    """Join each table of all logs, batch by batch, with the log's name as first column."""
    kinds: dict[str, list[str]] = {}
    for name in names:
        for file in sorted((logs / name / "tables").glob("*.parquet")):
            kinds.setdefault(file.stem, []).append(str(file))
    for kind, files in sorted(kinds.items()):
        (tables / kind).mkdir()
        for number, first in enumerate(range(0, len(files), _BATCH)):
            joined = pl.scan_parquet(
                files[first : first + _BATCH],
                glob=False,
                include_file_paths="log",
                missing_columns="insert",
                extra_columns="ignore",
            )
            inner = pl.col("log").str.extract(r"([^/\\]+)[/\\]tables[/\\][^/\\]+$")
            rest = pl.all().exclude("log")
            joined.select(inner, rest).sink_parquet(tables / kind / f"part-{number:05d}.parquet")


def _write_figures(folder: Path, books: Books, tables: Path) -> None:
    """Write the tables `logs`, `windows` and `problems`."""
    logs: list[dict[str, Any]] = []
    windows: list[dict[str, Any]] = []
    problems: list[dict[str, Any]] = []
    for location, name in sorted(books.names.items(), key=lambda pair: pair[1]):
        entry = books.ends.get(location)
        if entry is None or location in books.queued:
            logs.append({"log": name, "location": location, "outcome": "waiting", "error": ""})
            continue
        row = entry_row(entry)
        place = logs_folder(folder) / name
        if entry["event"] == "failed":
            problems.append({"log": name, "code": "failed", "detail": row["error"]})
        summary = None if entry["event"] == "failed" else read_summary(place)
        if summary is not None:
            row |= summary_row(summary, place)
            windows += window_rows(summary, name)
            problems += problem_rows(summary, name)
        logs.append(row)
    table = _with_least(pl.DataFrame(logs, schema=LOGS_SCHEMA), tables)
    for name, frame in (
        ("logs", table),
        ("windows", pl.DataFrame(windows, schema=WINDOWS_SCHEMA)),
        ("problems", pl.DataFrame(problems, schema=PROBLEMS_SCHEMA)),
    ):
        (tables / name).mkdir()
        frame.write_parquet(tables / name / "part-00000.parquet")


def _with_least(logs: pl.DataFrame, tables: Path) -> pl.DataFrame:
    """Add the least TTC and PET of each log's encounters."""
    if not (tables / "encounters").exists():
        return logs
    ttc, pet = pl.col("least_ttc_s"), pl.col("least_pet_s")
    grouped = _scan(tables, "encounters").group_by("log")
    least = grouped.agg(ttc.filter(ttc.is_finite()).min(), pet.get(pet.abs().arg_min(), null_on_oob=True))
    joined = logs.drop("least_ttc_s", "least_pet_s").join(least.collect(), on="log", how="left")
    return joined.select(LOGS_SCHEMA.names())


def _scan(tables: Path, name: str) -> pl.LazyFrame:
    return pl.scan_parquet(sorted((tables / name).glob("*.parquet")), glob=False)


# --- the page --------------------------------------------------------------------------------


def _figures(folder: Path, books: Books, tables: Path) -> FleetFigures:
    logs = _scan(tables, "logs").collect()
    windows = _scan(tables, "windows").collect()

    def scan(name: str) -> pl.LazyFrame | None:
        return _scan(tables, name) if (tables / name).exists() else None

    findings, encounters = scan("findings"), scan("encounters")
    worst, left_out = _worst(encounters, logs, windows)
    return FleetFigures(
        title=folder.absolute().name,
        call=_call(books, logs),
        logs=logs,
        findings=_by_rule(findings),
        encounters=worst,
        encounters_left_out=left_out,
        quality=_quality(_scan(tables, "problems").collect(), findings),
        distributions=distributions(encounters, scan("against_plan"), windows, logs),
    )


def _call(books: Books, logs: pl.DataFrame) -> list[tuple[str, Any]]:
    recorded, spent = float(logs["log_s"].sum()), float(logs["cpu_s"].sum())
    ended = max((float(e["at"]) for e in books.ends.values()), default=0.0)
    certified, plannable = int(logs["vehicles_certified"].sum()), int(logs["vehicles_plannable"].sum())
    when = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(ended)) if ended else "–"
    return [
        ("Logs", str(logs.height)),
        ("Recorded time", duration(recorded)),
        ("Vehicles certified, of those plannable", f"{certified} of {plannable}"),
        ("Windows in full", f"{int(logs['windows_full'].sum())} of {int(logs['windows'].sum())}"),
        ("Processor time", duration(spent)),
        ("Largest memory of a job", f"{max(logs['peak_mb'].drop_nulls(), default=0.0):.0f} MB"),
        ("Last log ended", when),
    ]


def _severity_rank() -> pl.Expr:
    ranks = {severity: rank for rank, severity in enumerate(_SEVERITIES, start=1)}
    return pl.col("severity").replace_strict(ranks, default=0, return_dtype=pl.Int8)


def _worst(
    encounters: pl.LazyFrame | None, logs: pl.DataFrame, windows: pl.DataFrame
) -> tuple[pl.DataFrame, int]:
    """The worst encounters with the window and the page of each, and how many are left out."""
    if encounters is None:
        return pl.DataFrame(), 0
    count = encounters.select(pl.len()).collect().item()
    order = ["_rank", "least_ttc_s", "least_gap_m", "log", "worst_ns"]
    worst = (
        encounters.with_columns(_rank=_severity_rank())
        .sort(order, descending=[True, False, False, False, False], nulls_last=True)
        .head(_ENCOUNTERS)
        .collect()
        .with_row_index("_place")
    )
    spans = windows.select("log", "window", window_start_ns="start_ns", window_end_ns="end_ns")
    inside = (
        worst.select("_place", "log", "worst_ns")
        .join(spans, on="log")
        .filter(pl.col("worst_ns").is_between(pl.col("window_start_ns"), pl.col("window_end_ns")))
        .group_by("_place")
        .agg(pl.col("window").min())
    )
    pages = logs.select("log", "page")
    placed = worst.join(inside, on="_place", how="left").join(pages, on="log", how="left")
    return placed.sort("_place"), count - worst.height


def _by_rule(findings: pl.LazyFrame | None) -> pl.DataFrame:
    """Findings a rule: by severity where they can be trusted, those in doubt, and their logs."""
    if findings is None:
        return pl.DataFrame()
    trusted = pl.col("verdict") == "fail"
    counts = [(trusted & (pl.col("severity") == s)).sum().alias(s) for s in _SEVERITIES]
    return (
        findings.group_by("rule")
        .agg(
            *counts,
            (pl.col("verdict") == "inconclusive").sum().alias("in_doubt"),
            pl.col("log").n_unique().alias("logs"),
        )
        .sort("critical", "serious", "minor", "in_doubt", "rule", descending=[True, True, True, True, False])
        .collect()
    )


def _quality(problems: pl.DataFrame, findings: pl.LazyFrame | None) -> pl.DataFrame:
    """What is wrong with the logs: by the reader's code, and by the audit's rules of data quality."""
    logs, example = pl.col("log").n_unique().alias("logs"), pl.col("detail").first().alias("example")
    told = [logs, pl.len().alias("cases"), example]
    parts = [problems.group_by("code").agg(*told).with_columns(kind=pl.lit("reading"))]
    if findings is not None:
        data = findings.filter(pl.col("severity").is_null()).rename({"rule": "code"})
        parts.append(data.group_by("code").agg(*told).collect().with_columns(kind=pl.lit("audit")))
    return pl.concat(parts, how="diagonal_relaxed").sort(
        "logs", "cases", "code", descending=[True, True, False]
    )
