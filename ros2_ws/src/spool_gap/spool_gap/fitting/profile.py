"""Profile likelihood of the numbers that were named, and what it says of them in words.

A number is held at values around its estimate, and all others are fitted anew. Twice the fall of the log
likelihood crosses 3.84 at both ends of the 95 % interval of a number that the record determines; where it
stays below, the record bounds the number on one side, or on none.

Sources: A. Raue and others, Structural and practical identifiability analysis of partially observed dynamical
models by exploiting the profile likelihood, Bioinformatics 25, 2009; S. Murphy and A. van der Vaart, On
profile likelihood, JASA 95, 2000.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from spool_estimator.identification.least_squares import Unknown

from spool_gap.profile_likelihood import RISE_95, ProfileLikelihood, verdict_of
from spool_gap.simulation.point import Point

from .descent import Fitted, descend
from .hypothesis import Fitting, Hypothesis

#: Standard deviations at which a number is held, until the likelihood has fallen enough: the first four show
#: a parabola where there is one, the last a number that is hardly bounded.
STEPS = (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)
#: Rounds of each refit, which starts where the last one ended.
ROUNDS = 6
#: Fall at which a side ends.
FAR_ENOUGH = 1.5 * RISE_95


def profiles_of(
    fitting: Fitting,
    hypothesis: Hypothesis,
    numbers: Fitted,
    names: Sequence[str],
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[ProfileLikelihood, ...]:
    """Return the profiles of the fitted numbers ``names`` of ``hypothesis``.

    Args:
        fitting: the problem that was solved for it.
        hypothesis: the selected one.
        numbers: its final numbers, whose deviations count coloured residuals, too: a profile is scaled so
            that near its lowest point it agrees with them.
        names: of fitted numbers.
        progress: takes the share that is done.
    """
    own = fitting.polished(hypothesis).fitted
    wanted = [free for free in own.free if free.name in names]
    found = []
    for count, free in enumerate(wanted):
        progress(count / len(wanted))
        if own.deviations.get(free.name, 0.0) > 0.0:
            found.append(_profile(fitting, own, numbers, free))
    return tuple(found)


def _profile(fitting: Fitting, own: Fitted, numbers: Fitted, free: Unknown) -> ProfileLikelihood:
    counted = max(numbers.deviations.get(free.name, 0.0) / own.deviations[free.name], 1.0)
    scale = max(1.0, own.squares / _samples(fitting)) * counted**2
    best, deviation = own.point.get(free.name), own.deviations[free.name] * counted
    values, rises = [best], [0.0]
    ends: dict[float, Point] = {}
    for side in (-1.0, 1.0):
        for value, rise, point in _side(fitting, own, free, side * deviation):
            values.append(value)
            rises.append(rise / scale)
            ends[side] = point
            if rises[-1] > FAR_ENOUGH:
                break
    order = sorted(range(len(values)), key=lambda place: values[place])
    values, rises = [values[place] for place in order], [rises[place] for place in order]
    partner = _partner(own, free, ends)
    return verdict_of(free.name, free.unit, tuple(values), tuple(rises), best, partner)


def _samples(fitting: Fitting) -> int:
    return sum(row.size for row in fitting.simulation.measured(fitting.simulation.training))


def _side(fitting: Fitting, own: Fitted, free: Unknown, step: float) -> Iterator[tuple[float, float, Point]]:
    """Yield value, rise of the sum of squares and numbers, from the estimate outwards by ``step``."""
    others = [other for other in own.free if other.name != free.name]
    point, best = own.point, own.point.get(free.name)
    for multiple in STEPS:
        value = min(max(best + multiple * step, free.low), free.high)
        held = point.moved([free.name], [value])
        fitted = descend(fitting.simulation, [held], others, rounds=ROUNDS)
        point = fitted.point
        yield value, fitted.squares - own.squares, point
        if value in (free.low, free.high):
            return


def _partner(own: Fitted, free: Unknown, ends: dict[float, Point]) -> str:
    """Return the number that moves farthest along the profile, in its own deviations, if one does."""
    moved = {
        other.name: max(
            (abs(end.get(other.name) - own.point.get(other.name)) for end in ends.values()), default=0.0
        )
        / own.deviations[other.name]
        for other in own.free
        if other.name != free.name and own.deviations.get(other.name, 0.0) > 0.0
    }
    name = max(moved, key=lambda one: moved[one], default="")
    return name if name and math.isfinite(moved[name]) and moved[name] > 1.0 else ""
