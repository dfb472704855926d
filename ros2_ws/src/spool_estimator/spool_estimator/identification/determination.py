"""Judgement of what a record determines: the rule that `fit`, `gap` and `plan` share.

A number is *identifiable* where its 95 % interval ends within its bounds on both sides, bounded *on one side*
where only one end does. Where none does, the record still may show it once others are held: then it is known
*only together* with these. Else it is *not identifiable*.

The information (slopes of the weighted residual) gives the intervals where the residual is nearly linear in
the number. The weak ones are decided by the profile likelihood: the number is held at other values, and the
others are fitted again. A number is weak where its interval so found leaves the bounds, or where the
likelihood at twice that interval is still as at its ends: the slopes mislead.

Sources: Wilks, Ann. Math. Stat. 9, 1938 (rise of a profile); Raue and others, Bioinformatics 25, 2009.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from spool_core.numbers import Array
from spool_core.uncertainty import EMPTY_IS_NULL, LEFT_OUT, Z_95, number, unit_text

from spool_estimator.identification.least_squares import IN_LINE, Unknown, bounds_of

#: Twice the fall of the log likelihood at the ends of a 95 % interval of one number (Wilks, 1938).
RISE_95 = Z_95**2
IDENTIFIABLE, ONE_SIDED, TOGETHER, NOT = "identifiable", "one-sided", "only together", "not identifiable"
#: The profile was not finished: the fit reached its limit of work, or other values give no motion.
UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Determination:
    """Judgement of what records determine of a parameter.

    Attributes:
        name, unit: of the parameter.
        verdict: ``identifiable``, ``one-sided``, ``only together`` or ``not identifiable``; ``undecided``
            where the profile was not finished.
        low, high: ends of its 95 % interval, ``None`` where the records set no bound on that side.
        together_with: parameters that compensate for a change of it.
        at_start: the verdict at the start values, before the fit; empty where it was not worked out.
        held_at: value at which it was held, as the records do not determine it; ``None`` where it was fitted.
    """

    JSON_PROPERTIES: ClassVar = ("sentence",)

    name: str
    unit: str
    verdict: str
    low: float | None = None
    high: float | None = None
    together_with: tuple[str, ...] = ()
    at_start: str = field(default="", metadata=EMPTY_IS_NULL)
    held_at: float | None = None

    @property
    def lost(self) -> bool:
        """Whether the records set no bound on either side."""
        return self.verdict in (TOGETHER, NOT)

    @property
    def bound(self) -> str:
        """The end of an interval that is bounded on one side, in words."""
        end, value = ("at least", self.low) if self.low is not None else ("at most", self.high)
        return f"{end} {number(value or 0.0)}{unit_text(self.unit)} (95 %)"

    @property
    def sentence(self) -> str:
        """The judgement in words."""
        own = self.name.replace("_", " ")
        held = "" if self.held_at is None else f"; held at {number(self.held_at)}{unit_text(self.unit)}"
        if self.verdict == IDENTIFIABLE:
            return f"{own}: determined{held}"
        if self.verdict == ONE_SIDED:
            return f"{own}: bounded on one side, {self.bound}{held}"
        if self.verdict == TOGETHER:
            others = ", ".join(name.replace("_", " ") for name in self.together_with)
            return f"{own}: known only together with {others or 'other parameters'}{held}"
        if self.verdict == UNDECIDED:
            return f"{own}: not judged, its profile could not be finished{held}"
        return f"{own}: not determined, the record does not depend on it{held}"


def sentences(found: Sequence[Determination]) -> list[str]:
    """Return the judgement of all parameters in words: the determined ones in one sentence, then the rest."""
    known = [one.name.replace("_", " ") for one in found if one.verdict == IDENTIFIABLE]
    rest = [one.sentence for one in found if one.verdict != IDENTIFIABLE]
    return [f"The record determines: {', '.join(known) or 'no parameter'}.", *rest] if found else []


def by_information(
    unknowns: Sequence[Unknown],
    point: Array,
    slopes: Array,
    hidden: Mapping[str, tuple[str, ...]],
    covariance: Array | None = None,
) -> list[Determination]:
    """Return the judgement from the slopes of the weighted residual, a normal distribution supposed.

    Args:
        unknowns: u numbers.
        point: their values, shape (u,).
        slopes: of the residual with variance 1, shape (n, u).
        hidden: numbers that nothing shows by themselves, as of ``hidden_by_name``.
        covariance: of the point where it is known better than from the slopes, shape (u, u).
    """
    low, high = bounds_of(unknowns)
    found = information_covariance(slopes, high - low)
    spread = np.sqrt(np.maximum(np.diag(found if covariance is None else covariance), 0.0))
    spread = np.where([one.name in hidden for one in unknowns] | ~np.isfinite(spread), math.inf, spread)
    with np.errstate(divide="ignore"):
        alone = 1.0 / np.linalg.norm(slopes, axis=0)
    judged = []
    for place, unknown in enumerate(unknowns):
        ends = point[place] - Z_95 * spread[place], point[place] + Z_95 * spread[place]
        room = max(point[place] - low[place], high[place] - point[place])
        by_itself = bool(Z_95 * alone[place] < room)
        # What would be noticed if it did not follow a change by a standard deviation.
        moved = np.abs(found[place]) / math.sqrt(found[place, place])
        followers = np.flatnonzero(moved >= Z_95 * alone).tolist()
        names = hidden.get(unknown.name) or tuple(unknowns[n].name for n in followers if n != place)
        judged.append(
            judgement(
                unknown,
                float(ends[0]) if ends[0] > low[place] else None,
                float(ends[1]) if ends[1] < high[place] else None,
                names if by_itself else (),
            )
        )
    return judged


def hidden_by_name(unseen: Array, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the numbers that take part in ``unseen`` directions (d, u), each with those that compensate."""
    found = {}
    for place, name in enumerate(names):
        part = unseen.T @ unseen[:, place]
        if np.abs(unseen[:, place]).max(initial=0.0) >= IN_LINE:
            others = np.flatnonzero(np.abs(part) >= IN_LINE * float(np.abs(part).max())).tolist()
            found[name] = tuple(names[other] for other in others if other != place)
    return found


