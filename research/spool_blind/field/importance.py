"""Importance of what is hidden: how much of the spool's acceleration it makes, and whether noise covers it.

A name is demanded only of an effect that matters. Its share is the difference between the records with and
without it, the base refitted to the one without: stiffness, drag, and gain and delay within their tolerances
take what they can.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq
from scipy.optimize import lsq_linear
from scipy.signal import welch

from spool_blind.case import OUT_OF_CATALOGUE_TOLERANCE
from spool_blind.condition import DELAY_TOLERANCE, GAIN_TOLERANCE, ExperimentCondition
from spool_blind.effects import EFFECTS
from spool_blind.hidden import Hidden
from spool_blind.simulator.laws import dry
from spool_blind.simulator.linear import transmissibility
from spool_blind.simulator.plant import Plant, SpoolMotion
from spool_blind.visibility import threshold

from .measuring_chain import MeasuringChain
from .nuisances.nuisance import BODY, SPOOL

Array = NDArray[np.float64]

#: Share of the spool's acceleration (rms) that a name has to be worth: the default of `gap --least-share`.
LEAST_SHARE = 0.0025
#: Laws of friction that contain Coulomb friction, or come close to it where their passage is short.
LIKE_COULOMB = (*(name for name, kind in EFFECTS.items() if kind.richer), "presliding_friction")
#: Relative steps of stiffness, drag and friction for slopes.
STEPS = {"stiffness": 0.002, "damping": 0.02, "coulomb_force": 0.02}
#: Steps of a refit at most, and share of what is left above which another one is not worth its time.
ROUNDS, ENOUGH = 6, 0.97
#: Change of a number in one step at most.
LARGEST_CHANGE = (0.6, 1.6)


@dataclass(frozen=True, slots=True)
class Importance:
    """Importance of one effect among those of its record.

    Attributes:
        with_without: rms of the difference between the records with and without it, over that of the spool's
            acceleration, all numbers kept.
        share: the same after the base is refitted: this one decides.
        evidence: noncentrality of a likelihood-ratio test that knows it and the spectra of the noise.
        threshold: evidence at which that test finds half of such records.
    """

    with_without: float
    share: float
    evidence: float
    threshold: float

    @property
    def matters(self) -> bool:
        """Whether a name for it is demanded."""
        return self.share > LEAST_SHARE and self.evidence > self.threshold


class ImportanceJudge:
    """Judge of the importance of what is hidden in one record."""

    def __init__(
        self, condition: ExperimentCondition, chain: MeasuringChain, parts: Mapping[str, Hidden], time: Array
    ) -> None:
        self.condition, self.chain, self.parts, self.time = condition, chain, parts, time
        self.plant = plant_of(condition, list(parts.values()))
        self.motion = condition.move(self.plant)
        self.spool = chain.quiet(SPOOL, self.motion, time)
        self._density = self._densities()

    def importance(self, name: str) -> Importance:
        """Return how much the effect ``name`` matters."""
        hidden = self.parts[name]
        others = [part for other, part in self.parts.items() if other != name]
        sensor = hidden.channel
        numbers = plant_of(self.condition, others)
        bare = MeasuringChain(
            1.0 if "gain" in sensor else self.chain.gain,
            0.0 if "delay" in sensor else self.chain.delay,
            0.0 if "full_scale" in sensor else self.chain.full_scale,
            self.chain.noise, (), 0,
        )  # fmt: skip
        without = self._reading(bare, numbers)
        tolerance = 1.0 if name in EFFECTS else OUT_OF_CATALOGUE_TOLERANCE
        found = self._left(bare, numbers, ("stiffness", "damping"), tolerance)
        limit = threshold(max(1, len(hidden.truth)))
        return Importance(float((self.spool - without).std() / self.spool.std()), *found, limit)

    def is_coulomb(self, name: str) -> bool:
        """Return whether the friction ``name`` is not distinguished from Coulomb friction of its own loss."""
        if name not in LIKE_COULOMB:
            return False
        hidden = self.parts[name]
        others = [part for other, part in self.parts.items() if other != name]
        force = equivalent_force(hidden, self.motion)
        numbers = plant_of(self.condition, [*others, Hidden({"coulomb_force": force})])
        share, evidence = self._left(self.chain, numbers, tuple(STEPS), 1.0)
        return not (share > LEAST_SHARE and evidence > threshold(max(1, len(hidden.truth) - 1)))

    def _reading(self, chain: MeasuringChain, plant: Plant) -> Array:
        return chain.quiet(SPOOL, self.condition.move(plant, like=self.plant), self.time)

    def _left(
        self, chain: MeasuringChain, plant: Plant, free: Sequence[str], tolerance: float
    ) -> tuple[float, float]:
        """Return share and evidence of what is left once the numbers ``free``, gain, delay are refitted."""
        left = self.spool - self._reading(chain, plant)
        for _ in range(ROUNDS):
            step = self._step(chain, plant, free, left, tolerance)
            factors = {name: 1.0 + STEPS[name] * one for name, one in zip(free, step[:-2], strict=True)}
            bounded = {name: float(np.clip(one, *LARGEST_CHANGE)) for name, one in factors.items()}
            nearer = plant.with_(**{name: plant.numbers[name] * one for name, one in bounded.items()})
            gain = chain.gain + GAIN_TOLERANCE * float(step[-2])
            refitted = replace(chain, gain=gain, delay=chain.delay + DELAY_TOLERANCE * float(step[-1]))
            after = self.spool - self._reading(refitted, nearer)
            if not after.std() < ENOUGH * left.std():
                left = after if after.std() < left.std() else left
                break
            chain, plant, left = refitted, nearer, after
        return float(left.std() / self.spool.std()), self._evidence(left)

    def _step(
        self, chain: MeasuringChain, plant: Plant, free: Sequence[str], left: Array, tolerance: float
    ) -> Array:
        """Return the Gauss-Newton step that ``left`` asks for, in units of ``STEPS`` and the tolerances."""
        now = self.spool - left
        slopes = [
            self._reading(chain, plant.with_(**{name: plant.numbers[name] * (1.0 + STEPS[name])})) - now
            for name in free
        ]
        rate = self.condition.sample_rate
        slopes += [GAIN_TOLERANCE / chain.gain * now, -DELAY_TOLERANCE * rate * np.gradient(now)]
        basis, small = np.linalg.qr(np.array(slopes).T)
        place = np.array([(chain.gain - 1.0) / GAIN_TOLERANCE, chain.delay / DELAY_TOLERANCE])
        # Bounds of the solver have to have a width.
        low = np.concatenate([[-np.inf] * len(free), np.minimum(-tolerance - place, -1e-9)])
        high = np.concatenate([[np.inf] * len(free), np.maximum(tolerance - place, 1e-9)])
        return np.asarray(lsq_linear(small, basis.T @ left, (low, high)).x)

    def _evidence(self, left: Array) -> float:
        window = np.hanning(left.size)
        window /= np.sqrt(np.mean(window**2))
        return float(2.0 * np.sum(np.abs(rfft(left * window)) ** 2 / self._density))

    def _densities(self) -> Array:
        """Return the power that the noise of both channels leaves in each line of the difference."""
        rate, size = self.condition.sample_rate, self.time.size
        frequency = rfftfreq(size, 1.0 / rate)
        through = np.abs(transmissibility(self.condition.base.numbers, frequency)) ** 2
        total = np.zeros(frequency.size)
        for channel, share in ((BODY, through), (SPOOL, 1.0)):
            quiet = self.chain.quiet(channel, self.motion, self.time)
            noise = self.chain.noise_of(channel, quiet, rate)
            lines, density = welch(noise, rate, nperseg=min(4096, size))
            total += share * np.interp(frequency, lines, density) * rate * size / 2.0
        # Filters take noise away where they would take the difference, too.
        return np.maximum(total, 0.01 * np.median(total))


def plant_of(condition: ExperimentCondition, parts: Sequence[Hidden]) -> Plant:
    """Return the plant of ``condition`` with ``parts`` hidden in it."""
    plant = condition.base
    for part in parts:
        plant = plant.with_(**part.plant)
    return plant


def equivalent_force(hidden: Hidden, motion: SpoolMotion) -> float:
    """Return the Coulomb force (N) that takes as much energy out of ``motion`` as the friction ``hidden``."""
    if "bristle_stiffness" in hidden.plant or "asymmetry" in hidden.plant:
        return hidden.plant["coulomb_force"]
    stride = max(1, motion.displacement.size // 5000)
    speed = np.abs(np.gradient(motion.displacement, motion.step))[::stride]
    numbers = Plant(hidden.plant).array()
    forces = np.array([dry(float(one), 1.0, numbers) for one in speed])
    return float(np.sum(forces * speed) / max(float(np.sum(speed)), 1e-30))
