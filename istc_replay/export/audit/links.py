"""What leads from a finding in the report to its instant: the view of the result, and a clip of the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from istc_replay.export.report.markup import Html, element, join


@dataclass(frozen=True, slots=True)
class Links:
    """Where the view and the clips are.

    A bundle of the view may stand beside the report, in the folder `view`; `origin_ns` is where its
    time begins, None where there is no view. `clips` are paths relative to the report, by the id of
    an encounter or of a finding.
    """

    origin_ns: int | None = None
    clips: Mapping[str, Path] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return self.origin_ns is not None or bool(self.clips)

    def of(self, finding: dict[str, Any]) -> Html | None:
        """Links of a finding; None where there are none."""
        parts = []
        if self.origin_ns is not None:
            command = f"istc-replay view RESULT --finding {finding['finding_id']}"
            target = f"view/index.html#ns={finding['worst_ns'] - self.origin_ns}"
            parts.append(element("a", "view", href=target, title=command))
        clip = self.clips.get(str(finding["encounter_id"])) or self.clips.get(str(finding["finding_id"]))
        if clip is not None:
            parts.append(element("a", "clip", href=quote(clip.as_posix())))
        return join(parts, ", ") if parts else None
