"""Comparing two results."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from istc_replay.comparison.difference import Comparison

SCHEMA = "istc-replay.comparison.v1"


def compare_read(one: Path, two: Path, folder: Path | None) -> tuple[Comparison, list[Path]]:
    """Compare two results (folders or result.mcap); write page, view and figures if a folder is given.

    Raises
    ------
    LogError
        If one of them is no readable result.
    ExportError
        If a file cannot be written whole.
    """
    from istc_replay.comparison.compare import compare_results
    from istc_replay.pipeline.reading import read_in_parts

    a, b = read_in_parts(one), read_in_parts(two)
    comparison = compare_results(a.result, b.result, a.each(), b.each())
    if folder is None:
        return comparison, []
    from istc_replay.export.atomic import atomic_file, prepare_folder
    from istc_replay.export.report.beside import comparison_html, pictured
    from istc_replay.export.rerun.beside import write_beside

    prepare_folder(folder)
    files = [folder / name for name in ("compare.html", "compare.json", "compare.rrd")]
    with atomic_file(files[0]) as file:
        some, others = (side.of(pictured(comparison)) for side in (a, b))
        file.write_text(comparison_html(comparison, some, others, (str(one), str(two))), encoding="utf-8")
    with atomic_file(files[1]) as file:
        file.write_text(json.dumps(comparison_facts(comparison, one, two), indent=1, allow_nan=False) + "\n")
    write_beside(comparison, a.result, b.result, files[2], (a.parts, b.parts))
    return comparison, files


def comparison_facts(comparison: Comparison, one: Path, two: Path) -> dict[str, Any]:
    """The comparison as `--json` tells it."""
    return {
        "schema": SCHEMA,
        "a": str(one),
        "b": str(two),
        "same": comparison.same,
        "same_outcome": comparison.same_outcome,
        **asdict(comparison),
    }
