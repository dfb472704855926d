"""Detection limit: the size at which a test that knows what is hidden finds it in half of the records."""

from __future__ import annotations

import math

from .case import BlindCase, make
from .nested_friction import contains_coulomb_friction, over_coulomb_friction

#: Over the size that is drawn as clear.
SMALLEST, LARGEST = 1e-4, 2.0
#: Evidence at the limit is within this of the threshold, relative; so many cases are made at most.
CLOSE, MOST = 0.1, 14


def limit_case(seed: int, hidden: str, *, moderate: bool = False) -> BlindCase | None:
    """Return the case of ``seed`` at the size at which the evidence is at the threshold.

    The test knows what is hidden and the noise, and base, gain and delay are refitted with it: the most
    powerful one at its rate of false alarms (Neyman and Pearson 1933), as a mean over the noise. A single
    record may be named below it.
    A law of friction that contains Coulomb friction must be distinguished from that, too.

    Args:
        seed: of the condition and of the size that ``BlindCase.factor`` is relative to.
        hidden: an effect.
        moderate: under a moderate condition, see ``condition.draw_condition``.

    Returns:
        ``None`` where even the largest size is not seen.
    """
    low, high = math.log(SMALLEST), math.log(LARGEST)
    best = make(seed, hidden, factor=LARGEST, moderate=moderate)
    above = _over_threshold(best)
    if above < 0.0:
        return None
    guess = high - 0.5 * above
    for _ in range(MOST):
        if abs(above) < CLOSE or high - low < 0.02:
            break
        # Evidence grows with the square of a small size; where it does not, the bracket is halved.
        middle = guess if low < guess < high else 0.5 * (low + high)
        case = make(seed, hidden, factor=math.exp(middle), moderate=moderate)
        above = _over_threshold(case)
        if above >= 0.0 or abs(above) < CLOSE:
            best = case
        if above >= 0.0:
            high = middle
        else:
            low = middle
        guess = middle - 0.5 * above
    return best


def _over_threshold(case: BlindCase) -> float:
    """Return the logarithm of the evidence over the threshold."""
    evidence = 0.0 if case.visibility is None else case.visibility.evidence
    if evidence > case.threshold and contains_coulomb_friction(case):
        evidence = min(evidence, over_coulomb_friction(case))
    return math.log(max(evidence, 1e-12) / case.threshold)
