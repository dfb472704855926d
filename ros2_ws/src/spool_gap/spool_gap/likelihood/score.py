"""Starts of a fit: the balance of forces along the measured motion, and score tests of what a fit leaves.

Balance: the relative acceleration, integrated once and twice, gives velocity and displacement above a low
frequency; mass times the spool's acceleration is then minus the sum of all forces. Their regression needs no
simulation and has one minimum, and one matrix of products serves every set of effects. It is blunt: noise of
the integrals biases it, and a spool at rest shows nothing.

Score: along the motion of a fit each candidate is a few columns: what it adds to the prediction errors for a
coefficient of 1. Their regression, with the fitted numbers free, gives the rise of the likelihood to first
order and the numbers from which a fit starts. One simulation serves all effects.

Source: Rao, 1948 (score test).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.spectra import ZeroPhase

from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Effect, Motion, Trial
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.structure import CHAIN_PARTS, Limits
from spool_gap.likelihood.structure_fit import LOOSENESS, StructureFit, curvature_of, fit_structure

#: Hz, natural frequencies of a mounting that are tried: a fifth apart, as wide as a mode damped by 5 to 10 %.
MODES = tuple(float(f) for f in np.geomspace(25.0, 800.0, 20))
#: Lines of the residual that are tried as a periodic force.
MOST_LINES = 4
#: Hz around a line of the mains in which none is tried: a hum that comes and goes is wider than a line.
BESIDE_HUM = 2.0

#: Speed over its 80 % quantile from which the spool slips.
SLIPS = 0.1
#: Share of the reversals that count as the slowest: laws of low speeds show at these.
SLOWEST = 0.1
#: Share of the samples within the stroke that the motion uses; beyond, the integrals are in error.
REACH = 0.995
#: Force over that of springs and drag at the ends of the stroke from which it may be a hit, and how often.
#: In 13 cases of development it is 1.2 at most without a stop. Score tests see stops that are softer.
HARD, FEWEST_HARD = 1.4, 2
#: Share of the stroke beyond which its ends begin.
ENDS = 0.7


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
                # Where fits have local minima the fit's own numbers are as good a start.
                rough = EFFECTS[entry.id].local_minima
                moved = {} if rough else self._moved_own(self._columns(trial.columns), coefficients)
                found.append(
                    Proposal(
                        entry.id, {**self._fit.structure.values, **moved, **values}, gain, len(entry.fitted)
                    )
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
        for line in part.readings.hum:
            stands_out[np.abs(frequency - line) < BESIDE_HUM] = 0.0
        found: list[float] = []
        for place in np.argsort(stands_out)[::-1].tolist():
            if len(found) == MOST_LINES:
                break
            if all(abs(frequency[place] - one) > 4.0 / part.seconds for one in found):
                found.append(float(frequency[place]))
        return tuple(found)


def proposals(predictions: Predictions, fit: StructureFit, names: Sequence[str]) -> dict[str, list[Proposal]]:
    """Return what may be added to ``fit`` for each of the effects ``names``: a proposal of each trial.

    By a motion that follows the measured one, which hardly misleads.
    """
    # Reversals of a rough motion are not those of the true one: all samples count.
    with predictions.reversals(counted=True, heard=True):
        score = Score(predictions, fit_structure(predictions, fit.structure, LOOSENESS[:1]))
        return {name: score.of_effect(EFFECTS[name]) for name in names}


def close_proposals(predictions: Predictions, fit: StructureFit, names: Sequence[str]) -> dict[str, Proposal]:
    """Return the best proposal of each of the effects ``names`` by the motion of ``fit`` itself.

    It shows what is small, where ``fit`` is nearly right.
    """
    score = Score(predictions, fit)
    found = {name: score.of_effect(EFFECTS[name]) for name in names}
    return {name: best_of(rows) for name, rows in found.items() if rows}


def parts_of(predictions: Predictions, fit: StructureFit) -> list[Proposal]:
    """Return the best proposal of each part of the chain that ``fit`` does not have, best first."""
    return sorted(Score(predictions, fit).of_parts(), key=lambda one: -one.gain)


def best_of(rows: Sequence[Proposal]) -> Proposal:
    """Return the proposal with the largest gain."""
    return max(rows, key=lambda one: one.gain)


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
        hit: whether the spool may hit something: springs and drag do not make the largest of its forces.
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
        largest = stiffness * self.reach + damping * float(np.quantile(speed, REACH))
        strong = part.valve.moving_mass * np.abs(part.spool) * part.counted > HARD * largest
        # A spike of a sensor is as strong, and anywhere in the stroke.
        outside = np.abs(self.motion.displacement) > ENDS * self.reach
        self.hit = int((strong & outside).sum()) >= max(FEWEST_HARD, int((strong & ~outside).sum()))
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
            stiffness, damping = float(solved[0]), max(float(solved[1]), 0.0)
            values = {"spring_stiffness": stiffness, "viscous_coefficient": damping}
            # Numbers that are shares of these are shares of the values solved here, not of those of the base.
            motion = replace(self.motion, stiffness=stiffness, damping=damping)
            found = self._values(names, trials, solved[2:], motion)
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
            values = self._values([name], [(trial, cut)], solved[1:], self.motion)
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
        self, names: Sequence[str], trials: Sequence[tuple[Trial, slice]], solved: Array, motion: Motion
    ) -> dict[str, float] | None:
        """Return the numbers of the effects ``names`` for coefficients of their trials, if they are any."""
        found: dict[str, float] = {}
        begin = 0
        for name, (trial, cut) in zip(names, trials, strict=True):
            own = solved[begin : begin + cut.stop - cut.start]
            begin += own.size
            values = EFFECTS[name].values(own, trial.shape, motion)
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


def resolved_by(predictions: Predictions) -> Limits:
    """Return what the longest stretch resolves of laws of friction, by the measured motion."""
    part = max(predictions.parts, key=lambda one: one.seconds)
    relative: Array = part.spool - part.body
    band = ZeroPhase(part.period, part.readings.low_cut)
    velocity, displacement = band.apply(relative, 1), band.apply(relative, 2)
    turns = np.abs(relative[:-1][np.diff(np.sign(velocity)) != 0.0])
    slowest = part.period * float(np.quantile(turns, SLOWEST)) if turns.size else 0.0
    return Limits(slowest, float(np.abs(displacement).max()))


def _measured(part: Prediction, band: ZeroPhase, mass: float, stiffness: float, damping: float) -> Motion:
    relative: Array = part.spool - part.body
    velocity, displacement = band.apply(relative, 1), band.apply(relative, 2)
    time: Array = part.readings.time + np.arange(part.size, dtype=np.float64) * part.period
    noise = float(np.sqrt(part.readings.noise.spool / (4.0 * np.pi**2 * part.readings.low_cut)))
    return Motion(
        displacement, velocity, relative, time, part.period, noise, mass, stiffness, damping,
        (), part.spool, part.readings.low_cut,
    )  # fmt: skip
