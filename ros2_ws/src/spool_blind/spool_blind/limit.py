"""The limit of seeing: the size at which a test that knows what is hidden finds it in half of the records."""

from __future__ import annotations

import math

from .case import make

#: Over the size that is drawn as clear.
SMALLEST, LARGEST = 1e-5, 4.0
HALVINGS = 12


def limit_factor(seed: int, hidden: str) -> float:
    """Return the size, over the one that ``seed`` draws, at which the evidence is at the threshold.

    The test knows what is hidden, and base, gain and delay are refitted beside it: no program can do better.
    Where even the largest size is not seen, infinity.
    """
    low, high = math.log(SMALLEST), math.log(LARGEST)
    if not _seen(seed, hidden, LARGEST):
        return math.inf
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _seen(seed, hidden, math.exp(middle)):
            high = middle
        else:
            low = middle
    return math.exp(high)


def _seen(seed: int, hidden: str, factor: float) -> bool:
    case = make(seed, hidden, factor=factor)
    return case.visibility is not None and case.visibility.evidence >= case.threshold
