"""Replay recorded traffic with one configuration and print what was planned, and what was not and why."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from istc_replay.config import Config, load_config
from istc_replay.errors import IstcReplayError
from istc_replay.pipeline.replay import import_method, replay_log

HEAD = (
    "| log | windows full | certified / plannable / present | T [s] | log s | CPU s | factor | not planned |"
)


def row(name: str, windows: list[dict[str, Any]], span_s: float, cpu_s: float) -> str:
    """One line of the table."""
    certified, plannable, present = (
        sum(w[f"vehicles_{what}"] for w in windows) for what in ("certified", "plannable", "present")
    )
    full = sum(w["vehicles_certified"] == w["vehicles_plannable"] > 0 for w in windows)
    units = Counter(w["unit_s"] for w in windows)
    reasons = Counter(e["reason"] for w in windows for e in (*w["frozen"], *w["exclusions"]))
    reasons += Counter(w["status"] for w in windows if w["status"] not in ("certified", "partial"))
    return (
        f"| {name} | {full} of {len(windows)} | {certified} / {plannable} / {present} | "
        + ", ".join(f"{unit:g}: {count}" for unit, count in sorted(units.items(), reverse=True))
        + f" | {span_s:.1f} | {cpu_s:.1f} | {span_s / cpu_s:.1f} | "
        + ", ".join(f"{reason} {count}" for reason, count in sorted(reasons.items()))
        + " |"
    )


def main() -> None:
    """Print a row a log and their sum; the times are of the processor, reading included."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--config", type=Path)
    arguments = parser.parse_args()
    config: Config = load_config(arguments.config)
    if arguments.config is None:
        fast = config.corridors.model_copy(update={"mode": "fast"})
        config = config.model_copy(update={"corridors": fast})
    import_method()  # once a process, whatever the number of logs
    print(HEAD, "|" + "---|" * HEAD.count(" | ") + "---|", sep="\n")
    everything: list[dict[str, Any]] = []
    spans = cpu = 0.0
    for path in arguments.logs:
        try:
            summary = replay_log(path, config).summary
        except IstcReplayError as error:
            print(f"| {path.stem} | {error} |")
            continue
        totals, windows = summary["totals"], summary["windows"]
        print(row(path.stem, windows, totals["log_s"], totals["cpu_s"]), flush=True)
        everything += windows
        spans, cpu = spans + totals["log_s"], cpu + totals["cpu_s"]
    print(row("all", everything, spans, cpu))


if __name__ == "__main__":
    main()
