"""Least squares: unknowns, the descent to the minimum, and which of them the data determine.

Fits of one model, of several set-ups, of profiles and of the structures of a gap analysis descend alike: by
Gauss-Newton steps within bounds, damped where the cost does not fall. The slopes of all unknowns are one
batch of simulations. They are taken again only where a step falls short of what they promise; in between,
each step corrects them in its direction (Broyden, 1965).

The slopes of the forces along the measured motion, and of what friction takes up at rest, have full rank
where every unknown shows in its own way. A direction in which they vanish is a change of several unknowns
that nothing sees, as of a friction coefficient times a load. Such unknowns have no value; what has one is a
combination whose gradient is at a right angle to every such direction.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock, local
from typing import Any, TypeVar

import numpy as np
from spool_core.numbers import Array
from spool_core.system import processors

#: ``busy``: this thread is one of several that share the processors.
_THREAD = local()
#: Size of an unknown near 0, as a share of its typical size.
SMALLEST_SIZE = 0.1

#: First, least and largest damping; factors on it after a step that falls and after one that does not.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING, EASED, BACK_OFF = 0.1, 1e-6, 1e4, 0.2, 10.0
#: Share of the promised fall from which the slopes are trusted for another step.
TRUSTED = 0.4
#: Largest change of an unknown in one round, over its size, and of an absolute one.
LONGEST_STEP, LONGEST_ABSOLUTE = 0.7, 5.0
#: Step of an unknown over its size for slopes.
STEP = 1e-3

#: Singular value of the unit columns, relative to the largest, below which a direction is not seen.
UNSEEN = 1e-4
#: Largest sine of the angle between a combination's gradient and what is seen.
IN_LINE = 1e-2

Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True)
class Unknown:
    """Name, unit (SI), bounds and size of a fitted number; ``absolute``: steps do not grow with it."""

    name: str
    unit: str
    low: float
    high: float
    scale: float
    absolute: bool = False

    def size(self, value: float) -> float:
        """Return the size of ``value`` that steps are taken in proportion to."""
        return self.scale if self.absolute else max(abs(value), SMALLEST_SIZE * self.scale)

    def room(self, size: float) -> float:
        """Return the largest change in one round of a value of ``size``."""
        return (LONGEST_ABSOLUTE if self.absolute else LONGEST_STEP) * size


def bounds_of(unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
    """Return the lower and the upper bounds of ``unknowns``, shape (u,) each."""
    low = np.array([unknown.low for unknown in unknowns])
    high = np.array([unknown.high for unknown in unknowns])
    return low, high


def sizes_of(unknowns: Sequence[Unknown], point: Array) -> Array:
    """Return the size of each number of ``point`` (u,), same shape."""
    return np.array([unknown.size(value) for unknown, value in zip(unknowns, point.tolist(), strict=True)])


class Work:
    """Work of a fit, counted in simulated steps, so that its limit does not depend on the machine's load.

    Attributes:
        until: steps from which no further round of a descent begins.
        spent: steps so far.
        cut: whether that ended a descent or a profile before it was finished.
    """

    def __init__(self, allowed: float, tell: Callable[[float], None] = lambda _steps: None) -> None:
        """Count up to ``allowed`` steps; ``tell`` takes those that were made since."""
        self.until = self._allowed = allowed
        self.spent = 0.0
        self.cut = False
        self._tell, self._lock = tell, Lock()

    def add(self, steps: float) -> None:
        """Count ``steps`` that are made."""
        with self._lock:
            self.spent += steps
        self._tell(steps)

    def take(self, share: float) -> None:
        """Allow this share of the remaining work, and begin a part that is not cut."""
        self.until, self.cut = self.spent + share * max(0.0, self._allowed - self.spent), False

    def rounds(self, most: int, steps: float) -> int:
        """Return how many rounds of so many ``steps`` may begin, ``most`` at most."""
        left = max(0.0, self.until - self.spent)
        return most if left >= most * steps else math.ceil(left / steps)


class LeastSquares(ABC):
    """Residuals whose weighed squares, or what these approximate near a point, are made small.

    Attributes:
        unknowns: what is fitted, the order of every point.
        anchored: residuals of one call belong together, as they depend on its first point.
    """

    unknowns: Sequence[Unknown]
    anchored = False

    @abstractmethod
    def residuals(self, points: Array) -> Any:
        """Return the residuals at ``points`` (s, u), real or complex, shape (s, m)."""

    @abstractmethod
    def costs(self, residuals: Any) -> Array:
        """Return what is made small, from ``residuals`` (s, m), shape (s,)."""

    def weighed(self, rows: Any, residual: Any) -> Array:  # noqa: ARG002
        """Return ``rows`` (..., m) with the weights that hold at ``residual`` (m,), real, shape (..., n)."""
        return np.asarray(rows)

    def slopes(self, point: Array, residual: Any, widened: float = 1.0) -> Any:
        """Return the slopes at ``point`` (u,), whose residual is ``residual`` (m,), shape (u, m).

        They are taken over steps of ``widened`` times the usual length; not finite where nothing follows.
        """
        low, high = bounds_of(self.unknowns)
        steps = widened * STEP * sizes_of(self.unknowns, point)
        steps = np.where(point + steps > high, -steps, steps)
        runs = self.residuals(np.vstack([*([point] if self.anchored else []), point + np.diag(steps)]))
        here, rows = (runs[0], runs[1:]) if self.anchored else (residual, runs)
        broken = ~np.isfinite(self.costs(rows - here))
        if broken.any():
            steps[broken] *= -1.0
            rows[broken] = self.residuals(np.clip(point + np.diag(steps), low, high)[broken])
        return (rows - here) / steps[:, np.newaxis]


@dataclass(frozen=True, slots=True)
class Descent:
    """End of a descent: ``point``, shape (u,), its ``cost``, and whether nothing falls by enough any more.

    ``residual``: at the point, shape (m,).
    """

    point: Array
    cost: float
    converged: bool
    residual: Any = None


def descend(
    problem: LeastSquares,
    starts: Array,
    rounds: int,
    enough: float,
    tries: int = 1,
    *,
    relative: bool = True,
    damping: float = FIRST_DAMPING,
    goal: float = math.inf,
) -> Descent:
    """Return the deepest end of the descents from the best ``tries`` of ``starts`` (s, u).

    Args:
        problem: what is made small.
        starts: points, shape (s, u).
        rounds: after which a descent ends without having converged.
        enough: fall of the cost below which it has converged.
        tries: how many of the starts are followed.
        relative: ``enough`` is a share of the cost.
        damping: of the first step.
        goal: cost; a descent that does not come to it at its largest pace so far ends.
    """
    starts = np.clip(starts, *bounds_of(problem.unknowns))
    residuals = problem.residuals(starts)
    order = np.argsort(problem.costs(residuals))[:tries]

    def followed(place: int) -> Descent:
        return _follow(problem, starts[place], residuals[place], rounds, enough, relative, damping, goal)

    return min(in_parallel(followed, order.tolist()), key=lambda one: one.cost)


@dataclass(frozen=True, slots=True)
class Combination:
    """A function of several unknowns that the records tell.

    Attributes:
        name: as text, ``a*b``, ``a*(b - c)`` or ``a/b``.
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
    """Return which of ``names`` to hold so that the rest can be determined, the last of the list first."""
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


