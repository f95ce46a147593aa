"""The libraries that a replay needs: their import, and their versions."""

from __future__ import annotations

import platform
from functools import cache
from importlib import import_module, metadata

from istc_replay.errors import ExportError

_COMPONENTS = ("istc-replay", "casadi", "cbcbox", "daqp", "mcap", "numpy", "polars", "pyomo", "rerun-sdk")

#: Modules of which a replay needs all, and whose libraries take long to import.
_METHOD = (
    "coordinate",
    "changes",
    "export.result_mcap",
    "export.summary",
    "ingest.result",
    "safety.certificate",
)


@cache
def versions() -> dict[str, str]:
    """Versions of everything that a result depends on."""
    found = {"python": platform.python_version()}
    for name in _COMPONENTS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError as error:
            raise ExportError(f"{name} is not installed as a package: {error}; install it again") from None
    # The wheel holds several builds of CBC and picks one by processor.
    from istc_replay.corridors.cbc import build_name

    found["cbc"] = build_name()
    return found


def import_method() -> None:
    """Import the heavy libraries at one place, so that their time shows as a stage of its own."""
    for name in _METHOD:
        import_module(f"istc_replay.{name}")
