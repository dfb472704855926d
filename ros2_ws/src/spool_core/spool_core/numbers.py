"""Types and constants of numbers that every package needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: m/s^2, standard gravity: converts g, and the weight of a mass. CGPM 1901.
GRAVITY = 9.80665

#: Standard deviations in a median absolute deviation of normal errors.
MEDIAN_TO_DEVIATION = 1.4826
