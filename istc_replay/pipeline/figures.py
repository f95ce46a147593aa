"""Pictures of a result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def write_figures(source: Path, folder: Path, formats: Sequence[Literal["png", "svg", "pdf"]]) -> list[Path]:
    """Draw every window of a result (its folder or result.mcap); returns the files."""
    from istc_replay.export.atomic import atomic_file, prepare_folder
    from istc_replay.export.figures import draw_figures, figure_bytes
    from istc_replay.pipeline.reading import read_in_parts

    reading = read_in_parts(source)
    prepare_folder(folder)
    files = []
    for part in reading.each():
        for window in part.summary["windows"]:
            for name, figure in draw_figures(part, window["index"]).items():
                for kind in formats:
                    path = folder / f"window_{window['index']}_{name}.{kind}"
                    with atomic_file(path) as file:
                        file.write_bytes(figure_bytes(figure, kind))
                    files.append(path)
    return files
