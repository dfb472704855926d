"""Comparison of valves with their sisters, those of the same machine or all, where that makes them quieter.

What the valves of a machine do together is the machine's: its oil, its temperature sensor, its work.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from .change_test import LEAST_WEEKS, Change, chance_score, likeliest_change
from .sisters import LAG, LEAST_SISTERS, common_course, differences, own_slope, pooled_slope, scatter_of
from .weekly import Weekly, mean_square, spread

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


@dataclass(frozen=True, slots=True)
class Compared:
    """Compared valves: the likeliest change of each, and of what the valves of each machine do together.

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
    together = _together(fleet, changes, found)
    machines = _of_machines(fleet, found - together)
    found -= {n for n in together if fleet.machines[n] in machines}
    return Compared(changes, found, machines, alone)


def _together(fleet: Fleet, changes: Sequence[Change | None], found: Set[int]) -> set[int]:
    """Return the numbers of the ``found`` valves whose machine has most of its valves among them."""
    together: set[int] = set()
    for own in fleet.members().values():
        for sign in (1.0, -1.0):
            alike = {
                n for n in own if n in found and (one := changes[n]) is not None and one.size * sign > 0.0
            }
            if len(alike) >= max(LEAST_MEMBERS, TOGETHER * len(own)):
                together |= alike
    return together


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
        square = _over_months([one for n, one in enumerate(less) if n not in faulty])
        if kind == order[0] or square < QUIETER * rest:
            best, rest, chosen = less, square, kind
    usable = [one for one in best if one.week.size >= LEAST_WEEKS]
    slope_spread = 0.0
    if fleet.referred is not None:
        slope_spread = pooled_slope(usable, fleet.referred)[1]
        if chosen == "machine":
            slope_spread = min(slope_spread, _spread_within(best, fleet.members()))
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
        enough = len(mates) >= least
        of_machine.append(_smoothed(common_course(mates, least=2)) if enough else of_fleet[number])
    return {"nothing": [{} for _ in range(count)], "fleet": of_fleet, "machine": of_machine}


def _less(week: Weekly, course: Mapping[int, float]) -> Weekly:
    """Return ``week`` less ``course``."""
    return replace(week, value=week.value - np.array([course.get(one, 0.0) for one in week.week.tolist()]))


def _over_months(weeks: Sequence[Weekly]) -> float:
    """Return the median over valves of the mean square of differences over months, or over what there is."""
    squares = []
    for one in weeks:
        for lag in (LAG, 0):
            apart, _ = differences(one, one.value, lag)
            if apart.size >= LEAST_WEEKS:
                squares.append(mean_square(apart))
                break
    return float(np.median(squares)) if squares else math.inf


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
            courses[name] = _less(_as_weekly(course, mates), shared)
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


def _as_weekly(course: Mapping[int, float], mates: Sequence[Weekly]) -> Weekly:
    """Return ``course`` as weekly values, with the mean oil temperature of the valves."""
    warm: dict[int, list[float]] = {}
    for one in mates:
        for week, celsius in zip(one.week.tolist(), one.temperature.tolist(), strict=True):
            if math.isfinite(celsius):
                warm.setdefault(week, []).append(celsius)
    week = np.array(sorted(course), dtype=np.int64)
    return Weekly(
        week,
        np.array([course[one] for one in week.tolist()]),
        np.ones(week.size),
        np.array([np.mean(warm[one]) if one in warm else math.nan for one in week.tolist()]),
        np.zeros(week.size, dtype=np.int64),
    )


def _spread_within(weeks: Sequence[Weekly], members: Mapping[str, Sequence[int]]) -> float:
    """Return the spread of the slopes on the oil temperature between the valves of one machine, 1/K."""
    apart: list[float] = []
    for own in members.values():
        slopes = np.array([own_slope(weeks[n]) for n in own])
        slopes = slopes[np.isfinite(slopes)]
        if slopes.size > MATES:
            apart += ((slopes - np.median(slopes)) * math.sqrt(slopes.size / (slopes.size - 1.0))).tolist()
    return spread(np.array(apart)) if len(apart) > MATES else math.inf


def _smoothed(course: Mapping[int, float]) -> dict[int, float]:
    """Return the running medians over five weeks: what machines share is slow, and adds less noise so."""
    return {
        week: median([course[near] for near in range(week - 2, week + 3) if near in course])
        for week in course
    }
