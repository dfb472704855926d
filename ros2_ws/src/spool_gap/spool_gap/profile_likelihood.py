"""Profile likelihood of one number: its values, how far the likelihood falls, and the verdict in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from scipy.stats import chi2

#: Twice the fall of the log likelihood at the ends of a 95 % interval of one number (Wilks, 1938).
RISE_95 = float(chi2.ppf(0.95, 1))
IDENTIFIABLE, ONE_SIDED, TOGETHER, NOT = "identifiable", "one-sided", "only together", "not identifiable"


@dataclass(frozen=True, slots=True)
class ProfileLikelihood:
    """Profile likelihood of a number.

    Attributes:
        name, unit: of the number.
        values: at which it was held, in rising order, SI, shape (n,).
        rises: of twice the negative log likelihood over its least, all other numbers fitted, shape (n,).
        best: the estimate.
        low, high: ends of its 95 % interval, ``None`` where the record sets no bound on that side.
        verdict: ``identifiable``, ``one-sided``, ``only together`` (with ``partner``), ``not identifiable``.
        partner: the number that moves most along with it, empty where none does.
        sentence: the verdict in words.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    rises: tuple[float, ...]
    best: float
    low: float | None
    high: float | None
    verdict: str
    partner: str
    sentence: str


def verdict_of(
    name: str, unit: str, values: tuple[float, ...], rises: tuple[float, ...], best: float, partner: str = ""
) -> ProfileLikelihood:
    """Return the profile with its verdict; ``values`` in rising order, with ``best`` among them."""
    low, high = _crossing(values, rises, best, -1), _crossing(values, rises, best, 1)
    own, other = name.replace("_", " "), partner.replace("_", " ")
    shown = f"{best:.4g} {unit}".removesuffix(" 1")
    if low is not None and high is not None:
        verdict = IDENTIFIABLE
        text = f"{own} is identifiable: {low:.4g} to {high:.4g} (95 %), best {shown}"
    elif low is not None or high is not None:
        verdict = ONE_SIDED
        bound = f"at least {low:.4g}" if low is not None else f"at most {high:.4g}"
        text = f"{own} is bounded on one side: {bound} (95 %); the record does not tell how much more or less"
        text += f", since {other} makes up for it" if other else ""
    elif partner:
        verdict = TOGETHER
        text = f"{own} is known only together with {other}: any change of one is made up for by the other"
    else:
        verdict = NOT
        text = f"{own} is not identifiable: the record hardly depends on it"
    return ProfileLikelihood(name, unit, values, rises, best, low, high, verdict, partner, text)


def _crossing(values: tuple[float, ...], rises: tuple[float, ...], best: float, side: int) -> float | None:
    """Return where the profile first crosses ``RISE_95`` going to ``side`` of ``best``, interpolated."""
    points = sorted(zip(values, rises, strict=True), reverse=side < 0)
    walk = [(value, rise) for value, rise in points if (value - best) * side >= 0.0]
    for (near, below), (far, above) in pairwise(walk):
        if below < RISE_95 <= above:
            # The root of a rise is nearly linear.
            inner = math.sqrt(max(below, 0.0))
            return near + (math.sqrt(RISE_95) - inner) / (math.sqrt(above) - inner) * (far - near)
    return None
