"""Start of a fit: least squares on the equation of motion, and what noise of the input does to it.

Displacement and velocity come from both accelerations without phase; the forces of the model at that motion
and the inertia force pass the same operator, and their sum is made small, from several places where the
balance has several minima.

Noise in the excitation shakes dry friction loose and multiplies with itself in the normal equations: both
bend the parameters by a little that does not average out. It is found by simulation: the model at the point
makes a record, the excitation gets the same noise once added and once taken away, and one step of the descent
shows where the point goes (as SIMEX does, Cook and Stefanski 1994, J. Am. Stat. Assoc. 89).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_core.errors import InputError
from spool_core.numbers import Array

from spool_estimator.identification.fit_result import FILTER, MASS, SPOOL_DELAY, SPOOL_GAIN
from spool_estimator.identification.free_run import FALL, FreeRun, excitation_gain, excitation_limit
from spool_estimator.identification.least_squares import LeastSquares, Unknown, bounds_of, descend, sizes_of
from spool_estimator.identification.record import Record, first_seconds
from spool_estimator.identification.residuals import HIGHEST_SHARE, Residuals, standard_deviations
from spool_estimator.identification.spectra import ZeroPhase, noise_of, relative_motion

#: s of data that the start is taken from.
LONGEST = 8.0
#: Random places that are tried, the decades they spread over, and how many are followed beside the start.
TRIALS, DECADES, FOLLOWED = 24, 1.0, 4
#: Rounds of these descents, the fall of the cost that ends them, and the distance over the size of their ends
#: up to which they are one start.
ROUNDS, ENOUGH, SAME = 20, 1e-5, 0.02
#: Length of step at which, and share of the largest change up to which, an unknown changes nothing.
WIDE, BLIND = 100.0, 1e-9
#: Samples at which the rank of the forces' slopes is judged, and the relative step of these.
SLOPE_SAMPLES, SLOPE_STEP = 4000, 1e-5

#: Pairs of noise, added and taken away. A few will do where none moves an unknown by this share of its
#: deviation.
PAIRS, FEW_PAIRS, NEGLIGIBLE = 6, 2, 0.2
#: Standard deviations up to which a bias is believed.
BELIEVED = 3.0

#: Friction at rest over the largest force of inertia at which the spool does not move, noise included.
HOLDS = 1.5


class EquationError(LeastSquares):
    """The balance of forces of a model at the measured motion.

    Attributes:
        unknowns: parameters of the law that are fitted.
        blind: names of those that change nothing here, such as friction at rest.
    """

    def __init__(self, run: FreeRun, unknowns: Sequence[Unknown], values: Array, low_cut: float) -> None:
        """Condition the records.

        Args:
            run: gives records and model.
            unknowns: what is fitted; a sensor's gain and delay are left as they are.
            values: a full set of parameters, shape (1, p), with start values for the unknowns.
            low_cut: Hz.
        """
        self._run = run
        self._values = values
        self._every = tuple(unknowns)
        self.unknowns = [u for u in unknowns if u.name not in (SPOOL_GAIN, SPOOL_DELAY, *FILTER)]
        self._columns = [run.names.index(unknown.name) for unknown in self.unknowns]
        self._start = values[0, self._columns]
        mass = float(values[0, run.names.index(MASS)])
        self._stretches = []
        for number, some in first_seconds(run.records, LONGEST, shortest=4.0 / low_cut):
            high = 1.5 * max(run.highest_frequency[number], 30.0)
            both = ZeroPhase(some.sample_period, low_cut, high)
            motion = relative_motion(some.body, some.spool, ZeroPhase(some.sample_period, low_cut))
            inside = slice(both.settling, some.body.size - both.settling)
            self._stretches.append(
                _Stretch(
                    motion.displacement,
                    motion.velocity,
                    mass * both.apply(motion.spool)[inside],
                    some.first_sample,
                    some.sample_period,
                    both,
                    inside,
                )
            )
        self._inertia = np.concatenate([one.inertia for one in self._stretches] or [np.empty(0)])
        slopes = self.slopes(self._start, self.residuals(self._start[np.newaxis])[0], WIDE)
        shown = np.linalg.norm(slopes, axis=1) * sizes_of(self.unknowns, self._start)
        self.blind = tuple(
            unknown.name
            for unknown, one in zip(self.unknowns, shown.tolist(), strict=True)
            if one <= BLIND * float(shown.max(initial=0.0))
        )

    def residuals(self, points: Array) -> Array:
        """Return inertia and conditioned forces at ``points`` (s, u), N, shape (s, all samples)."""
        sets = np.repeat(self._values, points.shape[0], axis=0)
        sets[:, self._columns] = points
        rows = [
            stretch.conditioning.apply(
                self._run.motion.forces(
                    stretch.displacement,
                    stretch.velocity,
                    sets,
                    sample_period=stretch.sample_period,
                    first_sample=stretch.first_sample,
                )
            )[:, stretch.inside]
            for stretch in self._stretches
        ]
        return np.asarray(np.concatenate([*rows, np.empty((len(points), 0))], axis=1) + self._inertia)

    def costs(self, residuals: Array) -> Array:
        """Return the sums of squares of ``residuals`` (s, m), shape (s,)."""
        return np.asarray(np.nan_to_num(np.sum(residuals**2, axis=1), nan=np.inf))

    def force_slopes(self, point: Array) -> Array:
        """Return the slopes of the forces at the measured motion and at rest, shape (rows, all unknowns).

        Not filtered and not simulated, hence smooth: their rank shows which unknowns act only together. A
        sensor's unknowns have separate rows. The inertia balances the forces: that is the column of a
        mass, as two accelerometers show forces over the mass only.
        """
        own = np.array([point[self._every.index(unknown)] for unknown in self.unknowns])
        step = SLOPE_STEP * sizes_of(self.unknowns, own)
        low, high = bounds_of(self.unknowns)
        lows, highs = np.maximum(own - step, low), np.minimum(own + step, high)
        columns = []
        for place in range(own.size):
            ends = np.repeat(own[np.newaxis], 2, axis=0)
            ends[:, place] = lows[place], highs[place]
            rows = self._unfiltered_forces(ends)
            columns.append((rows[1] - rows[0]) / (highs[place] - lows[place]))
            if self.unknowns[place].name == MASS:
                columns[-1] = -self._unfiltered_forces(own[np.newaxis])[0] / own[place]
        slopes = np.zeros((columns[0].size + len(self._every), len(self._every)))
        for unknown, column in zip(self.unknowns, columns, strict=True):
            slopes[: column.size, self._every.index(unknown)] = column
        for number, unknown in enumerate(self._every):
            if unknown not in self.unknowns:
                slopes[columns[0].size + number, number] = 1.0
        return slopes

    def _unfiltered_forces(self, points: Array) -> Array:
        """Return forces at some measured motion, and what friction takes up at rest, N, shape (s, rows)."""
        sets = np.repeat(self._values, points.shape[0], axis=0)
        sets[:, self._columns] = points
        parts = []
        for stretch in self._stretches[:1]:
            some = slice(stretch.inside.start, stretch.inside.start + SLOPE_SAMPLES)
            parts.append(
                self._run.motion.forces(
                    stretch.displacement[some],
                    stretch.velocity[some],
                    sets,
                    sample_period=stretch.sample_period,
                    first_sample=stretch.first_sample,
                )
            )
        # As many rows as weigh like the motion.
        repeated = np.repeat(self._at_rest(sets), SLOPE_SAMPLES // 4, axis=1)
        return np.concatenate([*parts, repeated], axis=1)

    def _at_rest(self, sets: Array) -> Array:
        """Return the lowest and the highest force of friction at rest, N, shape (s, 2)."""
        found = []
        for row in sets.tolist():
            named = dict(zip(self._run.names, row, strict=True))
            ends = [entry.at_rest(0.0, named) for entry in self._run.motion.terms]
            found.append([sum(low for low, _ in ends), sum(high for _, high in ends)])
        return np.array(found)

    def held(self, point: Array) -> Array | None:
        """Return ``point`` (u,) with friction that holds the spool throughout; ``None`` where none can.

        No regression finds it: in a record of a spool that sticks, the motion is noise.
        """
        most = float(np.abs(self._inertia).max(initial=0.0))
        found = point.copy()
        places = [self._every.index(unknown) for unknown in self.unknowns]

        def least(own: Array) -> float:
            sets = self._values.copy()
            sets[:, self._columns] = own[places]
            return float(np.abs(self._at_rest(sets)).min())

        for place, unknown in zip(places, self.unknowns, strict=True):
            while (now := least(found)) < HOLDS * most:
                more = found.copy()
                more[place] = min(2.0 * max(found[place], unknown.size(0.0)), unknown.high)
                if not least(more) > now:
                    break
                found = more
        return found if least(found) >= HOLDS * most else None

    def starts(self) -> list[Array]:
        """Return points (all unknowns) to start from, best first; the given start where no data tells one."""
        if not self._stretches or len(self.blind) == len(self.unknowns):
            return [self._complete(self._start)]
        generator = np.random.default_rng(1)
        sizes = np.where(self._start != 0.0, self._start, sizes_of(self.unknowns, self._start))
        spread = 10.0 ** generator.uniform(-DECADES, DECADES, (TRIALS, sizes.size))
        trials = np.clip(sizes * spread, *bounds_of(self.unknowns))
        trials = trials[np.argsort(self.costs(self.residuals(trials)))[:FOLLOWED]]
        ends = [descend(self, one[np.newaxis], ROUNDS, ENOUGH) for one in (self._start, *trials)]
        ends.sort(key=lambda end: end.cost)
        found: list[Array] = []
        for end in ends:
            near = SAME * sizes_of(self.unknowns, end.point)
            if not any((np.abs(end.point - other) <= near).all() for other in found):
                found.append(end.point)
        return [self._complete(point) for point in found]

    def _complete(self, own: Array) -> Array:
        """Return the point of all unknowns: sensors without error."""
        place = {unknown.name: float(value) for unknown, value in zip(self.unknowns, own, strict=True)}
        return np.array([place.get(unknown.name, 0.0) for unknown in self._every])


@dataclass(frozen=True, slots=True)
class NoiseEffect:
    """By how much the noise of the excitation moves the u unknowns.

    Attributes:
        bias: on the average, shape (u,).
        covariance: from one noise to another, shape (u, u).
        uncertainty: standard deviation of ``bias``, shape (u,).
    """

    bias: Array
    covariance: Array
    uncertainty: Array

    def taken_off(self, point: Array, covariance: Array) -> tuple[Array, Array]:
        """Return ``point`` (u,) and its ``covariance`` (u, u) without the bias, with what is unsure of it.

        Half of the bias stays in the covariance, all of it where it is too large for one step to be right.
        """
        seen = np.maximum(1.0, np.diag(self.covariance) / np.diag(covariance))
        grown = covariance * np.sqrt(np.outer(seen, seen))
        believed = np.abs(self.bias) < BELIEVED * standard_deviations(grown)
        unsure = np.where(believed, 0.5, 1.0) * self.bias
        moved = point - np.where(believed, self.bias, 0.0)
        return moved, np.asarray(grown + np.outer(unsure, unsure) + np.diag(self.uncertainty**2))


def noise_density(record: Record, highest: float) -> float:
    """Return the one-sided power density, (m/s^2)^2/Hz, of the body's noise above the excitation.

    0 where the excitation, up to ``highest`` (Hz), leaves no band to see it in.
    """
    if FALL * highest >= HIGHEST_SHARE * record.sample_rate:
        return 0.0
    return noise_of(record.body, record.spool, record.sample_rate).body


def diverging(residuals: Residuals, point: Array) -> InputError:
    """Return the error of a fit whose motion cannot be followed at ``point``, shape (u,)."""
    run = residuals.run
    found = ", ".join(f"{one.name} {value:.3g}" for one, value in zip(residuals.unknowns, point, strict=True))
    return InputError(
        f"{run.records[0].name}: the motion of model '{run.model.name}' diverges near {found}: the law is "
        "stiffer than the sample rate can follow; fit a simpler model, or hold a parameter of it"
    )


def input_noise_effect(
    residuals: Residuals,
    point: Array,
    shown: NDArray[np.bool_],
    seconds: float,
    deviations: Array | None = None,
) -> NoiseEffect | None:
    """Return what the excitation's noise does to the ``shown`` unknowns at ``point``; ``None`` without noise.

    It is looked at on ``seconds`` of data at most. The noise is drawn from a fixed seed, so that the same
    records give the same result. With the ``deviations`` of the shown unknowns a small effect takes few of
    them.

    Raises:
        InputError: with a little more noise the motion cannot be followed.
    """
    run = residuals.run.fewer(seconds)
    densities = [noise_density(entry, excitation_limit(entry)) for entry in run.records]
    if not any(densities):
        return None
    made = _over(residuals, run).respond(point[np.newaxis])
    generator = np.random.default_rng(0)
    steps: list[list[Array]] = []
    while len(steps) < PAIRS and not (len(steps) == FEW_PAIRS and _negligible(steps, deviations)):
        noises = [_noise(run, number, densities, generator) for number in range(len(run.windows))]
        pair: list[Array] = []
        for sign in (1.0, -1.0):
            # As if ``made`` had been measured, and the excitation with the noise added.
            windows = [
                replace(
                    window, excitation=window.excitation + sign * noise, measured=response.acceleration[0]
                )
                for window, response, noise in zip(run.windows, made, noises, strict=True)
            ]
            shaken = _over(residuals, run.driven_by(windows))
            shaken.leave_out(point)
            error, slopes = shaken.at_with_slopes(point)
            if not (np.isfinite(error).all() and np.isfinite(slopes[:, shown]).all()):
                raise diverging(residuals, point)
            pair.append(
                np.asarray(-np.linalg.lstsq(slopes[:, shown], error, rcond=None)[0], dtype=np.float64)
            )
        steps.append(pair)
    moves = np.array(steps)
    even, odd = moves.mean(axis=1), 0.5 * (moves[:, 0] - moves[:, 1])
    share = sum(w.stop - w.start for w in run.windows) / sum(w.stop - w.start for w in residuals.run.windows)
    covariance = odd.T @ odd / len(steps) * share * (len(steps) == PAIRS)
    return NoiseEffect(even.mean(axis=0), covariance, even.std(axis=0, ddof=1) / np.sqrt(len(steps)))


def _negligible(steps: Sequence[Sequence[Array]], deviations: Array | None) -> bool:
    even = np.mean(steps, axis=1)
    return deviations is not None and bool(np.all(np.abs(even) < NEGLIGIBLE * deviations))


@dataclass(frozen=True, slots=True)
class _Stretch:
    displacement: Array
    velocity: Array
    inertia: Array
    first_sample: int
    sample_period: float
    conditioning: ZeroPhase
    inside: slice


def _over(residuals: Residuals, run: FreeRun) -> Residuals:
    """Return the same weights over the windows of ``run``, whose samples all count."""
    other = copy.copy(residuals)
    other.run, other.kept = run, [np.ones(1)] * len(run.windows)
    return other


def _noise(
    run: FreeRun, number: int, densities: Sequence[float], generator: np.random.Generator
) -> NDArray[np.complex128]:
    """Return the spectrum of white noise of the body's strength where the excitation has its band."""
    window = run.windows[number]
    period = run.records[window.record].sample_period
    highest = run.highest_frequency[window.record]
    level = np.sqrt(0.5 * densities[window.record] / period)
    spectrum = fft.rfft(generator.normal(0.0, level, window.length))
    return np.asarray(spectrum * excitation_gain(fft.rfftfreq(window.length, period), highest))
