"""Arrays: float64 and read-only."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def read_only(values: ArrayLike, columns: int | None = None) -> FloatArray:
    """Copy values into a read-only float64 array, of shape (n, columns) where columns is given."""
    array = np.array(values, dtype=np.float64)
    if columns is not None:
        array = array.reshape(-1, columns)
    array.setflags(write=False)
    return array
