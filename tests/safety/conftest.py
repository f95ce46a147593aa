"""A good plan of three cars, which every check passes."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.datatypes import MapBounds, Result

from ..support.bicycles import random_car, stacked
from ..support.written import Scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Three wandering cars over five units, their corridors 0.3 m apart, an obstacle, bounds."""
    rng = np.random.default_rng(5)
    cars = stacked(random_car(rng, name, 25) for name in ("a", "b", "c"))
    return Scene(
        cars,
        obstacles={"wall": np.tile([-60.0, 60.0, -3.0, -0.1], (5, 1))},
        bounds=MapBounds(-100.0, 100.0, -100.0, 100.0),
    )


@pytest.fixture(scope="session")
def good(scene: Scene) -> Result:
    """Their written result."""
    return scene.result()
