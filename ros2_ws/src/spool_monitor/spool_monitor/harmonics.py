"""Harmonics of what turns with a shaft: who may shake with each order, and the speed that a family shows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from spool_core.numbers import Array

from spool_monitor.spectral_lines import (
    FALSE_LINE,
    LOBE,
    REACH,
    contrast,
    false_probability,
    is_one_sine,
    line_powers,
)

if TYPE_CHECKING:  # slow to load
    from spool_sim.valve import Component

#: Orders of a shaft of which nobody said what turns with it.
SHAFT_ORDERS = tuple(float(order) for order in range(1, 13))
#: Harmonics of the lowest order of a component that may be seen beyond those it is listed with.
HARMONICS = 4
#: Lines whose frequencies are as p to q, both up to here, may be harmonics of any one source.
SIMPLE = 6
#: Standard deviations within which two frequencies agree: missed once in 2,000.
AGREE = 3.5
#: Standard deviation of a line's frequency in lines of the spectrum, times the root of its contrast, and its
#: least value: a machine's speed is never steadier.
PLACE, STEADIEST = 0.6, 0.02
#: Probability over all trials that lines of other origins form a family by chance, up to which it counts: in
#: a thousand records with a family none is wrong above a confidence of 0.9 (study `orders`).
FALSE_FAMILY = 0.01
#: Lines that are looked at: more of them come from no machine, or cannot be distinguished.
MOST_LINES = 40


class SharpLine(NamedTuple):
    """Line of one frequency: ``frequency`` and its standard deviation ``std``, Hz."""

    frequency: float
    std: float


class _Reading(NamedTuple):
    """Speed (Hz) with its deviation if a source's lines are ``orders``."""

    speed: float
    std: float
    orders: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Family:
    """Lines that one speed explains.

    Attributes:
        rpm: of the measured shaft, rev/min.
        confidence: 1 less the probability that lines of other origins fit as well, over all trials.
        lines: their frequencies (Hz) by order of the measured shaft.
    """

    rpm: float
    confidence: float
    lines: dict[float, float]


def candidates(components: Iterable[Component]) -> dict[float, list[tuple[float, float, str, bool]]]:
    """Return who may shake with each order of the measured shaft, the lowest first.

    Of each: its own order, its speed over that of the shaft, its name, and whether the order is its own
    (pistons, firing) and not that of any shaft. Of unknown components it is the shaft, whose name is empty.
    """
    found: dict[float, list[tuple[float, float, str, bool]]] = {}
    for one in components:
        for order, own in one.orders.items():
            found.setdefault(round(order * one.ratio, 9), []).append((order, one.ratio, one.name, own))
    if not found:
        found = {order: [(order, 1.0, "", False)] for order in SHAFT_ORDERS}
    return dict(sorted(found.items()))


def attributed(sources: Sequence[tuple[float, float, str, bool]]) -> tuple[float, float, str]:
    """Return own order, ratio and name of the only one of ``sources`` that the order is typical of.

    Where several are, none is named: then order and speed are those of the measured shaft.
    """
    typical = [one for one in sources if one[3]] or list(sources)
    order, ratio, name, _ = typical[0]
    return (order, ratio, name) if len(typical) == 1 else (order * ratio, 1.0, "")


def visible_orders(components: Iterable[Component]) -> tuple[float, ...]:
    """Return the orders of the measured shaft with which components may shake, harmonics not listed included.

    These are ``HARMONICS`` of the shaft's and of the component's own lowest order each.
    """
    found: set[float] = set()
    for one in components:
        for typical in (False, True):
            listed = [order for order, own in one.orders.items() if own is typical]
            if listed:
                multiples = [min(listed) * number for number in range(1, HARMONICS + 1)]
                found |= {round(order * one.ratio, 9) for order in (*listed, *multiples)}
    return tuple(sorted(found))


def sharp_lines(body: Array, period: float) -> list[SharpLine]:
    """Return the lines of ``body``, shape (n,), that noise does not show and that have one frequency."""
    powers = line_powers(body)
    places = np.arange(REACH + LOBE, powers.size - REACH - LOBE, dtype=np.int64)
    contrasts = contrast(powers, places)
    found = []
    for at in np.flatnonzero(false_probability(contrasts) * places.size <= FALSE_LINE):
        peak = int(places[at])
        if powers[peak] < powers[peak - LOBE : peak + LOBE + 1].max():
            continue
        side = 1 if powers[peak + 1] > powers[peak - 1] else -1
        ratio = math.sqrt(float(powers[peak + side] / powers[peak]))
        place = peak + side * (2.0 * ratio - 1.0) / (ratio + 1.0)  # of a sine under a Hann taper
        if is_one_sine(body, powers, peak, place):
            std = max(STEADIEST, PLACE / math.sqrt(float(contrasts[at])))
            found.append(SharpLine(place / (body.size * period), std / (body.size * period)))
    return found


