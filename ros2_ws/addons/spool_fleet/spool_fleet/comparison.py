"""Tests of trends: a valve against its own past and against its sisters.

What the valves of a machine do together is the machine's: its oil, its temperature sensor, its work.

The level is a random walk seen in noise (local-level model, Durbin and Koopman 2012, chapter 2), with a slope
on the oil temperature that the sisters make known, and a step of unknown height at each service. Which week a
step or a ramp began is found by maximum likelihood (Basseville and Nikiforov 1993, chapter 2.4.3).

Each number is a median over the valves, so that some that wear do not move it; what a valve has too few data
for comes from its sisters (partial pooling, as in Gelman and Hill 2007, chapter 12).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from scipy import linalg, stats
from spool_core.numbers import Array

from spool_fleet.observations import BIN, Weekly, mean_square, spread, week_of

#: Sisters on the same machine from which their median is what the machine does, with one of them worn; the
#: same where those that are worn are known.
MATES, KNOWN_MATES = 3, 2
#: Healthy valves from which a median is the same with and without one, to a thirtieth of their scatter.
MANY = 30
#: Valves of a machine from which their median speaks for the machine.
LEAST_MEMBERS = 3
#: Share of a machine's valves that change alike from which what they share is the cause.
TOGETHER = 0.6
#: Share of the mean square over months below which a comparison is worth the noise that sisters add.
QUIETER = 0.9


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

#: Sisters from which their median is a course to compare with.
LEAST_SISTERS = 4
#: Weeks over which slow wandering is distinguished from the noise of neighbouring weeks, at least.
LAG = 8
#: 1/K: slope of the logarithm where values are referred to one temperature (the monitor's error of an oil's
#: law) and where they are not (an ISO VG 68 oil around 45 deg C, ASTM D341), each with its spread.
REFERRED_SLOPE, RAW_SLOPE = (0.0, 0.002), (-0.04, 0.015)
#: Differences that a variance needs, and the relative variance of a mean square of n of them, times n (von
#: Neumann 1941: neighbours share a value).
LEAST_DIFFERENCES, SAMPLING = 3, 3.0
#: Degrees of freedom from which the scatter within weeks tells more than that between them.
WITHIN = 10.0


@dataclass(frozen=True, slots=True)
class Compared:
    """The likeliest change of each, and of what the valves of each machine do together.

    Attributes:
        valves: ``None`` where the weeks are too few.
        found: numbers of the valves whose change chance and their sisters' scatter hardly explain.
        machines: the changes of machines that are found so.
        alone: numbers of the valves that have no sisters to be compared with.
    """

    valves: list[Change | None]
    found: set[int]
    machines: dict[str, Change]
    alone: set[int]


@dataclass(frozen=True, slots=True)
class Fleet:
    """Fleet in one parameter: weekly values of each valve, its machine, the days of its services.

    ``referred`` says whether values are referred to one oil temperature, ``None`` that they do not depend on
    it; ``parameters`` how many are tested in all.
    """

    weeks: Sequence[Weekly]
    machines: Sequence[str]
    services: Sequence[Sequence[float]]
    parameters: int
    referred: bool | None = None

    def members(self) -> dict[str, list[int]]:
        """Return the numbers of the valves of each machine."""
        found: dict[str, list[int]] = {}
        for number, name in enumerate(self.machines):
            found.setdefault(name, []).append(number)
        return found


def compare(fleet: Fleet) -> Compared:
    """Return the changes of valves and machines."""
    changes, alone = _of_valves(fleet, set(), MATES)
    found = _beyond_sisters(changes)
    if found:
        # What is found is no sister: even a median leans towards one that is far off.
        changes, alone = _of_valves(fleet, found, KNOWN_MATES)
        found = _beyond_sisters(changes)
    # The numbers of the found valves whose machine has most of its valves among them.
    together: set[int] = set()
    for own in fleet.members().values():
        for sign in (1.0, -1.0):
            alike = {
                n for n in own if n in found and (one := changes[n]) is not None and one.size * sign > 0.0
            }
            if len(alike) >= max(LEAST_MEMBERS, TOGETHER * len(own)):
                together |= alike
    machines = _of_machines(fleet, found - together)
    found -= {n for n in together if fleet.machines[n] in machines}
    return Compared(changes, found, machines, alone)


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
    valve: Weekly, scatter: Scatter, services: Sequence[float], parameters: int, *, ramps: bool = True
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


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of the healthy valves of a fleet in one parameter, in the logarithm.

    Attributes:
        noise: variance of a week's value.
        noise_spread: variance of the logarithm of that between valves.
        between: variance of a week's value beyond what the scatter of its bags explains.
        wander: variance that a week adds to the level (random walk).
        slope_spread: of the slopes on the oil temperature between valves, 1/K.
    """

    noise: float = 0.0
    noise_spread: float = math.inf
    between: float = 0.0
    wander: float = 0.0
    slope_spread: float = 0.0


