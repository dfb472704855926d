"""Contacts with stops, found in the record itself: where the spool hits something hard, and how hard that is.

Between two hits the spool swings as the base does, so that its balance of forces, fitted to small
displacements only, shows each hit as a short push inward near the largest displacement. Stiffness and drag of
the contact follow from the pushes over depth and speed within each hit, the clearance from where they begin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from spool_estimator.identification.spectra import ZeroPhase, relative_motion

from .segments import Stretch, corrected

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

#: Least count of hits, and stiffness of a contact over that of the spring.
FEWEST, STIFFER = 4, 12.0
#: Longest hit, over the spool's natural period.
LONGEST = 0.2
#: Largest spread of the clearances of single hits, over their median.
SPREAD = 0.3
#: Least clearance over the reach, and samples of a hit from which its slope is trusted.
LEAST, SHARP = 0.3, 2.5
#: Factors by which stiffness and damping of a contact may be off where hits have samples enough, and else.
CLOSE, FAR = 1.15, 3.0
#: Difference of the logarithms below which two stiffnesses are one.
ALIKE = 0.2
#: Share of the reach within which the base is fitted, and from which a push counts as a hit.
WITHIN, FROM = 0.7, 0.5
#: Push over its scatter without hits, and over the largest pushes, from which it is a hit.
OUT_OF_NOISE, OF_LARGEST = 8.0, 0.25
#: s before and after a hit that are not contact-free.
BEFORE, AFTER = 1.5e-3, 2.5e-3


@dataclass(frozen=True, slots=True)
class ContactLaw:
    """A contact to start a fit from.

    Attributes:
        gap: clearance, m.
        spread: scatter of the clearance from hit to hit, m.
        stiffness, damping: N/m, N s/m.
        factor: by which these two may be off.
    """

    gap: float
    spread: float
    stiffness: float
    damping: float
    factor: float


@dataclass(frozen=True, slots=True)
class Contacts:
    """Hits in all stretches.

    Attributes:
        laws: of the contact as the hits show them, likeliest first.
        spring, drag: of the base between the hits, N/m, N s/m.
        count: of hits.
        depth: median depth of a hit under its largest push, m.
        touching: for each stretch, whether a sample is in a hit or near one, shape (n,).
    """

    laws: tuple[ContactLaw, ...]
    spring: float
    drag: float
    count: int
    depth: float
    touching: tuple[Mask, ...]


@dataclass(frozen=True, slots=True)
class _Motion:
    """Motion of all stretches, one after the other; every array has shape (n,)."""

    displacement: Array
    velocity: Array
    acceleration: Array
    usable: Mask
    period: float


def find_contacts(
    stretches: Sequence[Stretch], mass: float, *, gain: float = 0.0, delay: float = 0.0
) -> Contacts | None:
    """Return the hits in ``stretches``; ``None`` where there are too few, or not those of a hard stop.

    Args:
        stretches: as conditioned.
        mass: kg.
        gain, delay: of the spool's channel (relative, s) beyond those with which that was done.
    """
    motion = _joined(stretches, gain, delay)
    if not motion.usable.any():
        return None
    depth = np.abs(motion.displacement)
    reach = float(np.quantile(depth[motion.usable], 0.99))
    free_force, spring, drag, scatter = _between(motion, mass, depth, reach)
    if spring <= 0.0:
        return None
    side = np.sign(motion.displacement)
    push, speed = -side * free_force, side * motion.velocity
    outside = motion.usable & (depth > FROM * reach)
    largest = np.sort(push[motion.usable & (depth > WITHIN * reach)])[-2 * FEWEST :]
    threshold = max(OUT_OF_NOISE * scatter, OF_LARGEST * float(largest[0]) if largest.size else 0.0)
    first, last = _runs(outside & (push > threshold))
    natural = 2.0 * np.pi * float(np.sqrt(mass / spring))
    if first.size < FEWEST or float(np.median(last - first)) * motion.period > LONGEST * natural:
        return None
    wide = _widened(first, motion.usable & (push > max(OUT_OF_NOISE * scatter, 0.15 * threshold)))
    pairs = [_by_slope(push, speed, depth, *runs, mass) for runs in ((first, last), wide)]
    sharp = float(np.median(last - first)) >= SHARP
    if not sharp:
        pairs += _by_peak(push, speed, first, last, mass)
    laws: list[ContactLaw] = []
    for stiffness, damping in [pair for pair in pairs if pair is not None]:
        gap, spread = _clearance(push, speed, depth, first, last, stiffness, damping)
        near = any(abs(np.log(stiffness / law.stiffness)) < ALIKE for law in laws)
        if stiffness >= STIFFER * spring and gap > LEAST * reach and spread < SPREAD * gap and not near:
            laws.append(ContactLaw(gap, spread, stiffness, damping, CLOSE if sharp else FAR))
    if not laws:
        return None
    depths = [float(push[a:b].max()) for a, b in zip(first.tolist(), last.tolist(), strict=True)]
    typical = float(np.median(depths)) / laws[0].stiffness
    light = _runs(outside & (push > OUT_OF_NOISE * scatter))
    return Contacts(
        tuple(laws), spring, max(drag, 0.0), int(first.size), typical, _touching(stretches, *light)
    )


def _joined(stretches: Sequence[Stretch], gain: float, delay: float) -> _Motion:
    rows: list[tuple[Array, Array, Array, Mask]] = []
    for stretch in stretches:
        record, motion = stretch.record, stretch.motion
        if gain != 0.0 or delay != 0.0:
            conditioning = ZeroPhase(record.sample_period, stretch.low_cut)
            better = corrected(replace(record, spool=motion.spool), gain, delay)
            body = conditioning.apply(record.body)
            motion = relative_motion(body, better.spool, conditioning)
        usable = stretch.kept > 0.0
        ends = min(2 * motion.settling + 1, usable.size // 2)
        usable[:ends] = usable[usable.size - ends :] = False
        rows.append((motion.displacement, motion.velocity, motion.spool, usable))
    z, v, a, usable = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    return _Motion(z, v, a, usable, stretches[0].record.sample_period)


def _between(motion: _Motion, mass: float, depth: Array, reach: float) -> tuple[Array, float, float, float]:
    """Return the force that the base does not have (N), its spring and drag, and the scatter without hits."""
    columns = np.stack([motion.displacement, motion.velocity], axis=1)
    free = motion.usable & (depth < WITHIN * reach)
    width = 2 * round(4e-3 / motion.period) + 1
    force, spring, drag, scatter = mass * motion.acceleration, 0.0, 0.0, 0.0
    for _ in range(3):
        scale = np.maximum(np.sqrt(np.mean(columns[free] ** 2, axis=0)), 1e-30)
        found = (
            np.linalg.lstsq(columns[free] / scale, -mass * motion.acceleration[free], rcond=None)[0] / scale
        )
        spring, drag = float(found[0]), float(found[1])
        force = mass * motion.acceleration + columns @ found
        scatter = 1.4826 * float(np.median(np.abs(force[free])))
        hit = maximum_filter1d((np.abs(force) > 6.0 * scatter).astype(np.uint8), width) > 0
        next_ = motion.usable & (depth < 0.85 * reach) & ~hit
        if next_.sum() < 0.1 * motion.usable.sum():
            break
        free = next_
    return force, spring, drag, scatter


def _runs(mask: Mask) -> tuple[Places, Places]:
    """Return where runs of true begin and end, exclusive."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def _widened(first: Places, pushed: Mask) -> tuple[Places, Places]:
    """Return the runs of ``pushed`` that hold the places ``first``."""
    begin, end = _runs(pushed)
    place = np.unique(np.searchsorted(begin, first, side="right") - 1)
    return begin[place], end[place]


