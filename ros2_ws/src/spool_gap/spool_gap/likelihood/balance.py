"""Balance of forces along the measured motion while the spool slips: where fits of structures start.

The relative acceleration, integrated once and twice, gives velocity and displacement above a low frequency;
mass times the spool's acceleration is then minus the sum of all forces. Their regression needs no simulation
and has one minimum, and one matrix of products serves every set of effects. It is blunt: noise of the
integrals biases it, and a spool at rest tells nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.spectra import ZeroPhase

from spool_gap.effect import Motion, Trial
from spool_gap.registry import EFFECTS

from .prediction import Prediction, Predictions

Array = NDArray[np.float64]

#: Speed over its 80 % quantile from which the spool slips.
SLIPS = 0.1
#: Share of the samples within the stroke that the motion uses; beyond, the integrals are in error.
REACH = 0.995


@dataclass(frozen=True, slots=True)
class Balanced:
    """Effects that the balance of forces was solved with.

    Attributes:
        left: force that they leave, N rms.
        values: their numbers and those of the base.
    """

    left: float
    values: dict[str, float]


class Balance:
    """Forces along the measured motion of the longest stretch.

    Attributes:
        motion: as measured.
        left: force that the base leaves, N rms.
        reach: displacement at the ends of the stroke, m.
    """

    def __init__(
        self, predictions: Predictions, stiffness: float, damping: float, names: Sequence[str]
    ) -> None:
        """Integrate the motion and work out the forces of the effects ``names`` along it.

        Args:
            predictions: of the record.
            stiffness, damping: of the base as fitted, N/m and N s/m.
            names: of effects.
        """
        part = max(predictions.parts, key=lambda one: one.seconds)
        band = ZeroPhase(part.period, part.readings.low_cut)
        self.motion = _measured(part, band, part.valve.moving_mass, stiffness, damping)
        self.reach = float(np.quantile(np.abs(self.motion.displacement), REACH))
        speed = np.abs(self.motion.velocity)
        slips = speed > SLIPS * float(np.quantile(speed, 0.8))
        edge = min(speed.size // 4, round(2.0 / part.period))
        slips[:edge] = slips[-edge:] = False
        slips &= part.counted > 0.5
        self._slips, self._band, self._part = slips, band, part
        force = -part.valve.moving_mass * band.apply(part.spool)[slips]
        rows = [force, self.motion.displacement[slips], self.motion.velocity[slips]]
        self._trials: dict[str, list[tuple[Trial, slice]]] = {}
        for name in names:
            self._trials[name] = []
            for trial in EFFECTS[name].trials(self.motion):
                if trial.columns.size:
                    cut = slice(len(rows), len(rows) + len(trial.columns))
                    rows += list(band.apply(trial.columns)[:, slips])
                    self._trials[name].append((trial, cut))
        everything = np.array(rows)
        self._scales: Array = np.linalg.norm(everything, axis=1) + 1e-300
        everything /= self._scales[:, np.newaxis]
        self._rows: Array = everything
        self._products: Array = everything @ everything.T
        self._size = max(1, force.size)
        self.left: float = self._solved([1, 2])[0]

    def starts(self, names: Sequence[str]) -> Iterator[Balanced]:
        """Yield what the effects ``names`` together leave, for each choice of their trials."""
        for trials in itertools.product(*(self._trials[name] for name in names)):
            places = [1, 2, *(place for _, cut in trials for place in range(cut.start, cut.stop))]
            left, solved = self._solved(places)
            if solved[0] <= 0.0:
                continue
            values = {"spring_stiffness": float(solved[0]), "viscous_coefficient": max(float(solved[1]), 0.0)}
            found = self._values(names, trials, solved[2:])
            if found is not None:
                yield Balanced(left, {**values, **found})

    def like(self, name: str, force: Array) -> list[Balanced]:
        """Return numbers with which the effect ``name`` and some drag act like ``force`` (n,), best first.

        Their "viscous_coefficient" is what the drag changes by.
        """
        target = self._band.apply(force)[self._slips]
        size = float(np.linalg.norm(target)) + 1e-300
        seen = self._rows @ (target / size)
        found = []
        for trial, cut in self._trials[name]:
            places = [2, *range(cut.start, cut.stop)]
            solved = np.linalg.lstsq(self._products[np.ix_(places, places)], seen[places], rcond=1e-10)[0]
            left = size * float(np.sqrt(max(0.0, 1.0 - float(solved @ seen[places])) / self._size))
            solved = solved * size / self._scales[places]
            values = self._values([name], [(trial, cut)], solved[1:])
            if values is not None:
                found.append(Balanced(left, {"viscous_coefficient": float(solved[0]), **values}))
        return sorted(found, key=lambda one: one.left)

    def force_of(self, terms: Sequence[str], values: Mapping[str, float]) -> Array:
        """Return the force of ``terms`` with ``values`` along the motion, N, shape (n,)."""
        motion = next(entry for entry in self._part.motions if entry.has(terms))
        row = np.array([motion.row(("inertia", *terms), values)])
        first = round(self._part.readings.time / self._part.period)
        own = self.motion
        return np.asarray(
            motion.forces(own.displacement, own.velocity, row, sample_period=own.period, first_sample=first)[
                0
            ]
        )

    def _values(
        self, names: Sequence[str], trials: Sequence[tuple[Trial, slice]], solved: Array
    ) -> dict[str, float] | None:
        """Return the numbers of the effects ``names`` for coefficients of their trials, if they are any."""
        found: dict[str, float] = {}
        begin = 0
        for name, (trial, cut) in zip(names, trials, strict=True):
            own = solved[begin : begin + cut.stop - cut.start]
            begin += own.size
            values = EFFECTS[name].values(own, trial.shape, self.motion)
            if values is None:
                return None
            found |= values
        return found

    def _solved(self, places: Sequence[int]) -> tuple[float, Array]:
        """Return what the forces at ``places`` leave, N rms, and their coefficients."""
        seen = self._products[places, 0]
        solved = np.linalg.lstsq(self._products[np.ix_(places, places)], seen, rcond=1e-10)[0]
        left = max(0.0, 1.0 - float(solved @ seen)) / self._size
        return float(np.sqrt(left) * self._scales[0]), solved * self._scales[0] / self._scales[places]


def _measured(part: Prediction, band: ZeroPhase, mass: float, stiffness: float, damping: float) -> Motion:
    relative: Array = part.spool - part.body
    velocity, displacement = band.apply(relative, 1), band.apply(relative, 2)
    time: Array = part.readings.time + np.arange(part.size, dtype=np.float64) * part.period
    noise = float(np.sqrt(part.readings.noise.spool / (4.0 * np.pi**2 * part.readings.low_cut)))
    return Motion(
        displacement, velocity, relative, time, part.period, noise, mass, stiffness, damping,
        (), part.spool, part.readings.low_cut,
    )  # fmt: skip
