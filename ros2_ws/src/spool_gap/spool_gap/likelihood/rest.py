"""Rest of the motion: a smooth force that no catalogue law explains, and friction that differs by direction.

The competitor of all named structures is a force whose law nobody knows: smooth functions of displacement,
velocity, their product, the way since the last reversal, and time, with coefficients of unknown size. Its
evidence is the marginal likelihood over these coefficients, whose one variance is the most likely one, so
that it pays for what it could have explained and did not.

Friction that differs by direction is a constant push to a moving spool, which shifts the motion's middle.

Source: MacKay, Bayesian interpolation, 1992 (evidence of a linear model with a Gaussian prior).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev
from spool_core.numbers import Array
from spool_sim.valve import Valve

from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Motion
from spool_gap.likelihood.kernel import SwitchableMotion
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.readings import Readings, readings_of
from spool_gap.likelihood.structure import Structure
from spool_gap.likelihood.structure_fit import DECISIVE, StructureFit, curvature_of

#: Degree of the functions of one variable, and of each of two.
DEGREE, BOTH = 9, 4
#: Windows at least, for a remainder to be looked for.
FEWEST = 2
#: Samples around a hit on a stop that do not count: the time of a hit within a sample is not known.
BESIDE = 5
#: Ratios of the coefficients' standard deviation to that of white noise of equal power, that are tried.
WIDTHS = np.geomspace(1e-3, 1e3, 61)

ONE, TWO = "coulomb_friction", "asymmetric_friction"
#: s of rest that are put in front of a record, and s of it that are looked at.
REST, LOOKED_AT = 2.0, 4.0
#: s at the start in which the body must be quiet, and how quiet, over its rms later.
QUIET_TIME, QUIET_SHARE = 0.01, 0.03
#: Mean of the body's reading over its rms from which it is a bias: that of an excitation is smaller.
BIASED = 0.02
#: Share of it that a bias shows before the motion begins: half way from blows to one side (0) to a bias (1).
FROM_START = 0.5
#: Degree of the course that a bias drifts by.
DRIFT = 3
#: Ratios (forward - backward) / (forward + backward) that are tried.
RATIOS = np.linspace(-0.9, 0.9, 37)
#: Ratio below which two forces are one: friction scatters by as much from stroke to stroke.
LEAST_RATIO = 0.1
#: Standard deviations of the likelihood's scatter that the evidence must exceed.
SCATTERS = 3.0


@dataclass(frozen=True, slots=True)
class Rest:
    """What explains some of what a fit leaves: a smooth force, or a pattern.

    Attributes:
        gain: of the evidence (log), 0 at least; of a pattern minus the logarithm of the probability that
            noise makes it, or the rise of the log likelihood of windows that are predicted by the others.
        share: of the spool's acceleration, rms, that it makes.
        follows: what most of it is a function of, or follows, in words.
        beside: it is no force of the motion.
    """

    gain: float
    share: float
    follows: str
    beside: bool = False


def rest_of(predictions: Predictions, fit: StructureFit) -> Rest:
    """Return what a smooth force explains of what ``fit`` leaves."""
    best = Rest(0.0, 0.0, "nothing")
    with settled(predictions, fit) as enough:
        if not enough:
            return best
        motion = _motion_of(predictions, fit.structure)
        weights = predictions.weights(fit.lines)
        slopes = curvature_of(predictions, fit).slopes
        own = np.linalg.qr((slopes / (np.linalg.norm(slopes, axis=1, keepdims=True) + 1e-300)).T)[0]
        residual = predictions.weighed(fit.lines, weights)
        residual = residual - own @ (own.T @ residual)
        for name, forces in _columns(motion).items():
            lines = [
                part.lines_of_forces(row, fit.structure)
                for part, row in zip(predictions.parts, _by_part(predictions, forces), strict=True)
            ]
            columns = predictions.weighed(lines, weights)
            gain, coefficients = _evidence(columns - (columns @ own) @ own.T, residual)
            if gain > best.gain:
                share = share_of_force(predictions, fit.structure, coefficients @ forces)
                best = Rest(gain, share, name)
    return best


def _by_part(predictions: Predictions, rows: Array) -> list[Array]:
    """Return ``rows`` (q, n) of all stretches cut into those of each."""
    return np.split(rows, np.cumsum([part.size for part in predictions.parts])[:-1], axis=1)


def _motion_of(predictions: Predictions, own: Structure) -> Motion:
    """Return the motion of ``own`` in all stretches, one after the other."""
    found = [part.responses([own]) for part in predictions.parts]
    z, v = (np.concatenate([getattr(one, name)[0] for one in found]) for name in ("displacement", "velocity"))
    first = predictions.parts[0]
    time = np.concatenate([part.time + np.arange(part.size) * part.period for part in predictions.parts])
    # White noise of the reading above the lowest frequency, integrated.
    noise = max(
        float(np.sqrt(part.readings.noise.spool / (4.0 * np.pi**2 * part.readings.low_cut)))
        for part in predictions.parts
    )
    return Motion(
        z, v, np.gradient(v, first.period), time, first.period, noise,
        own.values["mass"], own.values["spring_stiffness"], own.values.get("viscous_coefficient", 0.0),
    )  # fmt: skip


def share_of_effect(predictions: Predictions, fit: StructureFit, terms: tuple[str, ...]) -> float:
    """Return the share of the spool's acceleration (rms) that force ``terms`` of ``fit`` change.

    What the base with other numbers would do as well is not counted.
    """
    own = fit.structure
    rows = [part.force_of(own, terms) for part in predictions.parts]
    return share_of_force(predictions, own, np.concatenate(rows))


def share_of_force(predictions: Predictions, own: Structure, force: Array) -> float:
    """Return the rms of what ``force`` (n,) along the motion adds to the acceleration, over that measured."""
    changed = measured = 0.0
    rows = _by_part(predictions, force[np.newaxis])
    for part, row in zip(predictions.parts, rows, strict=True):
        found = part.responses([own])
        others = np.array([found.displacement[0], found.velocity[0]])
        lines = part.lines_of_forces(np.concatenate([row, others]), own)[:, part.inside]
        flat = lines.reshape(3, -1)
        reading = part.lines_of(part.spool)[part.inside].reshape(1, -1)
        beside = np.concatenate([flat[1:], reading])
        real = [np.concatenate([rows.real, rows.imag], axis=1) for rows in (flat[:1], beside)]
        scaled = real[1] / (np.linalg.norm(real[1], axis=1, keepdims=True) + 1e-300)
        basis = np.linalg.qr(scaled.T)[0]
        left = real[0][0] - basis @ (basis.T @ real[0][0])
        changed += float(left @ left)
        measured += float(np.sum(np.abs(reading) ** 2))
    return float(np.sqrt(changed / max(measured, 1e-300)))


def share_between(
    predictions: Predictions,
    fit: StructureFit,
    terms: tuple[str, ...],
    other: StructureFit,
    others: tuple[str, ...],
) -> float:
    """Return the share by which ``terms`` of ``fit`` and ``others`` of ``other`` differ along its motion."""
    rows = [
        part.force_of(fit.structure, terms) - part.force_of(fit.structure, others, other.structure.values)
        for part in predictions.parts
    ]
    return share_of_force(predictions, fit.structure, np.concatenate(rows))


def share_of_part(predictions: Predictions, fit: StructureFit, key: str) -> float:
    """Return the share of the spool's acceleration (rms) that the part ``key`` of the chain changes."""
    changed = measured = 0.0
    for one in predictions.parts:
        with_it, without = (one.errors([own])[0] for own in (fit.structure, fit.structure.without(key)))
        lines = with_it - without
        # Without what a gain or a delay of the reading makes.
        read = one.lines_of(one.spool)[one.inside].ravel()
        late = read * np.tile(2j * np.pi * one.lines, int(one.inside.sum()))
        rows = [np.concatenate([row.real, row.imag]) for row in (lines[one.inside].ravel(), read, late)]
        basis = np.linalg.qr(np.array([row / (np.linalg.norm(row) + 1e-300) for row in rows[1:]]).T)[0]
        left = rows[0] - basis @ (basis.T @ rows[0])
        alone, reading = float(left @ left), float(np.sum(np.abs(read) ** 2))
        changed += alone
        measured += reading
    return float(np.sqrt(changed / max(measured, 1e-300)))


