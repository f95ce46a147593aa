"""Replaying logs into folders: result.mcap, view.rrd, report.html and summary.json."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from istc_replay.errors import UsageError
from istc_replay.pipeline.replay import replay_log
from istc_replay.pipeline.stages import Stages
from istc_replay.pipeline.windows import silent
from istc_replay.pipeline.work_folder import clear_work

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from istc_replay.config import Config
    from istc_replay.pipeline.assembly import Replay
    from istc_replay.pipeline.live import LiveView

#: What `run_log` writes beside result.mcap and summary.json.
RUN_OUTPUTS = ("view.rrd", "report.html")

RESULT = "result.mcap"


def run_log(
    path: Path,
    folder: Path,
    config: Config,
    progress: Callable[[str, int, int], None] = silent,
    jobs: int = 1,
    live: LiveView | None = None,
    *,
    reading: Callable[[int, int], None] | None = None,
) -> Replay:
    """Replay one log and write result.mcap, view.rrd, report.html and summary.json to a folder.

    Parameters
    ----------
    path, folder : Path
        The log, and where to write.
    config : Config
        The settings.
    progress, jobs, live, reading
        As of `replay.replay_log`.

    Raises
    ------
    ExportError
        If an output cannot be written whole; nothing half-written stays.
    """
    from istc_replay.export.atomic import prepare_folder
    from istc_replay.pipeline.reading import read_in_parts

    stages = Stages()
    prepare_folder(folder)
    done = replay_log(
        path,
        config,
        jobs=jobs,
        output=folder,
        progress=progress,
        reading=reading,
        stages=stages,
        live=live,
        file=folder / RESULT,
    )
    done = replace(done, audit=None)
    windows = len(done.summary["windows"])
    progress("writing", windows, windows)
    write_run(done, folder, config, path.name, stages)
    clear_work(folder)
    if live is not None:
        live.finish(read_in_parts(folder / RESULT), config)
    return done


def write_run(
    done: Replay,
    folder: Path,
    config: Config,
    title: str,
    stages: Stages | None = None,
    products: Collection[str] = RUN_OUTPUTS,
) -> None:
    """Write the `products` and summary.json beside a replay's result.mcap.

    Parameters
    ----------
    done : Replay
        Its result.mcap is in the folder.
    folder : Path
        Where to write.
    config : Config
        Of the view.
    title : str
        Of the report.
    stages : Stages, optional
        Collects the time of each stage.
    products : collection of str
        Which of `RUN_OUTPUTS` to write.

    Raises
    ------
    ExportError
        If an output cannot be written whole; nothing half-written stays.
    """
    from istc_replay.export.atomic import atomic_file
    from istc_replay.pipeline.reading import read_in_parts

    timing = stages or Stages()
    with timing.stage("reading_back"):
        found = read_in_parts(folder / RESULT)
    if "view.rrd" in products:
        with timing.stage("view_rrd"):
            from istc_replay.export.rerun.view import write_view

            write_view(found.result, config.view, folder / "view.rrd", parts=found.parts)
    if "report.html" in products:
        with timing.stage("report_html"), atomic_file(folder / "report.html") as file:
            from istc_replay.export.report import report_html

            file.write_text(report_html(found.result, title, found.states), encoding="utf-8")
    from istc_replay.export.summary import summary_text

    with atomic_file(folder / "summary.json") as file, file.open("w", encoding="utf-8") as text:
        text.writelines(summary_text(done.summary))


def result_folders(paths: Sequence[Path], output: Path) -> dict[Path, Path]:
    """Name each log's folder, `output/<log stem>`.

    Raises
    ------
    UsageError
        If two logs would share one.
    """
    folders: dict[Path, Path] = {}
    for path in paths:
        folder = output / folder_name(path)
        if folder in folders.values():
            raise UsageError(f"{path}: another log writes to {folder} too; run them apart, or rename one")
        folders[path] = folder
    return folders


def folder_name(path: Path) -> str:
    """Name of a log's folder: its stem, without dots before it, which would hide it or lead elsewhere."""
    return path.stem.lstrip(".") or "log"
