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

from istc_replay.corridors.problem import CONSTANT, extended
from istc_replay.datatypes import FloatArray, read_only

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import CorridorProblem, Rows, Separations


@dataclass(slots=True)
class MilpModel:
    """The outer approximation as a Pyomo model: z, a binary an option, squares above tangents.

    `delta[d, o]` = 0 enforces option o of separation d, as in the paper.
    """

    problem: CorridorProblem
    separations: Separations
    model: Any
    tangents: list[tuple[int, float]] = field(default_factory=list)

    @property
    def binaries(self) -> int:
        """Number of binary variables."""
        return len(self.model.delta)

    def set_start(self, z: FloatArray) -> None:
        """Make z, with the options it meets best, the MIP start."""
        best = self.separations.best(z)
        for (d, o), variable in self.model.delta.items():
            variable.set_value(0 if o == best[d] else 1, skip_validation=True)

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
        expression = linear_sum([model.square[index], model.z[index]], [1.0, -2.0 * offset])
        model.tangents.add(expression >= -2.0 * offset * reference - offset**2)
        self.tangents.append((index, offset))

    def solution(self) -> FloatArray:
        """Values of z."""
        return read_only([self.model.z[index].value for index in range(self.problem.size)])


def build_milp(problem: CorridorProblem, *, big_m: float | None = None) -> MilpModel:
    """Write the problem as a Pyomo model, without tangents yet.

    Parameters
    ----------
    problem : CorridorProblem
        What to solve.
    big_m : float, optional
        One M for all rows, as printed; otherwise the least that the bounds allow, row by row.
    """
    model = pyo.ConcreteModel("interactive spatio-temporal corridors")
    add_variables(model, range(problem.size), problem.lower, problem.upper)
    quadratic = np.flatnonzero(problem.quadratic)
    model.square = pyo.Var(quadratic.tolist(), within=pyo.NonNegativeReals, doc="squares of eq. (3)")
    _add_rows(model, problem.rows)
    add_separations(model, problem.separations, problem.lower, problem.upper, big_m)
    model.tangents = pyo.ConstraintList(doc="outer approximation of the squares of eq. (3)")
    linear = np.flatnonzero(problem.linear)
    model.objective = pyo.Objective(
        expr=linear_sum(
            [model.z[i] for i in linear.tolist()] + [model.square[i] for i in quadratic.tolist()],
            [*problem.linear[linear].tolist(), *problem.quadratic[quadratic].tolist()],
        ),
        doc="eq. (4)",
    )
    return MilpModel(problem, problem.separations, model)


def linear_sum(variables: Sequence[Any], weights: Sequence[float]) -> Any:
    """The weighted sum of Pyomo variables, as one expression."""
    return LinearExpression(constant=0, linear_coefs=list(weights), linear_vars=list(variables))


def add_variables(model: Any, indices: Sequence[int], lower: FloatArray, upper: FloatArray) -> None:
    """Declare the variables z at some indices, within their bounds [m]."""
    model.z = pyo.Var(indices, bounds=lambda _, i: (float(lower[i]), float(upper[i])), doc="eq. (1)")


def _add_rows(model: Any, rows: Rows) -> None:
    model.rows = pyo.Block(doc="the equations that always hold, a list an equation")
    lists: dict[str, Any] = {}
    names = [name for name, count in rows.families for _ in range(count)]
    variables = dict(model.z.items())
    columns = (c.tolist() for c in (rows.index, rows.weight, rows.lower, rows.upper))
    for equation, index, weight, lower, upper in zip(names, *columns, strict=True):
        if equation not in lists:
            name = "eq_" + "_".join(part.strip("().,") for part in equation.split()[1:])
            lists[equation] = pyo.ConstraintList(doc=equation)
            model.rows.add_component(name, lists[equation])
        terms = [(variables[i], w) for i, w in zip(index, weight, strict=True) if w != 0.0]
        expression = linear_sum([v for v, _ in terms], [w for _, w in terms])
        lists[equation].add(
            (None if lower == -np.inf else lower, expression, None if upper == np.inf else upper)
        )


def add_separations(
    model: Any, separations: Separations, lower: FloatArray, upper: FloatArray, big_m: float | None
) -> None:
    """Declare eq. (5) and (6): four rows a separation, of which a binary says which one holds.

    Parameters
    ----------
    model : pyomo.environ.ConcreteModel
        Has its variables z.
    separations : Separations
        What to keep apart, by which options.
    lower, upper : (n,) arrays
        Bounds of z [m], from which the least M of each row follows.
    big_m : float, optional
        One M for all rows [m], as printed.
    """
    possible = separations.possible
    pairs = [(int(d), int(o)) for d, o in np.argwhere(possible)]
    model.delta = pyo.Var(pairs, within=pyo.Binary, doc="delta of eq. (5), (6)")
    model.separations = pyo.ConstraintList(doc="the four rows of eq. (5), (6)")
    model.choices = pyo.ConstraintList(doc="one option of eq. (5), (6) holds")
    least, most = extended(lower), extended(upper)
    slack = separations.gap - (least[separations.larger] - most[separations.smaller])
    for d, o in pairs:
        larger, smaller = int(separations.larger[d, o]), int(separations.smaller[d, o])
        sides = [(model.z[i], w) for i, w in ((larger, 1.0), (smaller, -1.0)) if i != CONSTANT]
        m = big_m if big_m is not None else max(float(slack[d, o]), 0.0)
        expression = linear_sum([*(v for v, _ in sides), model.delta[d, o]], [*(w for _, w in sides), m])
        model.separations.add(expression >= float(separations.gap[d, o]))
    for d in range(len(separations)):
        deltas = [model.delta[d, int(o)] for o in np.flatnonzero(possible[d])]
        open_options = linear_sum(deltas, [1.0] * len(deltas))
        if big_m is None:
            model.choices.add(open_options == len(deltas) - 1)  # sum (1 - delta) = 1
        else:
            model.choices.add(open_options <= len(deltas) - 1)  # as printed: at most 3 of 4
