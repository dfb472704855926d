"""Release from rest, the same for every composition of force terms: compiled once for all of them."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled


@compiled
def release(n0: float, n1: float, n2: float, low: float, high: float) -> tuple[float, float]:
    """Return the first y in (0, 1] at which n0 + n1 y + n2 y^2 leaves [low, high] and the side, or 2."""
    first, side = 2.0, 0.0
    for sign, bound in ((-1.0, low), (1.0, high)):
        # Citardauq form in addition to the textbook one: no cancellation when the parabola is nearly a line.
        square = n1 * n1 - 4.0 * n2 * (n0 - bound)
        if square < 0.0:
            continue
        half = -0.5 * (n1 + math.copysign(math.sqrt(square), n1))
        if half != 0.0:
            y = (n0 - bound) / half
            if 0.0 <= y <= 1.0 and y < first and sign * (n1 + 2.0 * n2 * y) > 0.0:
                first, side = y, sign
        if n2 != 0.0:
            y = half / n2
            if 0.0 <= y <= 1.0 and y < first and sign * (n1 + 2.0 * n2 * y) > 0.0:
                first, side = y, sign
    return first, side
