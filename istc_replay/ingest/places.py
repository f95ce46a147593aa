"""Positions on the Earth as metres of a local frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.problems import Problems

Floats = NDArray[np.float64]

#: WGS 84: semi-major axis [m] and square of the first eccentricity.
_A_M = 6_378_137.0
_E2 = 6.694_379_990_141_317e-3
#: Beyond this distance from the origin the frame bends too much to be a plane [m].
_FAR_M = 20_000.0


class LocalFrame:
    """The plane that touches WGS 84 at the first position of the log: x east, y north."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems
        self._origin: tuple[float, float] | None = None

    def metres(
        self, latitude_deg: Floats, longitude_deg: Floats, valid: NDArray[np.bool_]
    ) -> tuple[Floats, Floats]:
        """Convert positions at the height of the ellipsoid to x and y [m]; all arrays (n,).

        The point is turned from Earth-centred coordinates into the east-north-up frame of the
        origin, so distances near it are true to the square of their share of the Earth's radius.
        """
        if self._origin is None:
            first = np.flatnonzero(valid)
            if not len(first):
                return np.zeros(len(valid)), np.zeros(len(valid))
            self._origin = float(latitude_deg[first[0]]), float(longitude_deg[first[0]])
            lat, lon = self._origin
            detail = (
                f"positions are metres east and north of latitude {lat:.9f}, longitude {lon:.9f} (WGS 84)"
            )
            self._problems.add("local_origin", detail)
        lat_0, lon_0 = np.radians(self._origin)
        with np.errstate(invalid="ignore"):
            delta = _earth(np.radians(latitude_deg), np.radians(longitude_deg)) - _earth(
                np.array([lat_0]), np.array([lon_0])
            )
            east = -np.sin(lon_0) * delta[0] + np.cos(lon_0) * delta[1]
            away = np.cos(lon_0) * delta[0] + np.sin(lon_0) * delta[1]
            north = -np.sin(lat_0) * away + np.cos(lat_0) * delta[2]
            far = int((valid & (np.hypot(east, north) > _FAR_M)).sum())
        if far:
            detail = f"a position is more than {_FAR_M / 1000:.0f} km from the origin: the plane bends there"
            self._problems.add("far_from_origin", detail, times=far)
        return east, north


def _earth(latitude_rad: Floats, longitude_rad: Floats) -> NDArray[np.float64]:
    """Earth-centred coordinates of points of the ellipsoid, shape (3, n) [m]."""
    radius = _A_M / np.sqrt(1.0 - _E2 * np.sin(latitude_rad) ** 2)
    return np.stack(
        [
            radius * np.cos(latitude_rad) * np.cos(longitude_rad),
            radius * np.cos(latitude_rad) * np.sin(longitude_rad),
            radius * (1.0 - _E2) * np.sin(latitude_rad),
        ]
    )
