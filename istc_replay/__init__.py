"""istc-replay: replay recorded multi-vehicle logs with interactive spatio-temporal corridors.

`read_states(path)`, `replay(path, config)`, `audit(path_or_result)`, `compare(a, b)` and
`load_result(path)` do from Python what the commands do; what they return shows itself in a notebook.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import polars as pl

    from istc_replay.comparison.difference import Comparison
    from istc_replay.config import Config
    from istc_replay.datatypes import Result
    from istc_replay.safety.log_audit import Audit

__version__ = "0.1.0"


def read_states(path: str | Path, config: Config | None = None) -> pl.DataFrame:
    """Read a log's recorded states, one row each (columns: `states.STATES_SCHEMA`)."""
    from istc_replay.ingest.log import read_log

    return read_log(Path(path), config).states


def replay(path: str | Path, config: Config | None = None) -> Result:
    """Replay a log, in memory, and return its result."""
    from istc_replay.pipeline.replay import replay_log
    from istc_replay.pipeline.shown import shown_result

    return shown_result(replay_log(Path(path), config).result)


def load_result(path: str | Path) -> Result:
    """Load a result from its folder or its result.mcap."""
    from istc_replay.ingest.result import load_result_folder
    from istc_replay.pipeline.shown import shown_result

    return shown_result(load_result_folder(Path(path)))


def audit(source: str | Path | Result, config: Config | None = None) -> Audit:
    """Audit a log or a result for safety; the audit holds its findings and all else as tables."""
    from istc_replay.datatypes import Result
    from istc_replay.pipeline.audit import audit_loaded, audit_path
    from istc_replay.pipeline.shown import shown_audit

    if isinstance(source, Result):
        return shown_audit(audit_loaded(source, config))
    return shown_audit(audit_path(Path(source), config))


def compare(a: str | Path | Result, b: str | Path | Result) -> Comparison:
    """Compare two results: what moved, who waits for whom, which settings differ."""
    from istc_replay.comparison.compare import compare_results
    from istc_replay.datatypes import Result
    from istc_replay.pipeline.shown import shown_comparison

    one, two = (side if isinstance(side, Result) else load_result(side) for side in (a, b))
    return shown_comparison(compare_results(one, two))