def _by_slope(
    push: Array, speed: Array, depth: Array, first: Places, last: Places, mass: float
) -> tuple[float, float] | None:
    """Return stiffness and damping from the pushes over depth and speed within the hits."""
    columns, targets = [np.zeros((0, 2))], [np.zeros(0)]
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        if b - a > 1:
            # Each hit has a clearance of its own: the displacement wanders from hit to hit.
            columns.append(np.stack([row[a:b] - row[a:b].mean() for row in (depth, speed)], axis=1))
            targets.append(push[a:b] - push[a:b].mean())
    rows, target = np.concatenate(columns), np.concatenate(targets)
    if target.size < 2 * FEWEST:
        return None
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-30)
    stiffness, damping = (np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale).tolist()
    return (stiffness, _sensible(damping, stiffness, mass)) if stiffness > 0.0 else None


def _sensible(damping: float, stiffness: float, mass: float) -> float:
    critical = 2.0 * float(np.sqrt(stiffness * mass))
    return float(np.clip(damping, 0.02 * critical, 0.7 * critical))


def _by_peak(
    push: Array, speed: Array, first: Places, last: Places, mass: float
) -> list[tuple[float, float] | None]:
    """Return contacts that stop the spool with about the largest push of each hit: v sqrt(K m)."""
    peak = np.maximum.reduceat(push, np.stack([first, last], axis=1).ravel()[:-1])[::2]
    before = speed[np.maximum(first - 2, 0)]
    coming = before > 0.0
    if not coming.any():
        return []
    # Drag and samples next to the peak make it smaller, many times where a hit lasts one sample.
    seen = float(np.quantile(peak[coming] / before[coming], 0.7)) ** 2 / mass
    return [(factor * seen, 0.3 * float(np.sqrt(factor * seen * mass))) for factor in (3.0, 8.0, 20.0)]


def _clearance(
    push: Array, speed: Array, depth: Array, first: Places, last: Places, stiffness: float, damping: float
) -> tuple[float, float]:
    """Return the median clearance of the hits and its scatter, m."""
    begins = [
        float(np.mean(depth[a:b] - (push[a:b] - damping * speed[a:b]) / stiffness))
        for a, b in zip(first.tolist(), last.tolist(), strict=True)
    ]
    gap = float(np.median(begins))
    return gap, 1.4826 * float(np.median(np.abs(np.array(begins) - gap)))


def _touching(stretches: Sequence[Stretch], first: Places, last: Places) -> tuple[Mask, ...]:
    found = []
    begin = 0
    for stretch in stretches:
        size, period = stretch.kept.size, stretch.record.sample_period
        before, after = 1 + round(BEFORE / period), 2 + round(AFTER / period)
        mask = np.zeros(size, dtype=np.bool_)
        for a, b in zip(first.tolist(), last.tolist(), strict=True):
            if begin <= a < begin + size:
                mask[max(0, a - begin - before) : b - begin + after] = True
        found.append(mask)
        begin += size
    return tuple(found)
