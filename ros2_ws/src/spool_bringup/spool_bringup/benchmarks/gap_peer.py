"""PySINDy asked the question of the gap workflow: the same conditioned signals, the same terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pysindy
from numpy.typing import NDArray
from spool_estimator.gap.effect import Motion
from spool_estimator.gap.registry import EFFECTS
from spool_estimator.record import Record
from spool_estimator.zero_phase import ZeroPhase, relative_motion
from spool_sim.valve import Valve

Array = NDArray[np.float64]

#: Hz, below which integrals of accelerations say nothing.
LOW_CUT = 3.0
#: Smallest coefficients that are kept, of columns and target of unit rms; the best by BIC on the other half.
THRESHOLDS = (0.003, 0.01, 0.02, 0.05, 0.1)
MODELS = 20
#: Samples at most, about.
LARGEST = 20_000
BASE = "base"


@dataclass(frozen=True, slots=True)
class Library:
    """Columns for a regression.

    Attributes:
        target: inertia of the spool, N, shape (n,).
        columns: shape (n, c).
        owners: "base" or the id of the effect that brings the column, by column.
    """

    target: Array
    columns: Array
    owners: tuple[str, ...]


def library(record: Record, valve: Valve) -> Library:
    """Return spring, drag and a signature of each effect at the measured motion, all conditioned alike.

    Of an effect that the catalogue looks for in several shapes the middle one is taken: a library of all of
    them is so nearly dependent that the regression keeps whatever it likes, after minutes.
    """
    conditioning = ZeroPhase(record.sample_period, LOW_CUT)
    motion = relative_motion(record.body, record.spool, conditioning)
    n = record.body.size
    seen = Motion(
        displacement=motion.displacement,
        velocity=motion.velocity,
        acceleration=motion.acceleration,
        time=np.asarray(np.arange(n) * record.sample_period, dtype=np.float64),
        period=record.sample_period,
        velocity_noise=0.0,
        mass=valve.moving_mass,
        stiffness=valve.spring_stiffness,
        damping=valve.viscous_coefficient,
    )
    rows: list[Array] = [motion.displacement, motion.velocity]
    owners = [BASE, BASE]
    for effect in EFFECTS.values():
        if "accelerations" not in effect.kinds or not effect.terms:
            continue
        trials = list(effect.trials(seen))
        if trials:
            columns_of = trials[len(trials) // 2].columns
            rows += list(columns_of)
            owners += [effect.id] * columns_of.shape[0]
    # Every so many samples: what is left still has the band's content, and the ensemble ends in seconds.
    inner = slice(motion.settling, n - motion.settling, max(1, n // LARGEST))
    columns = np.array([conditioning.apply(row)[inner] for row in rows])
    size = np.sqrt(np.mean(columns**2, axis=1))
    alive = size > 0.0
    target = valve.moving_mass * motion.spool[inner]
    return Library(
        target / np.sqrt(np.mean(target**2)),
        (columns[alive] / size[alive, np.newaxis]).T,
        tuple(owner for owner, lives in zip(owners, alive, strict=True) if lives),
    )


def named(given: Library, *, ensemble: bool) -> frozenset[str]:
    """Return the effects whose columns PySINDy keeps, at the threshold with the best BIC."""
    half = given.target.size // 2
    best, kept = float("inf"), frozenset[str]()
    for threshold in THRESHOLDS:
        coefficients = _fit(given.columns[:half], given.target[:half], threshold, ensemble=ensemble)
        left = given.target[half:] - given.columns[half:] @ coefficients
        count = int(np.count_nonzero(coefficients))
        score = left.size * np.log(np.mean(left**2)) + count * np.log(left.size)
        if score < best:
            best, kept = score, _owners(given.owners, coefficients)
    return kept


def _owners(owners: Sequence[str], coefficients: Array) -> frozenset[str]:
    return frozenset(owners[place] for place in np.flatnonzero(coefficients)) - {BASE}


def _fit(columns: Array, target: Array, threshold: float, *, ensemble: bool) -> Array:
    optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-3)
    if ensemble:
        optimizer = pysindy.EnsembleOptimizer(optimizer, bagging=True, n_models=MODELS)
    model = pysindy.SINDy(optimizer=optimizer, feature_library=pysindy.IdentityLibrary())
    model.fit(columns, t=1.0, x_dot=target[:, np.newaxis])
    coefficients: Array = np.asarray(model.coefficients(), dtype=np.float64)
    return coefficients.reshape(-1)
