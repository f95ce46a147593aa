"""Replay recorded traffic with one configuration and print what was planned, and what was not and why."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from istc_replay.config import Config, load_config
from istc_replay.errors import IstcReplayError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.assembly import assemble
from istc_replay.pipeline.libraries import import_method
from istc_replay.pipeline.windows import plan_windows

HEAD = (
    "| log | windows full | certified / plannable / present | T [s] | log s | CPU s | factor | all outputs | "
    "changed | aside m | clearance m | not planned |"
)
Windows = Sequence[dict[str, Any]]


def row(name: str, windows: Windows, span_s: float, plan_s: float, whole_s: float) -> str:
    """One line of the table."""
    certified, plannable, present = (
        sum(w[f"vehicles_{what}"] for w in windows) for what in ("certified", "plannable", "present")
    )
    full = sum(w["vehicles_certified"] == w["vehicles_plannable"] > 0 for w in windows)
    units = Counter(w["unit_s"] for w in windows)
    reasons = Counter(e["reason"] for w in windows for e in (*w["frozen"], *w["exclusions"]))
    reasons += Counter(w["status"] for w in windows if w["status"] not in ("certified", "partial"))
    told = [w["coordination"] for w in windows]
    clearances = [t["clearance_least_m"] for t in told if t["clearance_least_m"] is not None]
    cells = (
        name,
        f"{full} of {len(windows)}",
        f"{certified} / {plannable} / {present}",
        ", ".join(f"{unit:g}: {count}" for unit, count in sorted(units.items(), reverse=True)),
        f"{span_s:.1f}",
        f"{plan_s:.1f}",
        f"{span_s / plan_s:.1f}",
        f"{span_s / whole_s:.1f}",
        str(sum(t["vehicles_changed"] for t in told)),
        f"{max(t['lateral_most_m'] for t in told):.2f}",
        f"{min(clearances):.2f}" if clearances else "-",
        ", ".join(f"{reason} {count}" for reason, count in sorted(reasons.items())),
    )
    return "| " + " | ".join(cells) + " |"


def margins(windows: Windows) -> str:
    """The least margin of each check, and the number of windows that it judged."""
    least: dict[str, list[tuple[float, str]]] = {}
    for window in windows:
        for check in window["certificate"]["checks"]:
            if check["margin"] is not None:
                least.setdefault(check["check"], []).append((check["margin"], check["unit"]))
    return "\n".join(
        f"  {name}: {min(v)[0]:.3g} {min(v)[1]} of {len(v)} windows" for name, v in least.items()
    )


def main() -> None:
    """Print a row a log and their sum; times are of the processor.

    The factor is recorded time by the time of reading, preparation, both layers and certificates;
    `all outputs` has the audit and the bytes of the result as well.
    """
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
    sums = [0.0, 0.0, 0.0]
    for path in arguments.logs:
        began = time.process_time()
        try:
            log = read_log(path, config)
            outcomes = plan_windows(log, config)
            planned = time.process_time()
            summary = assemble(log, config, outcomes).summary
        except IstcReplayError as error:
            print(f"| {path.stem} | {error} |")
            continue
        own = (summary["totals"]["log_s"], planned - began, time.process_time() - began)
        print(row(path.stem, summary["windows"], *own), flush=True)
        everything += summary["windows"]
        sums = [a + b for a, b in zip(sums, own, strict=True)]
    print(row("all", everything, *sums))
    print("least margins of the certificates:", margins(everything), sep="\n")


if __name__ == "__main__":
    main()
