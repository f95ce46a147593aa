"""The MIQP of eq. (4) as a Pyomo model, and its proof by outer approximation with CBC.

CBC minimises no squares: each square is replaced by a variable above tangents. A relaxation's
optimum bounds the MIQP's from below; its choice of options, with the squares back, is a convex
QP whose solution bounds it from above. Tangents at both are added until the two meet.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyomo.environ as pyo
from pyomo.core.expr.numeric_expr import LinearExpression

from istc_replay.corridors.problem import CONSTANT, CorridorProblem, Disjunction, OptionTable, Row
from istc_replay.datatypes import FloatArray, read_only

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


@dataclass(slots=True)
class MilpModel:
    """The outer approximation as a Pyomo model: z, a binary an option, squares above tangents.

    `delta[d, o]` = 0 enforces option o of disjunction d, as in the paper.
    """

    problem: CorridorProblem
    model: Any
    tangents: list[tuple[int, float]] = field(default_factory=list)

    @property
    def binaries(self) -> int:
        """Number of binary variables."""
        return len(self.model.delta)

    def set_start(self, z: FloatArray) -> None:
        """Make z, with the options it meets best, the MIP start."""
        for index, variable in self.model.z.items():
            variable.set_value(float(z[index]), skip_validation=True)
        for index, variable in self.model.square.items():
            variable.set_value(float((z[index] - self.problem.reference[index]) ** 2), skip_validation=True)
        for d, best in enumerate(chosen_options(self.problem, z)):
            for o in range(len(self.problem.disjunctions[d].options)):
                self.model.delta[d, o].set_value(0 if o == best else 1, skip_validation=True)

    def add_tangents(self, z: FloatArray) -> int:
        """Add the tangents of all squares at z; returns how many were new."""
        new = 0
        for index in self.model.square:
            offset = float(z[index] - self.problem.reference[index])
            if all(i != index or abs(offset - at) > 1e-3 for i, at in self.tangents):
                self._add_tangent(index, offset)
                new += 1
        return new

    def _add_tangent(self, index: int, offset: float) -> None:
        # (z - r)^2 >= 2 c (z - r) - c^2
        model, reference = self.model, float(self.problem.reference[index])
        expression = _linear([model.square[index], model.z[index]], [1.0, -2.0 * offset])
        model.tangents.add(expression >= -2.0 * offset * reference - offset**2)
        self.tangents.append((index, offset))

    def solution(self) -> FloatArray:
        """Values of z."""
        return read_only([self.model.z[index].value for index in range(self.problem.size)])


def build_milp(
    problem: CorridorProblem,
    *,
    lower: FloatArray | None = None,
    upper: FloatArray | None = None,
    big_m: float | None = None,
    squares: bool = True,
) -> MilpModel:
    """Write the problem as a Pyomo model.

    Parameters
    ----------
    problem : CorridorProblem
        What to solve.
    lower, upper : (n,) arrays, optional
        Other bounds of z, such as fixed pivotal points.
    big_m : float, optional
        One M for all rows, as printed; otherwise the least that the bounds allow, row by row.
    squares : bool
        Whether eq. (3) is part of the objective (without tangents yet).
    """
    low = problem.lower if lower is None else lower
    high = problem.upper if upper is None else upper
    model = pyo.ConcreteModel("interactive spatio-temporal corridors")
    model.z = pyo.Var(range(problem.size), bounds=lambda _, i: (float(low[i]), float(high[i])), doc="eq. (1)")
    quadratic = np.flatnonzero(problem.quadratic) if squares else np.array([], dtype=np.int64)
    model.square = pyo.Var(quadratic.tolist(), within=pyo.NonNegativeReals, doc="squares of eq. (3)")
    pairs = [(d, o) for d, item in enumerate(problem.disjunctions) for o in range(len(item.options))]
    model.delta = pyo.Var(pairs, within=pyo.Binary, doc="delta of eq. (5), (6)")
    _add_rows(model, problem.rows)
    _add_disjunctions(model, problem.disjunctions, low, high, big_m)
    model.tangents = pyo.ConstraintList(doc="outer approximation of the squares of eq. (3)")
    linear = np.flatnonzero(problem.linear)
    model.objective = pyo.Objective(
        expr=_linear(
            [model.z[i] for i in linear.tolist()] + [model.square[i] for i in quadratic.tolist()],
            [*problem.linear[linear].tolist(), *problem.quadratic[quadratic].tolist()],
        ),
        doc="eq. (4)",
    )
    return MilpModel(problem, model)


def _linear(variables: Sequence[Any], weights: Sequence[float]) -> Any:
    return LinearExpression(constant=0, linear_coefs=list(weights), linear_vars=list(variables))


def _add_rows(model: Any, rows: Iterable[Row]) -> None:
    model.rows = pyo.Block(doc="the equations that always hold, a list an equation")
    lists: dict[str, Any] = {}
    for row in rows:
        if row.equation not in lists:
            name = "eq_" + "_".join(part.strip("().,") for part in row.equation.split()[1:])
            lists[row.equation] = pyo.ConstraintList(doc=row.equation)
            model.rows.add_component(name, lists[row.equation])
        expression = _linear([model.z[i] for i in row.index], row.weight)
        lower = None if np.isneginf(row.lower) else row.lower
        upper = None if np.isposinf(row.upper) else row.upper
        lists[row.equation].add((lower, expression, upper))


def _add_disjunctions(
    model: Any,
    disjunctions: Sequence[Disjunction],
    low: FloatArray,
    high: FloatArray,
    big_m: float | None,
) -> None:
    model.separations = pyo.ConstraintList(doc="the four rows of eq. (5), (6)")
    model.choices = pyo.ConstraintList(doc="one option of eq. (5), (6) holds")
    least, most = np.append(low, 0.0), np.append(high, 0.0)
    for d, disjunction in enumerate(disjunctions):
        for o, option in enumerate(disjunction.options):
            slack = option.gap - float(least[option.larger] - most[option.smaller])
            sides = [(option.larger, 1.0), (option.smaller, -1.0)]
            variables = [model.z[i] for i, _ in sides if i != CONSTANT]
            weights = [w for i, w in sides if i != CONSTANT]
            m = big_m if big_m is not None else max(slack, 0.0)
            expression = _linear([*variables, model.delta[d, o]], [*weights, m])
            model.separations.add(expression >= option.gap)
        deltas = [model.delta[d, o] for o in range(len(disjunction.options))]
        open_options = _linear(deltas, [1.0] * len(deltas))
        if big_m is None:
            model.choices.add(open_options == len(deltas) - 1)  # sum (1 - delta) = 1
        else:
            model.choices.add(open_options <= len(deltas) - 1)  # as printed: at most 3 of 4


def chosen_options(problem: CorridorProblem, z: FloatArray) -> list[int]:
    """Return the option of each disjunction that z meets best."""
    if not problem.disjunctions:
        return []
    return [int(best) for best in OptionTable.of(problem.disjunctions).slack(z).argmax(axis=1)]


def option_rows(problem: CorridorProblem, choice: Sequence[int]) -> list[Row]:
    """Rows that enforce one option of each disjunction."""
    rows = []
    for disjunction, chosen in zip(problem.disjunctions, choice, strict=True):
        option = disjunction.options[chosen]
        sides = [(option.larger, 1.0), (option.smaller, -1.0)]
        index = tuple(i for i, _ in sides if i != CONSTANT)
        weight = tuple(w for i, w in sides if i != CONSTANT)
        rows.append(Row(disjunction.equation, index, weight, option.gap, np.inf))
    return rows
