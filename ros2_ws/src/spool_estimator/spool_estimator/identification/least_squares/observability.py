"""Observability: which unknowns the records tell, and which only together with others.

The slopes of the forces along the measured motion, and of what friction takes up at rest, have full rank
where every unknown shows in its own way. A direction in which they vanish is a change of several unknowns
that nothing sees: products such as a friction coefficient times a load, differences of two lengths. Such
unknowns have no value of their own; what has one is a combination whose gradient is at a right angle to every
such direction.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Singular value of the unit columns, relative to the largest, below which a direction is not seen.
UNSEEN = 1e-4
#: Largest sine of the angle between a combination's gradient and what is seen.
IN_LINE = 1e-2


@dataclass(frozen=True, slots=True)
class Combination:
    """A function of several unknowns that the records tell.

    Attributes:
        name: as text, ``a*b`` or ``a*(b - c)``.
        unit: of it, put together from theirs.
        value: at the point.
        gradient: with respect to all names, shape (u,).
    """

    name: str
    unit: str
    value: float
    gradient: Array


def unseen_directions(slopes: Array, scales: Array) -> Array:
    """Return an orthonormal basis (d, u) of the scaled changes that ``slopes`` (n, u) do not see.

    Args:
        slopes: of the forces, or of a weighted residual.
        scales: typical size of each unknown; directions are in unknowns over these.
    """
    scaled = slopes * scales
    size = np.linalg.norm(scaled, axis=0)
    dead = size <= 1e-9 * float(size.max(initial=0.0))
    columns = scaled / np.where(dead, 1.0, size)
    columns[:, dead] = 0.0
    _, strength, directions = np.linalg.svd(np.linalg.qr(columns, mode="r"))
    unseen = directions[strength < UNSEEN * float(strength.max(initial=0.0))]
    if not unseen.size:
        return np.empty((0, slopes.shape[1]))
    # Back from unit columns to scaled unknowns.
    back = unseen / np.where(dead, 1.0, size / float(size.max()))
    return np.asarray(np.linalg.qr(back.T)[0].T)


def to_hold(unseen: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Return which of ``names`` to hold so that the rest is told, the last of the list first."""
    held: list[str] = []
    rows = unseen.copy()
    for place in reversed(range(len(names))):
        if not rows.shape[0]:
            break
        part = rows[:, place]
        if float(np.abs(part).max()) < IN_LINE:
            continue
        held.append(names[place])
        # What is still unseen with this one held.
        lead = int(np.argmax(np.abs(part)))
        rest = rows - np.outer(part / part[lead], rows[lead])
        rows = np.delete(rest, lead, axis=0)
        if rows.shape[0]:
            rows = np.linalg.qr(rows.T)[0].T
    return tuple(held)


def combinations(
    unseen: Array, names: Sequence[str], units: Sequence[str], values: Mapping[str, float], scales: Array
) -> tuple[tuple[str, ...], list[Combination]]:
    """Return the unknowns that are not told by themselves, and combinations of them that are.

    Args:
        unseen: from :func:`unseen_directions`, shape (d, u).
        names, units: of the unknowns, and of given parameters after them.
        values: at the point.
        scales: as in :func:`unseen_directions`; 0 for what is given.
    """
    involved = [
        place for place in range(len(names)) if unseen.size and np.abs(unseen[:, place]).max() >= IN_LINE
    ]
    lost = tuple(names[place] for place in involved)
    told: list[Combination] = []
    wanted = len(involved) - unseen.shape[0]
    for combination in _candidates(involved, names, units, values):
        if len(told) == wanted:
            break
        gradient = combination.gradient * scales
        size = float(np.linalg.norm(gradient))
        if size == 0.0 or float(np.linalg.norm(unseen @ gradient)) > IN_LINE * size:
            continue
        found = np.array([entry.gradient * scales for entry in (*told, combination)])
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        if np.linalg.svd(found, compute_uv=False).min() > IN_LINE:
            told.append(combination)
    return lost, told


def _candidates(
    involved: Sequence[int], names: Sequence[str], units: Sequence[str], values: Mapping[str, float]
) -> Iterator[Combination]:
    """Yield products, differences, products with differences, differences with products."""
    count = len(names)
    point = np.array([values[name] for name in names])

    def made(name: str, unit: str, value: float, parts: Mapping[int, float]) -> Combination:
        gradient = np.zeros(count)
        for place, slope in parts.items():
            gradient[place] = slope
        return Combination(name, unit, float(value), gradient)

    for i, j in itertools.combinations(involved, 2):
        yield made(
            f"{names[i]}*{names[j]}",
            _product(units[i], units[j]),
            point[i] * point[j],
            {i: point[j], j: point[i]},
        )
    for i, j in itertools.combinations(involved, 2):
        if units[i] == units[j]:
            for sign, mark in ((-1.0, "-"), (1.0, "+")):
                yield made(
                    f"{names[i]} {mark} {names[j]}", units[i], point[i] + sign * point[j], {i: 1.0, j: sign}
                )
    for i in involved:
        for j, k in itertools.combinations([place for place in involved if place != i], 2):
            if units[j] == units[k]:
                yield made(
                    f"{names[i]}*({names[j]} - {names[k]})",
                    _product(units[i], units[j]),
                    point[i] * (point[j] - point[k]),
                    {i: point[j] - point[k], j: point[i], k: -point[i]},
                )
    for i in involved:
        for j, k in itertools.combinations([place for place in range(count) if place != i], 2):
            if (j in involved or k in involved) and _product(units[j], units[k]) == units[i]:
                yield made(
                    f"{names[i]} - {names[j]}*{names[k]}",
                    units[i],
                    point[i] - point[j] * point[k],
                    {i: 1.0, j: -point[k], k: -point[j]},
                )


def _product(first: str, second: str) -> str:
    if "1" in (first, second):
        return second if first == "1" else first
    if {first, second} == {"N/m", "m"}:
        return "N"
    return f"({first})*({second})"