def pooled_slope(valves: Sequence[Weekly], referred: bool) -> tuple[float, float]:
    """Return slope on the oil temperature, 1/K, and its spread between valves; physics where few show it."""
    found = np.array([slope for slope in map(own_slope, valves) if math.isfinite(slope)])
    expected, width = REFERRED_SLOPE if referred else RAW_SLOPE
    if found.size < LEAST_SISTERS:
        return expected, width
    return float(np.median(found)), min(width, spread(found))


def scatter_of(valves: Sequence[Weekly], slope_spread: float = 0.0) -> Scatter:
    """Return the scatter of ``valves``, whose slopes on the oil temperature differ by ``slope_spread``.

    It is that of the values: what their bags state of their uncertainty holds a part that all share.
    """
    noises, counts, betweens, wanders = [], [], [], []
    for valve in valves:
        # A constant slope is no wandering.
        flat = _flattened(valve, own_slope(valve) if slope_spread > 0.0 else 0.0)
        near, step = differences(valve, flat, 0)
        far, leap = differences(valve, flat, LAG)
        if near.size < LEAST_DIFFERENCES:
            continue
        noises.append(0.5 * mean_square(near))
        counts.append(near.size)
        if valve.freedom >= WITHIN:
            betweens.append(noises[-1] - float(np.mean(valve.bag_variance / valve.count)))
        if far.size >= LEAST_DIFFERENCES and leap > step:
            wanders.append((mean_square(far) - mean_square(near)) / (leap - step))
    if not noises:
        return Scatter(slope_spread=slope_spread)
    logarithms = np.log(np.maximum(noises, 1e-300))
    sampling = float(np.mean(SAMPLING / np.array(counts)))
    alike = len(noises) >= LEAST_SISTERS
    return Scatter(
        float(np.median(noises)),
        max(0.0, spread(logarithms) ** 2 - sampling) if alike else math.inf,
        max(0.0, float(np.median(betweens))) if betweens else 0.0,
        max(0.0, float(np.median(wanders))) if wanders else 0.0,
        slope_spread,
    )


def own_noise(valve: Weekly, scatter: Scatter) -> tuple[Array, float]:
    """Return the variance of each week's value of ``valve``, shape (n,), and its degrees of freedom."""
    near, _ = differences(valve, valve.value, 0)
    own = 0.5 * mean_square(near) if near.size >= LEAST_DIFFERENCES else 0.0
    sampling = SAMPLING / max(1, near.size)
    if valve.freedom >= WITHIN:
        noise = valve.bag_variance / valve.count + scatter.between
        # Its weeks may differ by more than its sisters' do.
        surely = own * max(0.0, 1.0 - 2.0 * math.sqrt(sampling))
        return noise * max(1.0, surely / float(np.mean(noise))), valve.freedom
    if near.size < LEAST_DIFFERENCES or scatter.noise <= 0.0:
        return np.full(valve.value.size, scatter.noise), 1.0
    weight = 1.0
    if math.isfinite(scatter.noise_spread):
        weight = scatter.noise_spread / (scatter.noise_spread + sampling)
    logarithm = weight * math.log(max(own, 1e-300)) + (1.0 - weight) * math.log(scatter.noise)
    return np.full(valve.value.size, math.exp(logarithm)), 2.0 / max(weight * sampling, 1e-3)


def common_course(valves: Sequence[Weekly], least: int = LEAST_SISTERS) -> dict[int, float]:
    """Return the course that ``valves`` share, by week.

    It is the median of their values, each less its own level since its last service; weeks with fewer than
    ``least`` valves have none.
    """
    courses: dict[int, list[float]] = {}
    for valve in valves:
        for segment in np.unique(valve.segment):
            own = valve.segment == segment
            around = valve.value[own] - np.median(valve.value[own])
            for week, value in zip(valve.week[own].tolist(), around.tolist(), strict=True):
                courses.setdefault(week, []).append(value)
    return {week: median(values) for week, values in courses.items() if len(values) >= least}


