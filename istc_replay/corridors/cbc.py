"""Running CBC on a Pyomo model, and reading what it proved from its log."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cbcbox
import pyomo.environ as pyo
from pyomo.common.errors import ApplicationError

from istc_replay.datatypes import SolveStatus
from istc_replay.errors import SolveError

#: CBC's log has six significant digits; a bound read from it is moved outward by this share.
_LOG_ROUNDING = 1e-5
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
        Hand the model's values to CBC as a MIP start.

    Raises
    ------
    SolveError
        If CBC cannot be run or dies.
    """
    solver = pyo.SolverFactory("cbc", executable=executable())
    # These settings were faster by 6 to 10 times with this build of CBC.
    options = {"cuts": "off", "preprocess": "off", "heuristics": "off", "ratioGap": gap}
    options |= {"maxNodes": node_budget, "sec": emergency_stop_s}
    with tempfile.TemporaryDirectory(prefix="istc-replay-") as folder:
        log = Path(folder) / "cbc.log"
        try:
            results = solver.solve(
                model, options=options, warmstart=warm_start, logfile=str(log), load_solutions=False
            )
        except (ApplicationError, OSError, ValueError) as error:
            raise SolveError(f"CBC failed: {_first_line(error)}; its binary is {executable()}") from None
        run = read_log(log.read_text(encoding="utf-8", errors="replace"))
    if run.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE):
        if len(results.solution) == 0:
            return CbcRun(SolveStatus.LIMIT, run.bound, run.nodes, run.iterations, run.detail)
        model.solutions.load_from(results)
    return run


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def read_log(text: str) -> CbcRun:
    """Read CBC's log: on a limit Pyomo leaves the bound out, the log has it."""
    found = _RESULT.findall(text)
    if not found and "nfeasibility proved" in text:
        # Preprocessing alone may find it; then there is no Result block.
        return CbcRun(SolveStatus.INFEASIBLE, None, 0, 0, "infeasible before the search")
    if not found:
        raise SolveError("CBC ended without a result; was it killed?")
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
