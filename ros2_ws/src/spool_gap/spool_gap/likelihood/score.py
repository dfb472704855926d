"""Score tests: which effect or part of the chain would explain what a fit leaves, and with which numbers.

Along the motion of a fit each candidate is a few columns: what it adds to the prediction errors for a
coefficient of 1. Their regression, with the fitted numbers free, gives the rise of the likelihood to first
order and the numbers from which a fit starts. One simulation serves all effects.

Source: Rao, 1948 (score test).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spool_gap.effect import Effect, Motion
from spool_gap.registry import EFFECTS

from .chain_part import CHAIN_PARTS
from .prediction import Predictions
from .structure_fit import LOOSENESS, StructureFit, curvature_of, fit_structure

Array = NDArray[np.float64]

#: Hz, natural frequencies of a mounting that are tried: a fifth apart, as wide as a mode damped by 5 to 10 %.
MODES = tuple(float(f) for f in np.geomspace(25.0, 800.0, 20))
#: Lines of the residual that are tried as a periodic force.
MOST_LINES = 4


@dataclass(frozen=True, slots=True)
class Proposal:
    """What may be added to a fit.

    Attributes:
        name: of an effect, or key of a part.
        values: numbers to start from, those of the fit among them.
        gain: rise of the log likelihood, to first order.
        count: numbers that it adds.
    """

    name: str
    values: Mapping[str, float]
    gain: float
    count: int


class Score:
    """Score tests at one fit.

    Attributes:
        motion: of all stretches, one after the other.
    """

    def __init__(self, predictions: Predictions, fit: StructureFit) -> None:
        """Work out the motion of ``fit`` and what its own numbers explain."""
        self._predictions, self._fit = predictions, fit
        self._weights = predictions.weights(fit.lines)
        residual = predictions.weighed(fit.lines, self._weights)
        slopes = curvature_of(predictions, fit).slopes
        scales = np.linalg.norm(slopes, axis=1) + 1e-300
        self._own: Array = (slopes / scales[:, np.newaxis]).T
        self._basis: Array = np.linalg.qr(self._own)[0]
        self._scales = scales
        self._residual = residual
        self._left = residual - self._basis @ (self._basis.T @ residual)
        self.motion, self._cuts = self._moved()

    # Candidates -----------------------------------------------------------------------------------------

    def of_effect(self, entry: Effect) -> list[Proposal]:
        """Return the proposals of the effect ``entry``, in the order of its trials."""
        found = []
        for trial in entry.trials(self.motion):
            if not trial.columns.size:
                continue
            coefficients, gain = self._regressed(self._columns(trial.columns))
            values = entry.values(coefficients, trial.shape, self.motion)
            if set(trial.shape) >= set(entry.fitted):
                # Along a motion with play a regression does not tell how much there is.
                values = dict(trial.shape)
            if values is not None:
                found.append(
                    self._proposal(entry.id, values, gain, len(entry.fitted), trial.columns, coefficients)
                )
        return found

    def of_parts(self) -> Iterator[Proposal]:
        """Yield the best proposal of each part of the chain that the fit does not have."""
        for key, part in CHAIN_PARTS.items():
            if key in self._fit.structure.parts:
                continue
            size = part.parameters[0]
            starts = [{}] if part.id != "extra_mode" else [{part.parameters[1].name: one} for one in MODES]
            best: Proposal | None = None
            own, looseness = self._fit.structure, self._fit.looseness
            for start in starts:
                trial = own.having(own.effects, (*own.parts, key), {size.name: 0.01 * size.start, **start})
                lines = [
                    one.lines_of_part(part, trial.values, own, looseness, errors)
                    for one, errors in zip(self._predictions.parts, self._fit.lines, strict=True)
                ]
                column = self._predictions.weighed(lines, self._weights)
                coefficients, gain = self._regressed(column[np.newaxis])
                value = float(np.clip(coefficients[0], size.low, size.high))
                if value == 0.0 or gain <= (best.gain if best else 0.0):
                    continue
                moved = self._moved_own(column[np.newaxis], np.array([value]))
                best = Proposal(key, {**trial.values, **moved, size.name: value}, gain, len(part.parameters))
            if best is not None:
                yield best

    def left_with(self, forces: Array) -> tuple[Array, Array]:
        """Return what ``forces`` (q, n) add to the weighed errors, and these, without the fit's numbers."""
        columns = self._columns(forces)
        return columns - (columns @ self._basis) @ self._basis.T, self._left

    # Regression -----------------------------------------------------------------------------------------

    def _columns(self, forces: Array) -> Array:
        """Return what ``forces`` (q, n) along the motion add to the weighed errors, shape (q, numbers)."""
        own, looseness = self._fit.structure, self._fit.looseness
        lines = [
            part.lines_of_forces(forces[:, cut], own, looseness)
            for part, cut in zip(self._predictions.parts, self._cuts, strict=True)
        ]
        return self._predictions.weighed(lines, self._weights)

    def _regressed(self, columns: Array) -> tuple[Array, float]:
        """Return the coefficients of ``columns`` (q, numbers) and the rise of the log likelihood."""
        free = columns - (columns @ self._basis) @ self._basis.T
        size = np.linalg.norm(free, axis=1) + 1e-300
        # What the fit's own numbers do as well cannot be told from them.
        usable = size > 1e-3 * (np.linalg.norm(columns, axis=1) + 1e-300)
        coefficients = np.zeros(size.size)
        if not usable.any():
            return coefficients, 0.0
        scaled = (free[usable] / size[usable, np.newaxis]).T
        solved = -np.linalg.lstsq(scaled, self._left, rcond=1e-6)[0]
        coefficients[usable] = solved / size[usable]
        left = self._left + scaled @ solved
        return coefficients, 0.5 * float(self._left @ self._left - left @ left)

    def _proposal(
        self,
        name: str,
        values: Mapping[str, float],
        gain: float,
        count: int,
        forces: Array,
        coefficients: Array,
    ) -> Proposal:
        # Where fits have local minima the fit's own numbers are as good a start.
        rough = EFFECTS[name].local_minima
        moved = {} if rough else self._moved_own(self._columns(forces), coefficients)
        return Proposal(name, {**self._fit.structure.values, **moved, **values}, gain, count)

    def _moved_own(self, columns: Array, coefficients: Array) -> dict[str, float]:
        """Return the fit's own numbers, moved to where they are with ``columns``."""
        change = (
            -np.linalg.lstsq(self._own, self._residual + coefficients @ columns, rcond=1e-6)[0] / self._scales
        )
        own = self._fit.structure.values
        return {
            name: own[name] + float(np.clip(delta, -0.5 * abs(own[name]) - 0.05, 0.5 * abs(own[name]) + 0.05))
            for name, delta in zip(self._fit.names, change.tolist(), strict=True)
        }

    def _moved(self) -> tuple[Motion, list[slice]]:
        own = self._fit.structure
        rows: list[tuple[Array, ...]] = []
        cuts, begin = [], 0
        noise = 0.0
        for part in self._predictions.parts:
            errors = part.errors([own], self._fit.looseness)
            time = part.readings.time + np.arange(part.size, dtype=np.float64) * part.period
            rows.append(
                (
                    errors.displacement,
                    errors.velocity,
                    np.gradient(errors.velocity, part.period),
                    time,
                    part.spool,
                )
            )
            cuts.append(slice(begin, begin + part.size))
            begin += part.size
            # White noise of the reading above the lowest frequency, integrated.
            noise = max(
                noise, float(np.sqrt(part.readings.noise.spool / (4.0 * np.pi**2 * part.readings.low_cut)))
            )
        z, v, a, time, reading = (np.concatenate(row) for row in zip(*rows, strict=True))
        first = self._predictions.parts[0]
        motion = Motion(
            z, v, a, time, first.period, noise,
            own.values["mass"], own.values["spring_stiffness"], own.values.get("viscous_coefficient", 0.0),
            self._residual_lines(), reading, first.readings.low_cut,
        )  # fmt: skip
        return motion, cuts

    def _residual_lines(self) -> tuple[float, ...]:
        """Return frequencies (Hz) that stand out of the errors of the longest stretch, strongest first."""
        part = max(self._predictions.parts, key=lambda one: one.seconds)
        series = part.errors([self._fit.structure], self._fit.looseness).series * part.counted
        length = 4 * series.size
        power = np.abs(np.fft.rfft(series * np.hanning(series.size), length)) ** 2
        frequency = np.fft.rfftfreq(length, part.period)
        band = (frequency > part.lines[0]) & (frequency < part.lines[-1])
        power, frequency = power[band], frequency[band]
        width = max(64, power.size // 100)
        count = power.size // width
        level = np.median(power[: count * width].reshape(count, width), axis=1)
        centres = (np.arange(count) + 0.5) * width
        stands_out = power / np.interp(np.arange(power.size), centres, np.maximum(level, 1e-300))
        found: list[float] = []
        for place in np.argsort(stands_out)[::-1].tolist():
            if len(found) == MOST_LINES:
                break
            if all(abs(frequency[place] - one) > 4.0 / part.seconds for one in found):
                found.append(float(frequency[place]))
        return tuple(found)


def proposals(predictions: Predictions, fit: StructureFit, names: Sequence[str]) -> list[list[Proposal]]:
    """Return what may be added to ``fit`` for each of the effects ``names`` and each part, best first."""
    # Reversals of a rough motion are not those of the true one: all samples count.
    with predictions.reversals(counted=True, heard=True):
        score = Score(predictions, fit_structure(predictions, fit.structure, LOOSENESS[:1]))
        found = [score.of_effect(EFFECTS[name]) for name in names]
        found += [[one] for one in score.of_parts()]
    return sorted((one for one in found if one), key=lambda rows: -best_of(rows).gain)


def best_of(rows: Sequence[Proposal]) -> Proposal:
    """Return the proposal with the largest gain."""
    return max(rows, key=lambda one: one.gain)


def loosened(predictions: Predictions, fit: StructureFit) -> StructureFit:
    """Return ``fit`` with the loosest correction, where its motion is the measured one."""
    if fit.looseness == LOOSENESS[0]:
        return fit
    return fit_structure(predictions, fit.structure, LOOSENESS[:1])
