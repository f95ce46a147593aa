"""One window's plan, cut into pieces of time and re-integrated: what every check looks at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from istc_replay.config import Config
from istc_replay.datatypes import Certificate, FloatArray, MapBounds, StaticScene, Verdict
from istc_replay.safety.motion import Motion, integrate
from istc_replay.safety.plan import Boxes, IntArray, WrittenPlan
from istc_replay.safety.recorded import Track
from istc_replay.safety.sweep import Least
from istc_replay.units import NS_PER_S

#: The re-integration may add this share of the tolerance to a distance.
_INTEGRATION_SHARE = 0.1
#: Vehicles x pieces, and obstacles x pieces, that are judged at once.
_MOST_PIECES = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A plan with its cubes and obstacles spread over the P pieces, and its motion.

    `walls_m` (C, P, 4) and `units` (C, P) of the vehicles `walled`, NaN and -1 where absent;
    `obstacles_m` (O, P, 4); `motion` of the vehicles `driven`, of which those `judged` can be
    relied on. `walled_row` (V,) gives the row in `walls_m` of each driven vehicle.
    """

    plan: WrittenPlan
    config: Config
    tracks: Mapping[str, Track]
    scene: StaticScene
    edges_ns: IntArray
    walled: tuple[str, ...]
    walls_m: FloatArray
    units: IntArray
    obstacles_m: FloatArray
    driven: tuple[str, ...]
    walled_row: IntArray
    motion: Motion

    @property
    def bounds(self) -> MapBounds | None:
        """The map's bounds."""
        return self.scene.bounds

    @property
    def unwalled(self) -> tuple[str, ...]:
        """Vehicles whose corridor cannot be judged."""
        return tuple(name for name in self.plan.vehicles if name not in self.walled)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Vehicles whose motion cannot be judged."""
        judged = [self.driven[row] for row in np.nonzero(self.motion.judged)[0]]
        return tuple(name for name in self.plan.vehicles if name not in judged)

    @property
    def misplaced(self) -> tuple[str, ...]:
        """Obstacles that cannot be judged."""
        return tuple(fault.vehicle_id for fault in self.plan.obstacle_faults)

    def seconds(self, piece: int) -> float:
        """When a piece starts [s from the window's start]."""
        return float(self.edges_ns[piece]) / NS_PER_S


def build_case(
    plan: WrittenPlan, tracks: Mapping[str, Track], scene: StaticScene, config: Config
) -> Case | None:
    """Cut a written plan into pieces and integrate it; None where it is too large to judge."""
    times = [cubes.spans_ns.ravel() for cubes in plan.cubes.values()]
    times += [vehicle.knots_ns for vehicle in plan.plans.values()]
    edges = np.unique(np.concatenate(times)) if times else np.zeros(1, dtype=np.int64)
    inner = [boxes.spans_ns.ravel() for boxes in plan.obstacles.values()]
    if inner:
        cuts = np.concatenate(inner)
        edges = np.union1d(edges, cuts[(cuts > edges[0]) & (cuts < edges[-1])])
    if (edges.size - 1) * max(len(plan.vehicles), len(plan.obstacles)) > _MOST_PIECES:
        return None
    walls, units = _over_pieces(plan.cubes.values(), edges)
    obstacles, _ = _over_pieces(plan.obstacles.values(), edges)
    tolerance_m = _INTEGRATION_SHARE * config.certificate.tolerance_m
    motion = integrate(list(plan.plans.values()), edges, config.certificate.step_s, tolerance_m)
    if motion is None:
        return None
    walled, driven = tuple(plan.cubes), tuple(plan.plans)
    return Case(
        plan=plan,
        config=config,
        tracks=tracks,
        scene=scene,
        edges_ns=edges,
        walled=walled,
        walls_m=walls,
        units=units,
        obstacles_m=obstacles,
        driven=driven,
        walled_row=np.array([walled.index(name) for name in driven], dtype=np.int64),
        motion=motion,
    )


def _over_pieces(bodies: Iterable[Boxes], edges_ns: IntArray) -> tuple[FloatArray, IntArray]:
    """Spread boxes over pieces: walls (B, P, 4), NaN where absent, and units (B, P), -1 there."""
    listed = list(bodies)
    walls = np.full((len(listed), edges_ns.size - 1, 4), np.nan)
    units = np.full(walls.shape[:2], -1, dtype=np.int64)
    for row, boxes in enumerate(listed):
        begins = np.searchsorted(edges_ns, boxes.spans_ns[:, 0])
        ends = np.searchsorted(edges_ns, boxes.spans_ns[:, 1])
        for begin, end, walls_m, unit in zip(begins, ends, boxes.walls_m, boxes.units, strict=True):
            walls[row, begin:end], units[row, begin:end] = walls_m, unit
    return walls, units


def certificate_of(
    case: Case,
    check: str,
    least: Least,
    *,
    vehicles: tuple[str, ...],
    detail: str,
    unjudged: tuple[str, ...] = (),
    allowed: float = 0.0,
    strict: bool = False,
    unit: str = "m",
) -> Certificate:
    """Turn a least margin into a certificate.

    The check fails where the margin found is below -allowed (strict: not above it), and passes
    only where the margin proven is not, and everything was judged. What is neither is
    inconclusive. Where there was nothing to look at, the check is not applicable.

    Parameters
    ----------
    case : Case
        The plan that is judged.
    check : str
        Name of the check.
    least : Least
        The least margins found and proven.
    vehicles, detail : tuple of str, str
        Whom the check is about, and what is said of the least margin.
    unjudged : tuple of str
        Who could not be judged.
    allowed : float
        Rounding allowed, in `unit`.
    strict : bool
        Whether a margin of -allowed itself fails.
    unit : str
        Unit of the margins.
    """
    below, above = (np.less_equal, np.greater) if strict else (np.less, np.greater_equal)
    window = case.plan.index
    if below(least.found, -allowed):
        verdict = Verdict.FAIL
    elif unjudged:
        return Certificate(
            window,
            check,
            Verdict.INCONCLUSIVE,
            None,
            unit,
            None,
            unjudged,
            f"not judged: {listing(unjudged)}",
        )
    elif least == Least():
        return Certificate(window, check, Verdict.NOT_APPLICABLE, None, unit)
    elif above(least.proven, -allowed):
        verdict = Verdict.PASS
    else:
        verdict, detail = Verdict.INCONCLUSIVE, f"cannot be decided: {detail}"
    margin = least.found if np.isfinite(least.found) else None
    return Certificate(window, check, verdict, margin, unit, least.time_s, vehicles, detail)


def listing(names: tuple[str, ...]) -> str:
    """Names in one line, the first five."""
    return ", ".join(repr(name) for name in names[:5]) + (", ..." if len(names) > 5 else "")
