"""A bound of all vehicles from bounds of groups: a fractional packing.

Eq. (4) is a sum over vehicles. Let L(i) bound vehicle i alone, L(S) the vehicles of S alone; the excess of S,
e(S), is L(S) less the L(i) of S. In every solution the vehicles of S cost e(S) more than their L(i)
together. So with weights w(S) >= 0 that add up to at most 1 at every vehicle, all vehicles cost the sum of
w(S) e(S) more than the sum of all L(i). The best weights solve a linear program, whose dual shares the
excess out among the vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi
import numpy as np

from istc_replay.corridors.conflict_tree import Group

if TYPE_CHECKING:
    from collections.abc import Mapping

    from istc_replay.datatypes import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Packing:
    """The excess of all that groups prove, the weight of each group, and the vehicles' parts of it (V,)."""

    excess: float
    weights: Mapping[Group, float]
    parts: FloatArray


def pack(excess: Mapping[Group, float], vehicles: int) -> Packing:
    """Weigh groups so that their excesses, weighted, add up to the most.

    Parameters
    ----------
    excess : mapping
        e(S) of groups S.
    vehicles : int
        Number of all vehicles.

    Returns
    -------
    Packing
        Its excess is a bound whatever rounding the linear program's solution has.
    """
    groups = [group for group, value in excess.items() if value > 0.0]
    if not groups:
        return Packing(0.0, {}, np.zeros(vehicles))
    values = np.array([excess[group] for group in groups])
    place = [(vehicle, column) for column, group in enumerate(groups) for vehicle in sorted(group)]
    rows, columns = (list(side) for side in zip(*place, strict=True))
    matrix = casadi.DM.triplet(rows, columns, casadi.DM.ones(len(rows)), vehicles, len(groups))
    solver = casadi.conic(
        "packing",
        "piqp",
        {"h": casadi.Sparsity(len(groups), len(groups)), "a": matrix.sparsity()},
        {"error_on_fail": False, "piqp": {"eps_abs": 1e-9, "eps_rel": 1e-9}},
    )
    scale = float(values.max())
    found = solver(g=casadi.DM(-values / scale), a=matrix, lba=-np.inf, uba=1.0, lbx=0.0, ubx=np.inf)
    weights = np.nan_to_num(np.asarray(found["x"]).ravel())
    weights = np.clip(weights, 0.0, 1.0)
    load = np.zeros(vehicles)
    np.add.at(load, rows, weights[columns])
    weights = weights / max(1.0, float(load.max()))
    parts = np.maximum(np.nan_to_num(np.asarray(found["lam_a"]).ravel()), 0.0) * scale
    return Packing(float(weights @ values), dict(zip(groups, weights.tolist(), strict=True)), parts)
