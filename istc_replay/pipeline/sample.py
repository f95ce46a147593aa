"""Samples as recorded logs."""

from __future__ import annotations

from pathlib import Path

from istc_replay.config import Config


def write_sample(scene: str, out: Path, config: Config | None = None) -> None:
    """Write a sample by its name, or a scene file, as a recorded log; routes by the guidance settings.

    Raises
    ------
    UsageError
        If there is no sample and no file of this name.
    ScenarioError
        If the scene cannot be driven.
    """
    from istc_replay.export.atomic import atomic_file
    from istc_replay.export.sample_log import sample_bytes
    from istc_replay.ingest.scene_file import read_scene
    from istc_replay.samples.scenes import find_sample, record

    settings = (config or Config()).guidance
    if scene.endswith(".json"):
        data = sample_bytes(record(read_scene(Path(scene)), settings))
    else:
        sample = find_sample(scene)
        data = sample_bytes(sample.recorded(settings), sample.format)
    with atomic_file(out) as file:
        file.write_bytes(data)
