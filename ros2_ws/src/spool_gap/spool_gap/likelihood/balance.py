"""Balance of forces along the measured motion while the spool slips: where fits of structures start.

The relative acceleration, integrated once and twice, gives velocity and displacement above a low frequency;
mass times the spool's acceleration is then minus the sum of all forces. Their regression needs no simulation
and has one minimum. It is blunt: noise of the integrals biases it, and a spool at rest tells nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.spectra import ZeroPhase

from spool_gap.effect import Effect, Motion

from .prediction import Prediction, Predictions

Array = NDArray[np.float64]

#: Speed over its 80 % quantile from which the spool slips.
SLIPS = 0.1


class Balance:
    """Forces along the measured motion of the longest stretch.

    Attributes:
        motion: as measured.
    """

    def __init__(self, predictions: Predictions, stiffness: float, damping: float) -> None:
        """Integrate the motion; ``stiffness`` (N/m) and ``damping`` (N s/m) are those of the fitted base."""
        part = max(predictions.parts, key=lambda one: one.seconds)
        self._mass = part.valve.moving_mass
        self._band = ZeroPhase(part.period, part.readings.low_cut)
        self.motion = _measured(part, self._band, self._mass, stiffness, damping)
        speed = np.abs(self.motion.velocity)
        slips = speed > SLIPS * float(np.quantile(speed, 0.8))
        edge = min(speed.size // 4, round(2.0 / part.period))
        slips[:edge] = slips[-edge:] = False
        self._slips = slips & (part.counted > 0.5)
        self._force = -self._mass * self._band.apply(part.spool)[self._slips]
        self._base = np.array([self.motion.displacement, self.motion.velocity])[:, self._slips]
        self.left: float = self._solved(self._base)[0]

    def _solved(self, rows: Array) -> tuple[float, Array]:
        """Return what forces ``rows`` (q, n) leave, N rms, and their coefficients."""
        scales = np.linalg.norm(rows, axis=1) + 1e-300
        scaled = rows / scales[:, np.newaxis]
        solved = np.linalg.lstsq(scaled.T, self._force, rcond=1e-9)[0]
        return float(np.sqrt(np.mean((self._force - solved @ scaled) ** 2))), solved / scales

    def starts(self, entry: Effect) -> Iterator[tuple[float, dict[str, float]]]:
        """Yield the error that each trial of ``entry`` leaves, N rms, and its numbers with the base's."""
        for trial in entry.trials(self.motion):
            if not trial.columns.size:
                continue
            columns = self._band.apply(trial.columns)[:, self._slips]
            left, solved = self._solved(np.concatenate([self._base, columns]))
            stiffness, damping, *coefficients = solved.tolist()
            values = entry.values(np.array(coefficients), trial.shape, self.motion)
            if values is not None and stiffness > 0.0:
                base = {"spring_stiffness": stiffness, "viscous_coefficient": max(damping, 0.0)}
                yield left, {**base, **values}


def _measured(part: Prediction, band: ZeroPhase, mass: float, stiffness: float, damping: float) -> Motion:
    relative: Array = part.spool - part.body
    velocity, displacement = band.apply(relative, 1), band.apply(relative, 2)
    time: Array = part.readings.time + np.arange(part.size, dtype=np.float64) * part.period
    noise = float(np.sqrt(part.readings.noise.spool / (4.0 * np.pi**2 * part.readings.low_cut)))
    return Motion(
        displacement, velocity, relative, time, part.period, noise, mass, stiffness, damping,
        (), part.spool, part.readings.low_cut,
    )  # fmt: skip
