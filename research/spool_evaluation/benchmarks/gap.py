"""Benchmark of naming what is hidden in field cases without nuisances, against PySINDy."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import median_filter
from spool_blind.field.case import make_field
from spool_blind.field.hiding import field_hidden_by
from spool_blind.hidden import NONE
from spool_core.numbers import Array
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import RelativeMotion, ZeroPhase, relative_motion
from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Motion
from spool_sim.valve import Valve

from spool_evaluation.results.timing import Stopwatch, Timing
from spool_evaluation.studies.estimation import given
from spool_evaluation.studies.field.study import judge_field
from spool_evaluation.studies.field.verdicts import RIGHT

CASES = 12
LATE = ("pysindy",)  # loaded where it is asked for
#: Of the first record, of the window that no choice has touched.
FRESH = 590_000
PEERS = {"PySINDy STLSQ": False, "PySINDy ensemble": True}


#: Hz, below which integrals of accelerations say nothing.
LOW_CUT = 3.0
#: Smallest coefficients that are kept, of columns and target of unit rms, and weights of the ridge; the pair
#: with the least error on the held-out stretches is taken.
THRESHOLDS = (0.001, 0.003, 0.01, 0.02, 0.05, 0.1, 0.2)
RIDGES = (1e-6, 1e-3, 1.0)
MODELS = 20
#: Samples at most, about; so many columns in more of them keep the ensemble busy for minutes.
LARGEST = 8000
#: Stretches of a record, in turn for the fit and held out; what changes along the record is in both.
STRETCHES = 20
#: Sines from outside that are offered, and lines of the spectrum around one that it must stand out of.
LINES, SURROUNDINGS = 3, 41
BASE = "base"


def run(seed: int = FRESH, cases: int = CASES) -> Iterator[Timing]:
    """Yield per peer one row for the share not named right and one for false terms a record.

    The records are the first from ``seed`` on that hide nothing or what a library of terms can hold.
    """
    ours_s, ours_wrong, ours_false = 0.0, 0, 0
    peer_s = dict.fromkeys(PEERS, 0.0)
    peer_wrong, peer_false = dict.fromkeys(PEERS, 0), dict.fromkeys(PEERS, 0)
    for number in seeds(cases, seed):
        case = make_field(number, nuisances=())
        hidden = frozenset(case.hidden.split("+")) - {NONE}
        row = judge_field(case)
        ours_s += row.seconds
        ours_wrong += row.outcome != RIGHT
        ours_false += len(row.said - hidden)
        record, valve = given(case)
        for peer, ensemble in PEERS.items():
            watch = Stopwatch()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it warns of every threshold that removes all columns
                found = named(library(record, valve), ensemble=ensemble)
            peer_s[peer] += watch.read()[0]
            peer_wrong[peer] += found != hidden
            peer_false[peer] += len(found - hidden)
    work = f"name what is hidden, {cases} records from seed {seed}"
    for peer in PEERS:
        wrong = ("not right", ours_wrong, peer_wrong[peer]), ("false terms", ours_false, peer_false[peer])
        for what, ours, theirs in wrong:
            times = ours_s / cases, peer_s[peer] / cases
            yield Timing(f"{work}: {what}", peer, *times, ours / cases, theirs / cases)


def seeds(count: int, seed: int = FRESH) -> list[int]:
    """Return the first ``count`` from ``seed`` on whose case hides nothing or forces of the catalogue."""
    found: list[int] = []
    while len(found) < count:
        hidden = field_hidden_by(seed)
        if hidden == NONE or all(name in EFFECTS and EFFECTS[name].terms for name in hidden.split("+")):
            found.append(seed)
        seed += 1
    return found


@dataclass(frozen=True, slots=True)
class Library:
    """Library of columns for a regression.

    Attributes:
        target: inertia of the spool, N, shape (n,).
        columns: shape (n, c).
        owners: "base" or the id of the effect that brings the column, by column.
    """

    target: Array
    columns: Array
    owners: tuple[str, ...]


def library(record: Record, valve: Valve) -> Library:
    """Return spring, drag and every shape of every effect at the measured motion, all conditioned alike.

    Shapes are the ones that our own search begins with, such as nine gaps of an end stop; of sines from
    outside, those at the ``LINES`` frequencies that stand out most of what spring and drag leave.
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
        peaks=_lines(valve.moving_mass * motion.spool, motion, record.sample_period),
    )
    rows: list[Array] = [motion.displacement, motion.velocity]
    owners = [BASE, BASE]
    for effect in EFFECTS.values():
        if "accelerations" not in effect.kinds or not effect.terms:
            continue
        for shape in effect.shapes(seen):
            rows += list(effect.signature(seen, shape))
        owners += [effect.id] * (len(rows) - len(owners))
    # Every so many samples: these still have the band's content, and the ensemble ends in seconds.
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
    """Return the effects whose columns PySINDy keeps, at the setting with the least held-out error.

    An ensemble takes the ridge that does best without one, and searches its own threshold.
    """
    coefficients, ridge = _best(given, RIDGES, ensemble=False)
    if ensemble:
        coefficients, _ = _best(given, (ridge,), ensemble=True)
    return frozenset(given.owners[place] for place in np.flatnonzero(coefficients)) - {BASE}


def _lines(target: Array, motion: RelativeMotion, period: float) -> tuple[float, ...]:
    """Return the frequencies (Hz) at which the residual of spring and drag exceeds its surroundings most."""
    base = np.column_stack([motion.displacement, motion.velocity])
    left = target - base @ np.linalg.lstsq(base, target, rcond=None)[0]
    size = np.abs(rfft(left * np.hanning(left.size)))
    frequency = rfftfreq(left.size, period)
    height = np.where(frequency > LOW_CUT, size / (median_filter(size, SURROUNDINGS) + 1e-300), 0.0)
    found: list[float] = []
    while len(found) < LINES:
        place = int(np.argmax(height))
        found.append(float(frequency[place]))
        height[max(0, place - SURROUNDINGS // 4) : place + SURROUNDINGS // 4 + 1] = 0.0
    return tuple(found)


def _best(given: Library, ridges: Sequence[float], *, ensemble: bool) -> tuple[Array, float]:
    """Return coefficients and ridge with the least error on the held-out stretches."""
    turn = np.arange(given.target.size) * STRETCHES // given.target.size % 2
    fitted, held_out = turn == 0, turn == 1

    def error(found: tuple[Array, float]) -> float:
        return float(np.mean((given.target[held_out] - given.columns[held_out] @ found[0]) ** 2))

    trials = (
        (_fit(given.columns[fitted], given.target[fitted], threshold, ridge, ensemble=ensemble), ridge)
        for threshold, ridge in product(THRESHOLDS, ridges)
    )
    return min(trials, key=error)


def _fit(columns: Array, target: Array, threshold: float, ridge: float, *, ensemble: bool) -> Array:
    import pysindy  # noqa: PLC0415 - slow to load

    optimizer = pysindy.STLSQ(threshold=threshold, alpha=ridge)
    if ensemble:
        optimizer = pysindy.EnsembleOptimizer(optimizer, bagging=True, n_models=MODELS)
    model = pysindy.SINDy(optimizer=optimizer, feature_library=pysindy.IdentityLibrary())
    model.fit(columns, t=1.0, x_dot=target[:, np.newaxis])
    coefficients: Array = np.asarray(model.coefficients(), dtype=np.float64)
    return coefficients.reshape(-1)
