"""Friction that differs by direction: two accelerometers see that only where the motion starts from rest.

To a moving spool the difference is a constant push, which shifts the middle of the motion but changes no
acceleration. From rest the spool has to travel to that middle first, and rings there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray
from spool_sim.valve import Valve

from spool_gap.likelihood.kernel import SwitchableMotion
from spool_gap.likelihood.prediction import FREE, Prediction
from spool_gap.likelihood.readings import Readings, readings_of
from spool_gap.likelihood.search import DECISIVE
from spool_gap.likelihood.structure import Structure
from spool_gap.likelihood.structure_fit import StructureFit

Array = NDArray[np.float64]

ONE, TWO = "coulomb_friction", "asymmetric_friction"
#: s of rest that are put in front of a record, and s of it that are looked at.
REST, LOOKED_AT = 2.0, 4.0
#: s at the start in which the body must be quiet, and how quiet, over its rms later.
QUIET_TIME, QUIET_SHARE = 0.01, 0.03
#: Mean of the body's reading over its rms from which it is a bias: that of an excitation is smaller.
BIASED = 0.02
#: Degree of the course that a bias drifts by.
DRIFT = 3
#: Ratios (forward - backward) / (forward + backward) that are tried.
RATIOS = np.linspace(-0.9, 0.9, 37)
#: Ratio below which two forces are one: friction scatters by as much from stroke to stroke.
LEAST_RATIO = 0.1
#: Standard deviations of the likelihood's scatter that the evidence must exceed.
SCATTERS = 3.0


@dataclass(frozen=True, slots=True)
class TwoForces:
    """Friction by direction: ``ratio`` with its standard ``deviation``, and the ``evidence`` (log) for it."""

    ratio: float
    deviation: float
    evidence: float


def starts_at_rest(readings: Readings) -> bool:
    """Whether the record begins before the motion does."""
    count = max(4, round(QUIET_TIME / readings.period))
    quiet = max(QUIET_SHARE * float(readings.body.std()), 2.0 * readings.noise.body_rms)
    return readings.time == 0.0 and float(np.std(readings.record.body[:count])) < quiet


def two_forces(
    readings: Sequence[Readings], valve: Valve, motions: Sequence[SwitchableMotion], fit: StructureFit
) -> TwoForces | None:
    """Return what the start from rest says of Coulomb friction in ``fit``; ``None`` where it says nothing."""
    first = next((one for one in readings if starts_at_rest(one)), None)
    if first is None or ONE not in fit.structure.effects:
        return None
    prediction = Prediction(_with_rest(first), valve, motions)
    lines = prediction.errors([_split(fit.structure, ratio) for ratio in RATIOS.tolist()], FREE).lines
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
    return _split(structure, ratio)


def _split(structure: Structure, ratio: float) -> Structure:
    mean = structure.values["coulomb_force"]
    effects = tuple(TWO if name == ONE else name for name in structure.effects)
    forces = {"forward_force": (1.0 + ratio) * mean, "backward_force": (1.0 - ratio) * mean}
    return structure.having(effects, structure.parts, forces)


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
    biased = float(np.sqrt(np.mean(course**2))) > BIASED * float(record.body.std())
    begun = padded.body[rest.size :] - (course if biased else 0.0)
    return replace(found, time=-REST, body=np.concatenate([rest, begun]).astype(np.float64))
