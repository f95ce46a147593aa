"""The ground of a window, and how high a second stands on it in the (x, y, t) view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray
from istc_replay.export.rerun.spans import Span
from istc_replay.geometry import rotate

_TOWER = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The rectangle that a window's scene covers: centre and half sizes (2,) [m], turned by yaw_rad."""

    centre_m: FloatArray
    half_m: FloatArray
    yaw_rad: float

    def points(self, shares: ArrayLike, out_m: float = 0.0) -> FloatArray:
        """Points (P, 2) at shares (P, 2) of the half sizes, each moved out by `out_m` more."""
        across = np.asarray(shares, dtype=np.float64)
        return rotate(across * (self.half_m + out_m), self.yaw_rad) + self.centre_m


def tower_shares(spans: tuple[Span, ...], grounds: dict[int, Ground]) -> list[float]:
    """By window the height of a second that makes its tower 0.4 of the mean side of its ground [m]."""
    sides = [2.0 * float(np.sqrt(grounds[span.index].half_m.prod())) for span in spans]
    return [_TOWER * side / span.duration_s for side, span in zip(sides, spans, strict=True)]


def height_of_second(shares: list[float]) -> float:
    """A second's height [m]: that of the middle window's tower, with two digits, so that it can be read."""
    return float(f"{np.median(shares):.1e}") if shares else 1.0
