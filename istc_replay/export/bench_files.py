"""Files of a measurement: bench.json, charts beside the paper's figures, a plan view of each scene."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from istc_replay.export.atomic import atomic_file, prepare_folder
from istc_replay.export.figures import draw_figures, figure_bytes
from istc_replay.export.figures.style import INK, MUTED, drawing_style

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from istc_replay.datatypes import Result
    from istc_replay.export.figures import Format

_LAYER_1, _LAYER_2, _PAPER_1, _PAPER_2, _PEER = "#1f5fa8", "#7fb1e3", "#8a5a00", "#dcae5b", "#6b7580"
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")


def write_bench(
    folder: Path,
    rows: Sequence[Mapping[str, Any]],
    others: Mapping[str, Any],
    results: Mapping[str, Result],
    format: Format,  # noqa: A002
    *,
    scaling: bool,
) -> list[Path]:
    """Write bench.json, the charts and a picture of each scene.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    rows : sequence of mappings
        Measured rows.
    others : mapping
        Figures of the paper and of CL-CBS by scene.
    results : mapping
        Results by scene, for the pictures.
    format : {'svg', 'png', 'pdf'}
        Of the pictures.
    scaling : bool
        Whether the rows are one family of scenes by the number of vehicles.

    Raises
    ------
    ExportError
        If a file cannot be written.
    """
    prepare_folder(folder)
    figures = {"times": draw_times(rows, others), "lengths": draw_lengths(rows, others)}
    if scaling:
        figures["scaling"] = draw_scaling(rows, others)
    for name, result in results.items():
        pictures = draw_figures(result, 0)
        figures |= {
            f"{name}_{kind}": pictures[kind] for kind in ("top_down", "corridors") if kind in pictures
        }
    written = []
    for name, figure in figures.items():
        written.append(folder / f"{name}.{format}")
        with atomic_file(written[-1]) as file:
            file.write_bytes(figure_bytes(figure, format))
    written.append(folder / "bench.json")
    with atomic_file(written[-1]) as file:
        file.write_text(json.dumps({"rows": list(rows), "others": others}, indent=1) + "\n", encoding="utf-8")
    return written


def draw_times(rows: Sequence[Mapping[str, Any]], others: Mapping[str, Any]) -> Figure:
    """Seconds of both layers, beside the paper's and CL-CBS's, on a logarithmic axis."""
    with drawing_style():
        figure = Figure(figsize=(8.2, 0.9 + 0.95 * len(rows)), layout="constrained")
        axes = figure.subplots()
        for place, row in enumerate(rows):
            paper = others["paper"].get(row["name"], {})
            peer = others["cl_cbs"].get(row["name"], {})
            bars = [
                ("layer 1", row["layer1_s"], _LAYER_1),
                ("layer 1, paper", paper.get("layer1_s"), _PAPER_1),
                ("layer 2", row["layer2_s"], _LAYER_2),
                ("layer 2, paper", paper.get("layer2_s"), _PAPER_2),
                ("CL-CBS, all", peer.get("seconds"), _PEER),
            ]
            for number, (label, seconds, colour) in enumerate(bars):
                if seconds:
                    at = place + (number - 2) * 0.16
                    axes.barh(at, seconds, 0.14, color=colour, label=label if place == 0 else None)
                    axes.text(seconds * 1.05, at, f"{seconds:.3g}", va="center", fontsize=7, color=INK)
        _label_rows(axes, rows)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(_PLAIN)
        axes.set_xlabel("seconds")
        axes.set_title("Solve time by layer: sums over vehicles, medians of runs")
        _legend(axes, rows)
    return figure


def draw_lengths(rows: Sequence[Mapping[str, Any]], others: Mapping[str, Any]) -> Figure:
    """Total length of the plans, beside guidance, the paper's and CL-CBS's."""
    with drawing_style():
        figure = Figure(figsize=(8.2, 0.9 + 0.42 * len(rows)), layout="constrained")
        axes = figure.subplots()
        series = {
            "plan": ("o", _LAYER_1, [row["length_m"] for row in rows]),
            "guidance": ("|", MUTED, [row["guidance_m"] for row in rows]),
            "paper (its own scenes)": ("D", _PAPER_2, [_of(others, "paper", row) for row in rows]),
            "CL-CBS": ("s", _PEER, [_of(others, "cl_cbs", row) for row in rows]),
        }
        for label, (marker, colour, values) in series.items():
            known = [(value, place) for place, value in enumerate(values) if value is not None]
            if known:
                axes.plot(*zip(*known, strict=True), marker, color=colour, label=label, markersize=7)
        _label_rows(axes, rows)
        axes.set_xlabel("metres, sum over vehicles")
        axes.set_title("Total length")
        _legend(axes, rows)
    return figure


def draw_scaling(rows: Sequence[Mapping[str, Any]], others: Mapping[str, Any]) -> Figure:
    """Cost against size: seconds of each layer over the number of vehicles."""
    with drawing_style():
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        axes = figure.subplots()
        counts = [row["vehicles"] for row in rows]
        lines = {
            "layer 1": (_LAYER_1, "o-", [row["layer1_s"] for row in rows]),
            "layer 2": (_LAYER_2, "s-", [row["layer2_s"] for row in rows]),
            "layer 1, paper": (_PAPER_1, "D--", [_of(others, "paper", row, "layer1_s") for row in rows]),
            "CL-CBS, all": (_PEER, "x--", [_of(others, "cl_cbs", row, "seconds") for row in rows]),
        }
        for label, (colour, style, values) in lines.items():
            known = [(n, value) for n, value in zip(counts, values, strict=True) if value]
            if known:
                axes.plot(*zip(*known, strict=True), style, color=colour, label=label, markersize=5)
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(10.0))
        axes.yaxis.set_major_formatter(_PLAIN)
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_xticks(counts)
        axes.set_xlabel("vehicles")
        axes.set_ylabel("seconds")
        axes.set_title("Cost against size")
        axes.legend(loc="upper left")
    return figure


def _of(others: Mapping[str, Any], who: str, row: Mapping[str, Any], what: str = "length_m") -> Any:
    return others[who].get(row["name"], {}).get(what)


def _label_rows(axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    names = [row["name"] + ("" if row["certified"] and row["arrived"] else " *") for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def _legend(axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    if not all(row["certified"] and row["arrived"] for row in rows):
        axes.annotate("* not certified, or not all arrived", (0.0, -0.02), xycoords="figure fraction")
