"""Reading scene files: start and goal poses, obstacles and a map, as JSON."""

from __future__ import annotations

from pathlib import Path

from istc_replay.errors import LogError
from istc_replay.samples.sceneform import SceneFile, parse_scene

_SIZE_LIMIT = 16 * 2**20


def read_scene(path: Path) -> SceneFile:
    """Read a scene file.

    Raises
    ------
    LogError
        If the file cannot be read, or is larger than 16 MiB.
    ScenarioError
        If it does not have the form of schemas/scene.schema.json.
    """
    try:
        if path.stat().st_size > _SIZE_LIMIT:
            raise LogError(f"{path}: larger than {_SIZE_LIMIT} bytes; a scene file is small")
        return parse_scene(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: cannot be read: {error}; give a scene file (JSON)") from None