def speed_from_harmonics(body: Array, period: float, components: Sequence[Component]) -> Family | None:
    """Return the family of lines in ``body`` that shows the speed, ``None`` where it is not certain.

    Lines as 1 to 2 or 2 to 3 are harmonics of one source, whatever its speed. A speed needs two such sources
    that it explains together, as the shaft and the pistons of a pump. Each speed that explains as many is a
    possible one; with two of them there is no answer.

    Args:
        body: m/s^2, shape (n,), ``period`` s apart, of constant speed.
        components: what turns with the shaft.
    """
    lines = sharp_lines(body, period)
    if not 2 <= len(lines) <= MOST_LINES:
        return None
    orders = np.array(visible_orders(components))
    sources = _sources(lines)
    readings = [_readings(source, orders) for source in sources]
    chance, agreed = 0.0, []
    low, high = REACH / (body.size * period), 0.5 / period
    for one, other in combinations(range(len(sources)), 2):
        for first in readings[one]:
            for second in readings[other]:
                scale = sources[other][0].frequency / second.speed
                expected = scale * first.speed
                within = AGREE * math.hypot(first.std, second.std)
                if low <= expected <= high:
                    # Evenly spread over Hz or over octaves, whichever is the denser.
                    density = max(1.0 / (high - low), 1.0 / (expected * math.log(high / low)))
                    chance += 2.0 * scale * within * density
                if abs(first.speed - second.speed) <= within:
                    agreed.append((one, first, other, second))
    if not agreed or chance > FALSE_FAMILY:
        return None
    found: dict[int, _Reading] = {}
    for one, first, other, second in agreed:
        if found.setdefault(one, first) != first or found.setdefault(other, second) != second:
            return None
    every = list(found.values())
    weights = np.array([reading.std**-2 for reading in every])
    speed = float(weights @ [reading.speed for reading in every] / weights.sum())
    if any(abs(one.speed - speed) > AGREE * one.std + AGREE / math.sqrt(weights.sum()) for one in every):
        return None
    shown = {
        order: line.frequency
        for number, reading in found.items()
        for order, line in zip(reading.orders, sources[number], strict=True)
    }
    return Family(60.0 * speed, 1.0 - chance, shown)


def _sources(lines: Sequence[SharpLine]) -> list[list[SharpLine]]:
    """Return lines in groups whose frequencies have simple ratios, the lowest first."""
    groups: list[list[SharpLine]] = []
    for line in lines:
        near = [group for group in groups if any(_simple(line, one) for one in group)]
        groups = [group for group in groups if group not in near]
        groups.append(sorted([line, *(one for group in near for one in group)]))
    return groups


def _simple(one: SharpLine, other: SharpLine) -> bool:
    """Return whether two lines may be harmonics of one source."""
    return any(
        abs(q * one.frequency - p * other.frequency) <= AGREE * math.hypot(q * one.std, p * other.std)
        for p in range(1, SIMPLE + 1)
        for q in range(1, SIMPLE + 1)
    )


def _readings(source: Sequence[SharpLine], orders: Array) -> list[_Reading]:
    """Return each speed at which all lines of a source are orders."""
    found = []
    best = min(source, key=lambda line: line.std / line.frequency)
    for order in orders:
        speed, std = best.frequency / order, best.std / order
        near = [float(orders[np.argmin(np.abs(line.frequency / speed - orders))]) for line in source]
        if all(
            abs(line.frequency - own * speed) <= AGREE * math.hypot(line.std, own * std) or line is best
            for line, own in zip(source, near, strict=True)
        ):
            weights = np.array([(own / line.std) ** 2 for line, own in zip(source, near, strict=True)])
            speeds = [line.frequency / own for line, own in zip(source, near, strict=True)]
            mean = float(weights @ speeds / weights.sum())
            found.append(_Reading(mean, 1.0 / math.sqrt(float(weights.sum())), tuple(near)))
    return found
