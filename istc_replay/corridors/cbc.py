"""Running CBC on a Pyomo model, and reading what it proved from its log."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import threading
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cbcbox
import pyomo.environ as pyo
from pyomo.repn.plugins.lp_writer import LPWriter

from istc_replay.datatypes import SolveStatus
from istc_replay.errors import SolveError

#: CBC's log has six significant digits; a bound read from it is moved outward by this share.
_LOG_ROUNDING = 1e-5
#: Longest time that a start may take beyond twice the emergency stop [s].
_START_S = 10.0
_RESULT = re.compile(r"^Result - (.+)$", re.MULTILINE)
_BANNER = re.compile(r"Optimal — Obj: \S+\s+Bound: (\S+)")
_FIELDS = {
    "bound": re.compile(r"^Lower bound:\s+(\S+)", re.MULTILINE),
    "objective": re.compile(r"^Objective value:\s+(\S+)", re.MULTILINE),
    "nodes": re.compile(r"^Enumerated nodes:\s+(\d+)", re.MULTILINE),
    "iterations": re.compile(r"^Total iterations:\s+(\d+)", re.MULTILINE),
}


@dataclass(frozen=True, slots=True)
class CbcRun:
    """How a run ended: status, the bound it proved (outward rounded), nodes and iterations."""

    status: SolveStatus
    bound: float | None
    nodes: int
    iterations: int
    detail: str


@cache
def executable() -> str:
    """Path of the CBC binary that comes with the wheel (its build fits this processor)."""
    path = str(cbcbox.cbc_bin_path())
    if not Path(path).is_file():
        raise SolveError(f"CBC is missing: {path} is no file; install the package cbcbox again")
    return path


def build_name() -> str:
    """Name of the build in use, such as cbc_dist_avx2."""
    return next((part for part in Path(executable()).parts if part.startswith("cbc_dist")), "cbc")


def solve(
    model: Any, *, gap: float, node_budget: int, emergency_stop_s: float, warm_start: bool = False
) -> CbcRun:
    """Solve a Pyomo model with CBC, and load the solution into the model where there is one.

    Pyomo writes the model and knows its names; CBC is run here, once a solve: Pyomo's own interface
    starts it a second time to ask for its version, and reads all of its log (docs/performance.md).

    Parameters
    ----------
    model : pyomo.ConcreteModel
        A mixed-integer linear program, minimised.
    gap : float
        Relative gap at which CBC may stop.
    node_budget : int
        Largest number of nodes: what decides a result, since seconds would not repeat.
    emergency_stop_s : float
        Wall-clock stop; it shows as a limit in the status.
    warm_start : bool
        Hand the values of the model's binaries to CBC as a MIP start.

    Returns
    -------
    CbcRun
        With status error, and why, where CBC died or wrote no result.

    Raises
    ------
    SolveError
        If CBC is missing.
    """
    binary = executable()
    with tempfile.TemporaryDirectory(prefix="istc-replay-") as name:
        folder = Path(name)
        with (folder / "model.lp").open("w") as file:
            symbols = LPWriter().write(model, file).symbol_map
        # These settings were faster by 6 to 10 times with this build of CBC.
        command = [binary, "-cuts", "off", "-preprocess", "off", "-heuristics", "off"]
        command += ["-ratioGap", repr(gap), "-maxNodes", str(node_budget)]
        command += ["-sec", repr(emergency_stop_s), "-timeMode", "elapsed", "-import", "model.lp"]
        if warm_start:
            (folder / "start.sol").write_text(_start(model, symbols))
            command += ["-mipstart", "start.sol"]
        command += ["-solve", "-solu", "model.sol"]
        run = _run(command, folder, emergency_stop_s)
        if run.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE) and not _load(
            folder / "model.sol", model, symbols
        ):
            return replace(run, status=SolveStatus.LIMIT)
    return run


def _run(command: list[str], folder: Path, emergency_stop_s: float) -> CbcRun:
    # The threads of its linear algebra would cost more to start than they save.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with (folder / "cbc.log").open("w+b") as log:
        try:
            process = subprocess.Popen(  # noqa: S603 - the solver's own binary, no shell
                command,
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            return CbcRun(SolveStatus.ERROR, None, 0, 0, f"CBC cannot be run: {error.strerror}")
        # A wait with a timeout would poll, in steps of up to 50 ms.
        watch = threading.Timer(2.0 * emergency_stop_s + _START_S, process.kill)
        watch.start()
        try:
            code = process.wait()
        finally:
            in_time = watch.is_alive()
            watch.cancel()
            process.kill()
        log.seek(0)
        text = log.read().decode("utf-8", errors="replace")
    if not in_time:
        return CbcRun(SolveStatus.LIMIT, None, 0, 0, f"CBC did not stop within {emergency_stop_s:g} s")
    if code < 0:
        return CbcRun(SolveStatus.ERROR, None, 0, 0, f"CBC was killed by signal {-code}")
    if code > 0:
        return CbcRun(SolveStatus.ERROR, None, 0, 0, f"CBC failed with exit code {code}")
    return read_log(text)


def _start(model: Any, symbols: Any) -> str:
    """The binaries that are 1, in CBC's form; it ignores the numbers in front."""
    names = symbols.byObject
    on = [
        names[id(variable)]
        for variable in model.component_data_objects(pyo.Var)
        if variable.is_binary() and variable.value and id(variable) in names
    ]
    return "".join(f"{number} {name} 1\n" for number, name in enumerate(on))


def _load(path: Path, model: Any, symbols: Any) -> bool:
    """Load CBC's solution file, which leaves out zeros; whether there is one."""
    lines = path.read_text().splitlines() if path.is_file() else []
    if not lines:
        return False
    for variable in model.component_data_objects(pyo.Var):
        variable.set_value(0.0, skip_validation=True)
    for line in lines[1:]:
        fields = line.replace("**", " ").split()
        variable = symbols.bySymbol.get(fields[1])
        if variable is not None:
            variable.set_value(float(fields[2]), skip_validation=True)
    return True


def read_log(text: str) -> CbcRun:
    """Read CBC's log: on a limit Pyomo leaves the bound out, the log has it."""
    found = _RESULT.findall(text)
    if not found and "nfeasibility proved" in text:
        # Preprocessing alone may find it; then there is no Result block.
        return CbcRun(SolveStatus.INFEASIBLE, None, 0, 0, "infeasible before the search")
    if not found:
        return CbcRun(SolveStatus.ERROR, None, 0, 0, "CBC ended without a result")
    detail = found[-1].strip()
    # The Result block is the last; what stands before it belongs to the search.
    block = text[text.rindex("Result - ") :]
    values = {name: _number(pattern, block) for name, pattern in _FIELDS.items()}
    objective, bound = values["objective"], values["bound"]
    if detail.startswith("Optimal solution found"):
        status = SolveStatus.OPTIMAL
        # With a gap allowed CBC calls optimal what it has not closed: its banner has the bound.
        stated = [b for b in (bound, objective, *map(float, _BANNER.findall(text)[-1:])) if b is not None]
        bound = min(stated)
    elif "infeasible" in detail:
        status = SolveStatus.INFEASIBLE
    elif "No feasible solution found" in block or objective is None:
        status = SolveStatus.LIMIT
    else:
        status = SolveStatus.FEASIBLE
    if bound is not None:
        bound -= _LOG_ROUNDING * max(1.0, abs(bound))
    return CbcRun(status, bound, int(values["nodes"] or 0), int(values["iterations"] or 0), detail)


def _number(pattern: re.Pattern[str], text: str) -> float | None:
    match = pattern.search(text)
    return None if match is None else float(match.group(1))
