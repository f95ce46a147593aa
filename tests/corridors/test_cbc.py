"""Running CBC and reading its log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pyomo.environ as pyo
import pytest

from istc_replay.corridors import cbc
from istc_replay.datatypes import SolveStatus
from istc_replay.errors import SolveError


def knapsack(items: int = 30) -> pyo.ConcreteModel:
    """A correlated knapsack that needs branching."""
    model = pyo.ConcreteModel()
    weights = [(37 * i) % 91 + 10 for i in range(items)]
    model.x = pyo.Var(range(items), within=pyo.Binary)
    model.fits = pyo.Constraint(expr=sum(w * model.x[i] for i, w in enumerate(weights)) <= sum(weights) // 2)
    model.worth = pyo.Objective(expr=-sum((w + 5) * model.x[i] for i, w in enumerate(weights)))
    return model


def solve(model: pyo.ConcreteModel, nodes: int = 100_000) -> cbc.CbcRun:
    return cbc.solve(model, gap=0.0, node_budget=nodes, emergency_stop_s=60.0)


def test_an_optimum_comes_with_a_bound_that_is_not_above_it() -> None:
    model = knapsack()
    run = solve(model)
    assert run.status is SolveStatus.OPTIMAL
    assert run.bound is not None
    assert pyo.value(model.worth) - 0.1 <= run.bound <= pyo.value(model.worth)


def test_an_infeasible_model_is_called_so() -> None:
    model = knapsack()
    model.more = pyo.Constraint(expr=sum(model.x[i] for i in model.x) >= 31)
    assert solve(model).status is SolveStatus.INFEASIBLE


def test_a_node_limit_is_no_proof() -> None:
    run = solve(knapsack(60), nodes=1)
    assert run.status in (SolveStatus.FEASIBLE, SolveStatus.LIMIT, SolveStatus.OPTIMAL)
    if run.status is SolveStatus.FEASIBLE:
        full = knapsack(60)
        solve(full)
        assert run.bound is not None
        assert run.bound <= pyo.value(full.worth)


def test_node_counts_repeat() -> None:
    assert solve(knapsack(40)).nodes == solve(knapsack(40)).nodes


def test_a_log_without_a_result_is_an_error() -> None:
    run = cbc.read_log("Welcome to the CBC MILP Solver\n")
    assert (run.status, run.bound) == (SolveStatus.ERROR, None)
    assert "without a result" in run.detail


def test_a_bound_read_from_the_log_is_moved_outward() -> None:
    run = cbc.read_log(
        "Result - Stopped on node limit\n\nObjective value:                -10.5\n"
        "Lower bound:                    -12.3457\nGap:                            0.15\n"
        "Enumerated nodes:               50\nTotal iterations:               99\n"
    )
    assert run.status is SolveStatus.FEASIBLE
    assert run.bound is not None
    assert run.bound < -12.3457
    assert (run.nodes, run.iterations) == (50, 99)


def test_a_missing_binary_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cbc.executable.cache_clear()
    monkeypatch.setattr(cbc.cbcbox, "cbc_bin_path", lambda: str(tmp_path / "cbc"))
    with pytest.raises(SolveError, match="CBC is missing"):
        cbc.executable()
    cbc.executable.cache_clear()


def test_a_solver_that_is_killed_is_told_so(fake_cbc: Callable[[str], None]) -> None:
    fake_cbc("echo 'Result - Optimal solution found'; kill -9 $$\n")
    run = solve(knapsack())
    assert run.status is SolveStatus.ERROR
    assert "killed by signal 9" in run.detail


def test_a_solver_that_fails_is_told_so(fake_cbc: Callable[[str], None]) -> None:
    fake_cbc("exit 3\n")
    assert solve(knapsack()).detail == "CBC failed with exit code 3"


def test_a_solver_that_does_not_stop_is_stopped(
    fake_cbc: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_cbc("exec sleep 60\n")
    monkeypatch.setattr(cbc, "_START_S", 0.2)
    run = cbc.solve(knapsack(), gap=0.0, node_budget=10, emergency_stop_s=0.1)
    assert run.status is SolveStatus.LIMIT
    assert "did not stop" in run.detail