def own_slope(valve: Weekly) -> float:
    """Return Theil and Sen's slope of the value on the temperature, 1/K; NaN where that hardly changes."""
    known = np.isfinite(valve.temperature)
    value, warm, segment = valve.value[known], valve.temperature[known], valve.segment[known]
    if value.size < 8 or np.ptp(warm) < 5.0:
        return math.nan
    first, second = np.triu_indices(value.size, 1)
    apart = (np.abs(warm[second] - warm[first]) > 0.2 * np.ptp(warm)) & (segment[second] == segment[first])
    if not apart.any():
        return math.nan
    rise = (value[second] - value[first])[apart] / (warm[second] - warm[first])[apart]
    return float(np.median(rise))


def differences(valve: Weekly, flat: Array, lag: int) -> tuple[Array, float]:
    """Return the differences of values with those at least ``lag`` weeks later, and how far apart they lie.

    Without a lag they are those of neighbours; none reaches over a service.
    """
    later = np.maximum(np.searchsorted(valve.week, valve.week + lag), np.arange(valve.week.size) + 1)
    first = np.flatnonzero(later < valve.week.size)
    first = first[valve.segment[later[first]] == valve.segment[first]]
    if first.size == 0:
        return np.empty(0), 1.0
    second = later[first]
    return flat[second] - flat[first], float(np.median(valve.week[second] - valve.week[first]))


def _of_valves(fleet: Fleet, faulty: Set[int], least: int) -> tuple[list[Change | None], set[int]]:
    """Return the likeliest change of each valve, and the numbers of those that have no sisters.

    The comparison is the one in which healthy valves are quietest over months.
    """
    courses = _courses(fleet, faulty, least)
    # What follows the oil's temperature is compared first within a machine, whose valves share the oil.
    order = ("nothing", "fleet", "machine") if fleet.referred is None else ("machine", "fleet", "nothing")
    best, rest, chosen = list(fleet.weeks), math.inf, order[0]
    for kind in order:
        less = [_less(week, course) for week, course in zip(fleet.weeks, courses[kind], strict=True)]
        # The median over valves of the mean square of differences over months, or over what there is.
        weeks = [one for n, one in enumerate(less) if n not in faulty]
        squares = []
        for one in weeks:
            for lag in (LAG, 0):
                apart, _ = differences(one, one.value, lag)
                if apart.size >= LEAST_WEEKS:
                    squares.append(mean_square(apart))
                    break
        square = float(np.median(squares)) if squares else math.inf
        if kind == order[0] or square < QUIETER * rest:
            best, rest, chosen = less, square, kind
    usable = [one for one in best if one.week.size >= LEAST_WEEKS]
    slope_spread = 0.0
    if fleet.referred is not None:
        slope_spread = pooled_slope(usable, fleet.referred)[1]
        if chosen == "machine":
            # Spread of the slopes on the oil temperature between the valves of one machine, 1/K.
            around: list[float] = []
            for own in fleet.members().values():
                slopes = np.array([own_slope(best[n]) for n in own])
                slopes = slopes[np.isfinite(slopes)]
                if slopes.size > MATES:
                    factor = math.sqrt(slopes.size / (slopes.size - 1.0))
                    around += (factor * (slopes - np.median(slopes))).tolist()
            if len(around) > MATES:
                slope_spread = min(slope_spread, spread(np.array(around)))
    scatter = scatter_of(usable, slope_spread)
    changes = [
        likeliest_change(one, scatter, days, fleet.parameters)
        for one, days in zip(best, fleet.services, strict=True)
    ]
    return changes, {n for n, course in enumerate(courses["fleet"]) if not course}