def in_parallel(work: Callable[[Item], Found], items: Iterable[Item]) -> list[Found]:
    """Return what ``work`` makes of each of ``items``, in their order, in a thread for each processor.

    What is in such a thread already goes on in it.
    """
    every = list(items)
    threads = min(len(every), processors())
    if threads < 2 or hasattr(_THREAD, "busy"):
        return [work(item) for item in every]
    with ThreadPoolExecutor(threads, initializer=lambda: setattr(_THREAD, "busy", True)) as pool:
        return list(pool.map(work, every))


def _follow(
    problem: LeastSquares,
    x: Array,
    residual: Any,
    rounds: int,
    enough: float,
    relative: bool,
    damping: float,
    goal: float,
) -> Descent:
    cost, falls = float(problem.costs(residual[np.newaxis])[0]), list[float]()
    converged, known, exact = not x.size, False, False
    sizes: Array = sizes_of(problem.unknowns, x)
    slopes: Any = np.empty((0, 0))
    before: tuple[Array, Any, float] | None = None
    for left in reversed(range(rounds if x.size else 0)):
        least = enough * cost if relative else enough
        if not known:
            changes = problem.slopes(x, residual)
            if not np.isfinite(problem.costs(changes)).all():
                # Beside motions that cannot be followed: nearer to where the slopes were known.
                if before is None or damping > MOST_DAMPING:
                    break
                (x, residual, cost), known, exact = before, slopes.size > 0, False
                damping *= BACK_OFF
                continue
            # In units of the unknowns' sizes: stiffnesses and delays differ by ten powers of ten.
            sizes = sizes_of(problem.unknowns, x)
            slopes, known, exact = changes * sizes[:, np.newaxis], True, True
        trial, hoped, promised = proposed(problem, x, sizes, slopes, residual, damping)
        if hoped < least:
            if exact:
                converged = True
                break
            known = False
            continue
        move = np.asarray((trial - x) / sizes)
        outcome = problem.residuals(trial[np.newaxis])[0]
        fall = cost - float(problem.costs(outcome[np.newaxis])[0])
        if fall > 0.0:
            # What the step showed corrects the slopes in its direction.
            slopes = slopes + np.outer(move / (move @ move), outcome - residual - move @ slopes)
            known = fall > TRUSTED * promised and fall > least
            damping = max(damping * EASED, LEAST_DAMPING)
            falls.append(fall)
            before, x, residual, cost, exact = (x, residual, cost), trial, outcome, cost - fall, False
            # The first fall does not tell: that step is damped most.
            if len(falls) > 1 and cost - left * max(falls) > goal:
                break
        elif exact:
            damping = max(damping, FIRST_DAMPING / BACK_OFF**2) * BACK_OFF
            if damping > MOST_DAMPING:
                converged = True
                break
        else:
            known = False
    return Descent(x, cost, converged, residual)