def judgement(
    unknown: Unknown, low: float | None, high: float | None, together_with: tuple[str, ...]
) -> Determination:
    """Return the verdict from the ends of an interval, ``None`` where it leaves the bounds of ``unknown``."""
    if low is not None or high is not None:
        verdict = IDENTIFIABLE if low is not None and high is not None else ONE_SIDED
        return Determination(unknown.name, unknown.unit, verdict, low, high)
    verdict = TOGETHER if together_with else NOT
    return Determination(unknown.name, unknown.unit, verdict, together_with=together_with)


def refuted(one: Determination | None, unknown: Unknown, value: float, deviation: float) -> bool:
    """Return whether a judgement denies the interval of a value that ``deviation`` puts inside the bounds."""
    half = Z_95 * deviation
    inside = unknown.low < value - half and value + half < unknown.high
    return inside and one is not None and one.verdict in (ONE_SIDED, TOGETHER, NOT)


def information_covariance(slopes: Array, ranges: Array) -> Array:
    """Return the covariance (u, u) from ``slopes`` (n, u), each number known to its ``ranges`` (u,)."""
    scaled = np.vstack([np.linalg.qr(slopes * ranges, mode="r"), np.eye(ranges.size)])
    _, strength, directions = np.linalg.svd(scaled, full_matrices=False)
    columns = (directions.T / strength) * ranges[:, np.newaxis]
    return np.asarray(columns @ columns.T)


@dataclass(frozen=True, slots=True)
class ProfileLikelihood:
    """Profile likelihood of a number.

    Attributes:
        name, unit: of the number.
        verdict: ``identifiable``, ``one-sided``, ``only together`` (``together_with``), ``not identifiable``.
        sentence: the verdict in words.
        low, high: ends of its 95 % interval, ``None`` where the record sets no bound on that side.
        together_with: the number that moves most along with it, empty where none does.
        values: at which it was held, in rising order, SI, shape (n,).
        rises: of twice the negative log likelihood over its least, all other numbers fitted, shape (n,).
        best: the estimate.
    """

    name: str
    verdict: str
    sentence: str
    low: float | None
    high: float | None
    unit: str
    together_with: str = field(metadata=EMPTY_IS_NULL)
    values: tuple[float, ...]
    rises: tuple[float, ...]
    best: float = field(metadata=LEFT_OUT)


def verdict_of(
    name: str, unit: str, values: tuple[float, ...], rises: tuple[float, ...], best: float, partner: str = ""
) -> ProfileLikelihood:
    """Return the profile with its verdict; ``values`` in rising order, with ``best`` among them."""
    low, high = crossing(values, rises, best, -1), crossing(values, rises, best, 1)
    own, other = name.replace("_", " "), partner.replace("_", " ")
    shown = f"{best:.4g} {unit}".removesuffix(" 1")
    if low is not None and high is not None:
        verdict = IDENTIFIABLE
        text = f"{own} is identifiable: {low:.4g} to {high:.4g} (95 %), best {shown}"
    elif low is not None or high is not None:
        verdict = ONE_SIDED
        bound = f"at least {low:.4g}" if low is not None else f"at most {high:.4g}"
        text = f"{own} is bounded on one side: {bound} (95 %); the record sets no bound on the other side"
        text += f", since {other} compensates for it" if other else ""
    elif partner:
        verdict = TOGETHER
        text = f"{own} is known only together with {other}: each compensates for a change of the other"
    else:
        verdict = NOT
        text = f"{own} is not identifiable: the record hardly depends on it"
    return ProfileLikelihood(name, verdict, text, low, high, unit, partner, values, rises, best)


def crossing(values: tuple[float, ...], rises: tuple[float, ...], best: float, side: int) -> float | None:
    """Return where the profile first crosses ``RISE_95`` going to ``side`` of ``best``, interpolated."""
    points = sorted(zip(values, rises, strict=True), reverse=side < 0)
    walk = [(value, rise) for value, rise in points if (value - best) * side >= 0.0]
    for (near, below), (far, above) in pairwise(walk):
        if below < RISE_95 <= above:
            # The root of a rise is nearly linear.
            inner = math.sqrt(max(below, 0.0))
            return near + (math.sqrt(RISE_95) - inner) / (math.sqrt(above) - inner) * (far - near)
    return None