def _courses(fleet: Fleet, faulty: Set[int], least: int) -> dict[str, list[dict[int, float]]]:
    """Return what each valve may be compared with, by kind: nothing, all others, those of its machine."""
    members = fleet.members()
    count = len(fleet.weeks)
    healthy = [n for n in range(count) if n not in faulty]
    if len(healthy) > MANY:
        of_fleet = [common_course([fleet.weeks[n] for n in healthy])] * count
    else:
        of_fleet = [
            common_course([fleet.weeks[n] for n in healthy if n != number]) for number in range(count)
        ]
    of_machine = []
    for number in range(count):
        mates = [
            fleet.weeks[n]
            for n in members[fleet.machines[number]]
            if n != number and n not in faulty and fleet.weeks[n].week.size
        ]
        if len(mates) < least:
            of_machine.append(of_fleet[number])
            continue
        course = common_course(mates, least=2)
        # Running medians over five weeks: what machines share is slow, and adds less noise so.
        near = {week: [course[one] for one in range(week - 2, week + 3) if one in course] for week in course}
        of_machine.append({week: median(values) for week, values in near.items()})
    return {"nothing": [{} for _ in range(count)], "fleet": of_fleet, "machine": of_machine}


def _less(week: Weekly, course: Mapping[int, float]) -> Weekly:
    """Return ``week`` less ``course``."""
    return replace(week, value=week.value - np.array([course.get(one, 0.0) for one in week.week.tolist()]))


def _beyond_sisters(changes: Sequence[Change | None]) -> set[int]:
    """Return the numbers of the changes that stand out.

    What healthy sisters show beyond chance is scatter that the test does not know: it raises the threshold
    (an empirical null, Efron 2004, J. Am. Stat. Assoc. 99).
    """
    known = {n: change for n, change in enumerate(changes) if change is not None}
    ratios = {n: change.score / chance_score(change.weeks) for n, change in known.items()}
    found = set()
    for number, change in known.items():
        others = [ratio for n, ratio in ratios.items() if n != number]
        usual = max(1.0, float(np.median(others))) if len(others) >= LEAST_SISTERS else 1.0
        if change.score > usual * change.threshold:
            found.add(number)
    return found


def _of_machines(fleet: Fleet, faulty: Set[int]) -> dict[str, Change]:
    """Return the changes of what the valves of each machine do together, those with a change apart.

    These are steps, as another oil makes them: a slow course of a machine may be its seasons.
    """
    members, many = fleet.members(), len(fleet.weeks) - len(faulty) > MANY
    courses: dict[str, Weekly] = {}
    shared: dict[int, float] | None = None
    for name, own in members.items():
        mates = [fleet.weeks[n] for n in own if n not in faulty and fleet.weeks[n].week.size >= LEAST_WEEKS]
        course = common_course(mates, least=LEAST_MEMBERS)
        if len(course) >= LEAST_WEEKS:
            others = [n for n in range(len(fleet.weeks)) if n not in faulty and (many or n not in own)]
            if not many or shared is None:
                shared = common_course([fleet.weeks[n] for n in others])
            # As weekly values, with the mean oil temperature of the valves.
            warm: dict[int, list[float]] = {}
            for one in mates:
                for week, celsius in zip(one.week.tolist(), one.temperature.tolist(), strict=True):
                    if math.isfinite(celsius):
                        warm.setdefault(week, []).append(celsius)
            weeks = sorted(course)
            together = Weekly(
                np.array(weeks, dtype=np.int64),
                np.array([course[one] for one in weeks]),
                np.ones(len(weeks)),
                np.array([np.mean(warm[one]) if one in warm else math.nan for one in weeks]),
                np.zeros(len(weeks), dtype=np.int64),
            )
            courses[name] = _less(together, shared)
    if not courses:
        return {}
    shown = list(courses.values())
    spread_of = 0.0 if fleet.referred is None else pooled_slope(shown, fleet.referred)[1]
    scatter = scatter_of(shown, spread_of)
    changes = {
        name: likeliest_change(one, scatter, (), fleet.parameters, ramps=False)
        for name, one in courses.items()
    }
    found = _beyond_sisters(list(changes.values()))
    return {name: one for n, (name, one) in enumerate(changes.items()) if n in found and one is not None}


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


def _flattened(valve: Weekly, slope: float) -> Array:
    """Return the values without what the oil temperature does by ``slope``."""
    known = np.isfinite(valve.temperature)
    if not known.any() or not math.isfinite(slope):
        return valve.value
    return np.asarray(
        valve.value - slope * np.where(known, valve.temperature - np.median(valve.temperature[known]), 0.0)
    )
