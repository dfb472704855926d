"""Change test: generalised likelihood ratio of a step or a ramp against a wandering level.

The level is a random walk seen in noise (local-level model, Durbin and Koopman 2012, chapter 2), with a slope
on the oil temperature that the sisters make known, and a step of unknown height at each service. Which week a
step or a ramp began is found by maximum likelihood (Basseville and Nikiforov 1993, chapter 2.4.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from .sisters import Scatter, own_noise
from .weekly import BIN, Weekly, week_of

Array = NDArray[np.float64]

#: Days of a month.
MONTH = 30.44
#: Weeks with data that a judgement needs: fewer leave no scatter to compare with.
LEAST_WEEKS = 5
#: False findings that are accepted, per valve and year, over all parameters.
FALSE_RATE = 0.01
#: Independent tests that weekly judgements of a year amount to: of 1200 simulated years of white noise as
#: many exceeded a score of 4 once as of so many normal numbers.
TESTS = 200.0
#: Weeks, and the median of the likeliest change's score in white noise of known variance (400 simulations).
CHANCE_SCORES = ((5.0, 1.23), (12.0, 1.55), (20.0, 1.69), (52.0, 1.91))
#: Weeks that a change has to last before it is believed, and weeks before a step: one odd week is none.
LEAST_LASTING, LEAST_BEFORE = 3, 4
#: Variance of a week's value at least, in the logarithm: an analogue input of 16 bit resolves 1e-5.
LEAST_VARIANCE = 1e-10


@dataclass(frozen=True, slots=True)
class Change:
    """Change that the test finds most likely, in the logarithm.

    Attributes:
        week: since which.
        ramp: whether it grows, else it is a step.
        size, deviation: until the last week.
        rate, rate_deviation: per month, of a ramp; NaN for a step.
        level, level_deviation: before it.
        score: its size in standard deviations of what chance does.
        threshold: of the score.
        weeks: with data.
    """

    week: int
    ramp: bool
    size: float
    deviation: float
    rate: float
    rate_deviation: float
    level: float
    level_deviation: float
    score: float
    threshold: float
    weeks: int


def score_threshold(parameters: int, freedom: float) -> float:
    """Return the score that chance exceeds at the accepted rate.

    Student's distribution with the degrees of ``freedom`` of the scatter allows for its being an estimate.
    """
    chance = FALSE_RATE / (parameters * TESTS)
    return float(stats.t.isf(0.5 * chance, max(3.0, freedom)))


def chance_score(weeks: int) -> float:
    """Return the median of the score that chance alone gives in so many weeks."""
    numbers, medians = np.array(CHANCE_SCORES).T
    return float(np.interp(np.log(weeks), np.log(numbers), medians))


def likeliest_change(
    valve: Weekly,
    scatter: Scatter,
    services: Sequence[float],
    parameters: int,
    *,
    ramps: bool = True,
) -> Change | None:
    """Return the likeliest change in the weekly values of a valve, ``None`` where the weeks are too few.

    Args:
        valve: its weekly values, less what it is compared with.
        scatter: of the fleet.
        services: days at which its level may have stepped.
        parameters: how many are tested, for the threshold.
        ramps: whether a change may grow.
    """
    if valve.week.size < LEAST_WEEKS:
        return None
    noise, freedom = own_noise(valve, scatter)
    weeks = valve.week.astype(np.float64)
    known = np.isfinite(valve.temperature)
    middle = float(np.median(valve.temperature[known])) if known.any() else 0.0
    warm = np.where(known, valve.temperature - middle, 0.0)
    begun = weeks - weeks[0]
    covariance = np.diag(noise + LEAST_VARIANCE) + scatter.wander * np.minimum.outer(begun, begun)
    covariance += scatter.slope_spread**2 * np.outer(warm, warm)
    steps = [valve.week >= week_of(day) for day in services]
    base = [np.ones(weeks.size), *(step.astype(float) for step in steps if 0 < step.sum() < weeks.size)]
    factor = linalg.cholesky(covariance, lower=True)
    white = linalg.solve_triangular(factor, np.column_stack([*base, valve.value]), lower=True)
    known_columns, row = white[:, :-1], white[:, -1]
    orthogonal, _ = np.linalg.qr(known_columns)
    row = row - orthogonal @ (orthogonal.T @ row)
    shapes = [one for one in _shapes(weeks) if ramps or not one[1]]
    if not shapes:
        return None
    columns = linalg.solve_triangular(factor, np.column_stack([shape for _, _, shape in shapes]), lower=True)
    columns -= orthogonal @ (orthogonal.T @ columns)
    power = np.einsum("ij,ij->j", columns, columns)
    usable = power > 1e-9 * power.max()
    score = np.where(usable, (columns.T @ row) / np.sqrt(np.where(usable, power, 1.0)), 0.0)
    best = int(np.argmax(np.abs(score)))
    week, ramp, shape = shapes[best]
    amplitude, deviation = float(score[best] / np.sqrt(power[best])), float(1.0 / np.sqrt(power[best]))
    reach = float(shape[-1])
    level = np.linalg.lstsq(
        np.column_stack([known_columns, linalg.solve_triangular(factor, shape, lower=True)]), white[:, -1],
        rcond=None,
    )[0]  # fmt: skip
    months = BIN / MONTH
    return Change(
        week,
        ramp,
        amplitude * reach,
        deviation * reach,
        amplitude / months if ramp else float("nan"),
        deviation / months if ramp else float("nan"),
        float(level[0]),
        float(np.sqrt(noise.mean() / max(1.0, float((weeks < week).sum())))),
        float(abs(score[best])),
        score_threshold(parameters, freedom),
        int(weeks.size),
    )


def _shapes(weeks: Array) -> list[tuple[int, bool, Array]]:
    """Return the candidate changes: the week they begin in, whether they are ramps, their course (n,)."""
    found: list[tuple[int, bool, Array]] = []
    for number, week in enumerate(weeks.tolist()):
        if weeks.size - number < LEAST_LASTING:
            break
        if number >= LEAST_BEFORE:
            found.append((int(week), False, (weeks >= week).astype(float)))
        ramp = np.maximum(0.0, weeks - week)
        if np.count_nonzero(ramp) >= LEAST_LASTING:
            found.append((int(week), True, ramp))
    return found
