"""Damage of every kind: what is recovered, how it is told, in what time and memory.

Each kind is a file made on the spot from one whole log, and `istc-replay info --json` reads it in a
process of its own. The command fails where a message is lost that is intact, where damage is not told,
or where a file takes more than 2 s of the processor or 500 MiB.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from damage_kinds import KINDS, Kind

LIMIT_S, LIMIT_MIB = 2.0, 500.0

#: Runs the command, then tells the memory that this process held at most [KiB].
_RUN = """
import atexit, sys
from pathlib import Path
def peak():
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text().splitlines()
        print(next(line for line in lines if line.startswith("VmHWM")), file=sys.stderr)
atexit.register(peak)
from istc_replay.cli import main
main()
"""


def config_of(fields: dict[str, str]) -> str:
    """The configuration that reads /x by a mapping."""
    told = "".join(f'{name} = "{path}"\n' for name, path in fields.items() if name != "items")
    items = f'items = "{fields["items"]}"\n' if "items" in fields else ""
    return f'[ingest.topics."/x"]\n{items}[ingest.topics."/x".fields]\n{told}' if fields else ""


def measure(path: Path, fields: dict[str, str]) -> tuple[int, dict[str, object], float, float, str]:
    """Exit code, facts, processor seconds, peak MiB and stderr of one `info --json`."""
    command = [sys.executable, "-c", _RUN, "info", "--json", str(path)]
    if fields:
        config = path.with_suffix(".toml")
        config.write_text(config_of(fields))
        command += ["-c", str(config)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:  # noqa: S603
        out, err = process.stdout.read(), process.stderr.read()  # type: ignore[union-attr]
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    facts = json.loads(out) if out else {}
    seconds = usage.ru_utime + usage.ru_stime
    lines = err.decode().splitlines(keepends=True)
    peak = [int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")]
    err_text = "".join(line for line in lines if not line.startswith("VmHWM"))
    return process.returncode, facts, seconds, peak[0] if peak else usage.ru_maxrss / 1024, err_text


def faults(
    kind: Kind, code: int, facts: dict[str, object], seconds: float, peak: float, err: str
) -> list[str]:
    """Say what of the promise one kind breaks."""
    found = []
    codes = {problem["code"] for problem in facts.get("problems", ())}  # type: ignore[attr-defined]
    if "Traceback" in err or code not in (0, 3):
        found.append(f"exit code {code}: {err[-300:]}")
    if kind.intact == -1:
        if code != 3 or err.count("\n") != 1:
            found.append("not refused in a line")
    elif kind.intact is not None and facts.get("messages") != kind.intact:
        found.append(f"{facts.get('messages')} messages, {kind.intact} are intact")
    if not kind.codes <= codes:
        found.append(f"not told: {', '.join(sorted(kind.codes - codes))}")
    if seconds > LIMIT_S or peak > LIMIT_MIB:
        found.append(f"{seconds:.2f} s, {peak:.0f} MiB")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="only the kinds whose name holds this")
    options = parser.parse_args()
    wrong = []
    print("| damage | bytes | messages recovered | told as | s | MiB |")
    print("|---|---|---|---|---|---|")
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        for kind in KINDS:
            if options.only not in kind.name:
                continue
            data = kind.data()
            path.write_bytes(data)
            code, facts, seconds, peak, err = measure(path, kind.fields)
            told = sorted({problem["code"] for problem in facts.get("problems", ())})  # type: ignore[attr-defined]
            found = facts.get("messages")
            shown = (
                "refused"
                if found is None
                else f"{found}" + ("" if kind.intact is None else f" of {kind.intact}")
            )
            words = ", ".join(told) or ("" if found is not None else err.split(": ")[-1].strip()[:60])
            print(
                f"| {kind.name} | {len(data)} | {shown} | {words} | {seconds:.2f} | {peak:.0f} |", flush=True
            )
            wrong += [f"{kind.name}: {fault}" for fault in faults(kind, code, facts, seconds, peak, err)]
    print(f"{len(KINDS)} kinds in {time.monotonic() - began:.0f} s", file=sys.stderr)
    for fault in wrong:
        print(fault, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