def proposed(
    problem: LeastSquares, x: Array, sizes: Array, slopes: Any, residual: Any, damping: float
) -> tuple[Array, float, float]:
    """Return where a damped step from ``x`` (u,) ends, and the falls of the cost that it promises.

    Args:
        problem: what is made small.
        x: point within the bounds, shape (u,).
        sizes: of the numbers there, shape (u,).
        slopes: of the residual, times these, shape (u, m).
        residual: at ``x``, shape (m,).
        damping: of the step.

    Returns:
        The point within bounds and the room of each number, shape (u,); the fall of the whole step, and that
        of what the room leaves of it. What would leave its bounds is held, the others move without it.
    """
    low, high = bounds_of(problem.unknowns)
    rows, rest = problem.weighed(slopes, residual), problem.weighed(residual, residual)
    information, gradient = rows @ rows.T, rows @ rest
    held = ((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0))
    move, own = np.zeros(held.size), np.flatnonzero(~held)
    if own.size:
        scales = np.sqrt(np.maximum(np.diag(information)[own], 1e-12 * np.trace(information) + 1e-300))
        matrix = information[np.ix_(own, own)] / np.outer(scales, scales) + damping * np.eye(own.size)
        move[own] = -np.linalg.lstsq(matrix, gradient[own] / scales, rcond=1e-12)[0] / scales

    def fall(move: Array) -> float:
        return -float(2.0 * gradient @ move + move @ information @ move)

    room = np.array([unknown.room(size) for unknown, size in zip(problem.unknowns, sizes, strict=True)])
    trial = np.clip(x + np.clip(sizes * move, -room, room), low, high)
    return trial, fall(move), fall((trial - x) / sizes)


def _candidates(
    involved: Sequence[int], names: Sequence[str], units: Sequence[str], values: Mapping[str, float]
) -> Iterator[Combination]:
    """Yield products, differences, products with differences, differences with products, quotients."""
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
    for j, i in itertools.permutations(involved, 2):
        if point[j] != 0.0:
            yield made(
                f"{names[i]}/{names[j]}",
                f"({units[i]})/{units[j]}" if "/" in units[i] else f"{units[i]}/{units[j]}",
                point[i] / point[j],
                {i: 1.0 / point[j], j: -point[i] / point[j] ** 2},
            )


def _product(first: str, second: str) -> str:
    if "1" in (first, second):
        return second if first == "1" else first
    if {first, second} == {"N/m", "m"}:
        return "N"
    return f"({first})*({second})"