@dataclass(frozen=True, slots=True)
class TwoForces:
    """Friction by direction: ``ratio`` with its standard ``deviation``, and the ``evidence`` (log) for it."""

    ratio: float
    deviation: float
    evidence: float


def starts_at_rest(readings: Readings) -> bool:
    """Whether the record begins before the motion does."""
    count = _quiet_count(readings)
    quiet = max(QUIET_SHARE * float(readings.body.std()), 2.0 * readings.noise.body_rms)
    return readings.time == 0.0 and float(np.std(readings.record.body[:count])) < quiet


def _quiet_count(readings: Readings) -> int:
    """Return how many samples at the start are looked at for rest."""
    return max(4, round(QUIET_TIME / readings.period))


def two_forces(
    readings: Sequence[Readings], valve: Valve, motions: Sequence[SwitchableMotion], fit: StructureFit
) -> TwoForces | None:
    """Return what the start from rest says of Coulomb friction in ``fit``; ``None`` where it says nothing."""
    first = next((one for one in readings if starts_at_rest(one)), None)
    if first is None or ONE not in fit.structure.effects:
        return None
    prediction = Prediction(_with_rest(first), valve, motions)
    lines = prediction.errors([split_by_direction(fit.structure, ratio) for ratio in RATIOS.tolist()])
    likely = np.array([prediction.log_likelihood(one) for one in lines])
    best = int(np.argmax(likely))
    if best in (0, RATIOS.size - 1):
        return None
    evidence = float(likely[best] - likely[RATIOS.size // 2])
    # From one ratio to the next the likelihood scatters, as reversals of the simulated motion come and go.
    scatter = 1.5 * float(np.median(np.abs(np.diff(likely, 2)))) / math.sqrt(6.0)
    near = np.flatnonzero(likely[best] - likely <= 2.0 + SCATTERS * scatter)
    step = float(RATIOS[1] - RATIOS[0])
    deviation = max(float(np.ptp(RATIOS[near])) / 4.0, step / 3.0)
    below, top, above = likely[best - 1 : best + 2].tolist()
    ratio = float(RATIOS[best]) + 0.5 * step * (below - above) / (below - 2.0 * top + above)
    if evidence < DECISIVE + SCATTERS * scatter or abs(ratio) < max(LEAST_RATIO, 2.0 * deviation):
        return None
    return TwoForces(ratio, deviation, evidence)


def split_by_direction(structure: Structure, ratio: float) -> Structure:
    """Return ``structure`` with two forces of friction in place of one."""
    mean = structure.values["coulomb_force"]
    effects = tuple(TWO if name == ONE else name for name in structure.effects)
    forces = {"forward_force": (1.0 + ratio) * mean, "backward_force": (1.0 - ratio) * mean}
    return structure.having(effects, structure.parts, forces)


@contextmanager
def settled(predictions: Predictions, fit: StructureFit) -> Iterator[bool]:
    """Count no sample at a hit on a stop while this lasts; yield whether enough windows are left.

    What a contact of few samples leaves looks like a force there.
    """
    own = fit.structure
    hits = [term for name in own.effects if EFFECTS[name].localised for term in EFFECTS[name].terms]
    before = [(part.inside, part.counted) for part in predictions.parts]
    for part in predictions.parts:
        if hits:
            touched = part.force_of(own, hits) != 0.0
            part.count(part.counted * (np.convolve(touched, np.ones(BESIDE), mode="same") < 0.5))
    try:
        yield sum(int(part.inside.sum()) for part in predictions.parts) >= FEWEST
    finally:
        for part, (inside, counted) in zip(predictions.parts, before, strict=True):
            part.inside = inside
            part.count(counted)


def _columns(motion: Motion) -> Mapping[str, Array]:
    """Return smooth forces along ``motion`` of unit rms, shape (q, n), by what they are a function of."""
    z = np.clip(motion.displacement / motion.largest_displacement, -1.0, 1.0)
    v = np.clip(motion.velocity / motion.largest_velocity, -1.0, 1.0)
    time = 2.0 * (motion.time - motion.time.min()) / max(float(np.ptp(motion.time)), 1e-9) - 1.0
    side = motion.sign
    # Speeds near rest are a separate class: friction has most to say there.
    slow = np.array([side * np.exp(-np.abs(v) / width) for width in (0.03, 0.1, 0.3)])
    of_z = chebyshev.chebvander(z, DEGREE).T[1:]
    of_v = np.concatenate([chebyshev.chebvander(v, DEGREE).T[1:], side[np.newaxis], slow])
    two = [of_z[i] * of_v[j] for i in range(BOTH) for j in range(BOTH)]
    two += [side * of_z[i] for i in range(BOTH)]
    of_time = chebyshev.chebvander(time, BOTH).T[1:]
    way = _way(motion)
    found = {
        "position": of_z,
        "speed": of_v,
        "position and speed": np.concatenate([of_z, of_v, np.array(two)]),
        "the way since the last reversal": np.array(
            [side * np.exp(-way / width) for width in (0.01, 0.03, 0.1, 0.3)]
        ),
        "time": np.concatenate(
            [of_time * z, of_time * v, of_time * side, of_time * (z**3), of_time * (v * np.abs(v))]
        ),
    }
    return {
        name: rows / (np.sqrt(np.mean(rows**2, axis=1, keepdims=True)) + 1e-12)
        for name, rows in found.items()
    }


def _way(motion: Motion) -> Array:
    """Return the travel since the last reversal over the largest displacement, shape (n,)."""
    z = motion.displacement / motion.largest_displacement
    turned = np.flatnonzero(np.diff(np.sign(motion.velocity)) != 0.0) + 1
    last = np.zeros(z.size, dtype=np.int64)
    last[turned] = turned
    return np.asarray(np.abs(z - z[np.maximum.accumulate(last)]))


def _evidence(columns: Array, residual: Array) -> tuple[float, Array]:
    """Return the log evidence gained by ``columns`` (q, numbers) in ``residual``, and their coefficients.

    Both are of unit noise. The prior variance of all coefficients is the most likely one.
    """
    products = columns @ columns.T
    values, vectors = np.linalg.eigh(products)
    keep = values > 1e-9 * values[-1]
    values, vectors = values[keep], vectors[:, keep]
    seen = vectors.T @ (columns @ residual)
    scale = float(values.mean())
    variances = (WIDTHS**2) / scale
    grown = 1.0 + variances[:, np.newaxis] * values
    logs = -0.5 * np.sum(np.log(grown), axis=1) + 0.5 * np.sum(
        variances[:, np.newaxis] / grown * seen**2, axis=1
    )
    best = int(np.argmax(logs))
    coefficients = -vectors @ (variances[best] / grown[best] * seen)
    return float(max(0.0, logs[best])), coefficients


def _with_rest(readings: Readings) -> Readings:
    """Return the beginning of a record with rest in front of it."""
    record = readings.record
    rest = np.zeros(round(REST / record.sample_period))
    count = min(record.body.size, round(LOOKED_AT / record.sample_period))
    padded = replace(
        record,
        body=np.concatenate([rest, record.body[:count]]),
        spool=np.concatenate([rest, record.spool[:count]]),
        oil_temperature=None,
    )
    found = readings_of(padded, noise=readings.noise)
    if readings.body_limit > 0.0:
        return replace(found, time=-REST)
    # A filter's answer before an excitation that begins at once would push the spool to one side.
    course = Chebyshev.fit(np.arange(record.body.size), record.body, DRIFT)(np.arange(count))
    size = float(np.sqrt(np.mean(course**2)))
    level = abs(float(np.mean(record.body[: _quiet_count(readings)])))
    biased = size > BIASED * float(record.body.std()) and level > FROM_START * size
    begun = padded.body[rest.size :] - (course if biased else 0.0)
    return replace(found, time=-REST, body=np.concatenate([rest, begun]).astype(np.float64))
