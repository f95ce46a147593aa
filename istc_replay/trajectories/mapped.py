"""NLPs over the knots of one bicycle, as expressions: one knot's, differentiated once and mapped over all.

Rows and costs concern single knots and meet only in the states that an interval leads to. So the
Lagrangian's Hessian is block-diagonal, and building an NLP costs the same for any number of knots.
Variables are the states (6) and controls (2) of a knot after each other, then the last states, then slacks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from istc_replay.errors import SolveError

STATES, CONTROLS = 6, 2
KNOT = STATES + CONTROLS


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows r(knot) that hold at some knots; with `slack` (knots,), each may miss its bounds by that one.

    Rows with slack come twice: plus the slack for the bounds below, minus the slack for those above.
    """

    of: Any
    knots: range
    slack: NDArray[np.int64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The expressions (SX) of one knot: `knot` (8,), parameters of all knots and of this one.

    `end` (6,) are the states that its controls lead to. Each term of the cost is the sum of the squares of
    its residuals, over all knots.
    """

    knot: Any
    shared: Any
    own: Any
    end: Any
    residuals: tuple[Any, ...]
    rows: tuple[Rows, ...]

    @property
    def costs(self) -> Any:
        """(c,) the terms of the cost at this knot."""
        return ca.vertcat(*(ca.sumsqr(part) for part in self.residuals))


class Mapped:
    """The NLP's expressions (MX), and its derivatives from those of one knot."""

    def __init__(self, model: Model, intervals: int, slacks: int, price: float) -> None:
        self._model, self._n = model, intervals
        n, shared, own = intervals, model.shared.numel(), model.own.numel()
        self.size = KNOT * n + STATES + slacks
        self.x, self.p = ca.MX.sym("x", self.size), ca.MX.sym("p", shared + own * (n + 1))
        padded = ca.vertcat(self.x[: KNOT * n + STATES], np.zeros(CONTROLS))
        self._knots = ca.reshape(padded, KNOT, n + 1)
        self._slack = self.x[KNOT * n + STATES :]
        # Inputs of every function of a knot, and their values at all knots.
        self._symbols = [model.knot, model.shared, model.own]
        self._inputs = [
            self._knots,
            ca.repmat(self.p[:shared], 1, n + 1),
            ca.reshape(self.p[shared:], own, n + 1),
        ]
        self._price = price
        self.costs = ca.sum2(self._mapped([model.costs], range(n + 1))[0])
        self.objective = ca.sum1(self.costs) + price * ca.sum1(self._slack)
        ends = self._mapped([model.end], range(n))[0]
        self.values = self._stacked(ends, [self._mapped([rows.of], rows.knots)[0] for rows in model.rows])

    def _mapped(self, of: list[Any], knots: range, extra: tuple[Any, ...] = (), given: Any = ()) -> Any:
        """Expressions of a knot at some knots, (size, knots) each; `extra` symbols are worth `given`."""
        function = ca.Function("knot", [*self._symbols, *extra], of, {"cse": True})
        columns = slice(knots.start, knots.stop)
        return function.map(len(knots)).call([*(value[:, columns] for value in self._inputs), *given])

    def _stacked(self, ends: Any, rows: list[Any]) -> Any:
        """All rows: the states at the intervals' ends, then each kind."""
        parts = [ca.vec(ends - self._knots[:STATES, 1:])]
        for kind, values in zip(self._model.rows, rows, strict=True):
            if kind.slack is None:
                parts.append(ca.vec(values))
                continue
            give = ca.reshape(self._slack[kind.slack.tolist()], 1, len(kind.slack))
            give = ca.repmat(give, values.size1(), 1)
            parts += [ca.vec(values + give), ca.vec(values - give)]
        return ca.vertcat(*parts)

    def derivatives(self) -> dict[str, Any]:
        """Gradient, Jacobian and Hessian for IPOPT."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.values.numel())
        return {
            "grad_f": ca.Function("grad_f", [self.x, self.p], [self.objective, self._gradient]),
            "jac_g": ca.Function("jac_g", [self.x, self.p], self._jacobian),
            "hess_lag": ca.Function(
                "hess_lag", [self.x, self.p, factor, multipliers], [self._hessian(factor, multipliers)]
            ),
            # None but IPOPT's own derivatives are wanted.
            "no_nlp_grad": True,
            "calc_lam_p": False,
        }

    def linearised(self) -> Any:
        """Function of x, p: Hessian (Gauss-Newton), gradient, rows, their Jacobian: a convex QP about x."""
        slopes: Any = ca.jacobian(ca.vertcat(*self._model.residuals), self._model.knot)
        hessian = ca.triu2symm(self._diagonal(ca.triu(2.0 * slopes.T @ slopes)))
        return ca.Function("linearised", [self.x, self.p], [hessian, self._gradient, *self._jacobian])

    @cached_property
    def _gradient(self) -> Any:
        cost = ca.sum1(self._model.costs)
        slopes = self._mapped([ca.gradient(cost, self._model.knot)], range(self._n + 1))[0]
        slacks = self._slack.numel()
        return ca.vertcat(ca.vec(slopes)[: self.size - slacks], np.full(slacks, self._price))

    @cached_property
    def _jacobian(self) -> list[Any]:
        """The rows' values and their Jacobian."""
        model, n = self._model, self._n
        entries = _Entries()
        ends, slopes, at = self._differentiated(model.end, range(n))
        entries.blocks(at, slopes, STATES * np.arange(n), KNOT * np.arange(n))
        linked = np.arange(STATES)
        entries.blocks(
            (linked, linked), -np.ones(STATES * n), STATES * np.arange(n), KNOT * np.arange(1, n + 1)
        )
        top, values = STATES * n, []
        for rows in model.rows:
            count, height = len(rows.knots), rows.of.numel()
            value, slopes, at = self._differentiated(rows.of, rows.knots)
            values.append(value)
            for sign in (1.0, -1.0) if rows.slack is not None else (0.0,):
                tops = top + height * np.arange(count)
                entries.blocks(at, slopes, tops, KNOT * np.asarray(rows.knots))
                if rows.slack is not None:
                    each, one = np.arange(height), np.zeros(height, dtype=int)
                    left = KNOT * n + STATES + rows.slack
                    entries.blocks((each, one), np.full(height * count, sign), tops, left)
                top += height * count
        return [self._stacked(ends, values), entries.matrix((top, self.size))]

    def _differentiated(self, of: Any, knots: range) -> Any:
        """An expression at some knots, the nonzeros of its Jacobian, and where they stand in a block."""
        jacobian: Any = ca.jacobian(of, self._model.knot)
        value, slopes = self._mapped([of, ca.vertcat(*jacobian.nonzeros())], knots)
        return value, slopes, jacobian.sparsity().get_triplet()

    def _hessian(self, factor: Any, multipliers: Any) -> Any:
        """The upper triangle of the Hessian of factor * objective + multipliers * rows."""
        model, n = self._model, self._n
        weight = ca.SX.sym("weight")
        lagrangian = weight * ca.sum1(model.costs)
        extra, given, top = [weight], [ca.repmat(factor, 1, n + 1)], 0
        for of, knots, twice in [
            (model.end, range(n), False),
            *((rows.of, rows.knots, rows.slack is not None) for rows in model.rows),
        ]:
            height = of.numel()
            price = ca.SX.sym("price", height)
            lagrangian += ca.dot(price, of)
            part = 0.0
            for _ in range(2 if twice else 1):
                part += ca.reshape(multipliers[top : top + height * len(knots)], height, len(knots))
                top += height * len(knots)
            before, after = ca.MX.zeros(height, knots.start), ca.MX.zeros(height, n + 1 - knots.stop)
            extra.append(price)
            given.append(ca.horzcat(before, part, after))
        hessian: Any = ca.triu(ca.hessian(lagrangian, model.knot)[0])
        return self._diagonal(hessian, tuple(extra), given)

    def _diagonal(self, block: Any, extra: tuple[Any, ...] = (), given: Any = ()) -> Any:
        """The matrix that has a block of each knot on its diagonal."""
        n = self._n
        values = self._mapped([ca.vertcat(*block.nonzeros())], range(n + 1), extra, given)[0]
        entries = _Entries()
        entries.blocks(block.sparsity().get_triplet(), values, *[KNOT * np.arange(n + 1)] * 2)
        return entries.matrix((self.size, self.size), within=KNOT * n + STATES)


class _Entries:
    """Nonzeros of a matrix, put together block by block."""

    def __init__(self) -> None:
        self._rows: list[NDArray[np.int64]] = []
        self._columns: list[NDArray[np.int64]] = []
        self._values: list[Any] = []

    def blocks(self, at: Any, values: Any, tops: NDArray[np.int64], lefts: NDArray[np.int64]) -> None:
        """One block's nonzeros `at` (rows, columns) at each of several places; their values in turn."""
        rows, columns = (np.asarray(part, dtype=np.int64) for part in at)
        self._rows.append((tops[:, None] + rows).ravel())
        self._columns.append((lefts[:, None] + columns).ravel())
        self._values.append(ca.vec(values))

    def matrix(self, shape: tuple[int, int], within: int | None = None) -> Any:
        """The matrix; entries from row or column `within` on are left out."""
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        kept = np.arange(len(rows))
        if within is not None:
            kept = np.flatnonzero((rows < within) & (columns < within))
        sparsity, order = ca.Sparsity.triplet(*shape, rows[kept].tolist(), columns[kept].tolist(), False)
        if sparsity.nnz() != len(kept):
            raise SolveError("an NLP's entries overlap: please report this")
        return ca.sparsity_cast(ca.vertcat(*self._values)[kept[order].tolist()], sparsity)
