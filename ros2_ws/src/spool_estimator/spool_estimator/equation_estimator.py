"""Equation-error estimator: integrated signals, exponential forgetting sample by sample.

Cheaper than running the model in parallel with the machine, and worse where friction is dry: the direction
of sliding comes from an integrated velocity, which is wrong for a sample or two at each reversal.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_identification.oil import OilReference
from spool_stream.block import Block
from spool_stream.block_gate import BlockGate, Fault, Verdict
from spool_stream.kernels.standing import StandingWatch
from spool_stream.quantity import Quantity, Validity

from spool_estimator.recursion.conditioning import (
    BODY,
    COLUMNS,
    DIRECTION,
    DISPLACEMENT,
    SPOOL,
    VELOCITY,
    Conditioning,
)
from spool_estimator.recursion.exponential import ExponentialForgetting

from .estimate import Estimate, State
from .estimator import LEARNED, EstimatorSettings
from .last_good import LATE, LastGood

_NAMES = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
_UNITS = ("N/m", "N s/m", "N")

#: s, samples are conditioned and judged in chunks of this length.
CHUNK = 0.1

#: Standard deviation of the start values in units of their scale, and of the error (N) they are weighed with.
_START, _ERROR = 1.0, 0.05


@dataclass(slots=True)
class EquationEstimator:
    """Equation-error estimator of k, c and F_c from m a = -k z - c v - F_c sgn(v).

    Every signal is conditioned alike (:mod:`.conditioning`); a chunk without excitation is left out.
    """

    settings: EstimatorSettings
    gate: BlockGate = field(default_factory=BlockGate)
    oil: OilReference = field(init=False)
    regression: ExponentialForgetting | None = field(default=None, init=False)
    latest: Estimate | None = field(default=None, init=False)
    _conditioning: Conditioning | None = field(default=None, init=False)
    _samples: NDArray[np.float32] = field(init=False)
    _rows: NDArray[np.float64] = field(init=False)
    _filled: int = field(default=0, init=False)
    _since_restart: int = field(default=0, init=False)
    _chunks: int = field(default=0, init=False)
    _fresh: int = field(default=0, init=False)
    _used: int = field(default=0, init=False)
    _excited: bool = field(default=False, init=False)
    _settling: bool = field(default=True, init=False)
    _powers: NDArray[np.float64] = field(init=False)
    _good: LastGood[tuple[ExponentialForgetting, NDArray[np.float64]]] = field(
        default_factory=LastGood, init=False
    )
    _standing: StandingWatch = field(default_factory=lambda: StandingWatch(1.0), init=False)
    _stands: bool = field(default=False, init=False)
    _gone_back: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.oil = OilReference(self.settings.oil, self.settings.memory)
        self._powers = np.full(4, math.nan)
        self._samples = np.empty((2, 0), np.float32)
        self._rows = np.empty((0, COLUMNS))

    @property
    def lacking(self) -> int:
        """Samples until the next estimate falls due; 0 before the first block."""
        done = (self._chunks + self.settings.phase) % self._every
        return (self._every - done) * self._samples.shape[1] - self._filled

    @property
    def _every(self) -> int:
        """Chunks from one estimate to the next."""
        return max(1, round(self.settings.period / CHUNK))

    def update(self, block: Block) -> list[Estimate]:
        """Take one block; return the estimates that fell due within it, the same however it is split."""
        verdict = self.gate.judge(block)
        if verdict is Verdict.REFUSED:
            if self.gate.fault is Fault.RATE and not self._gone_back:
                self._go_back(max(self.gate.rate.began, block.stamp - round(LATE * 1e9)))
            return []
        self._gone_back = False
        if verdict is Verdict.RESTARTS or self._conditioning is None:
            self._restart(block.sample_period)
        estimates = []
        taken = 0
        size = self._samples.shape[1]
        while taken < block.body.size:
            count = min(size - self._filled, block.body.size - taken)
            place, part = slice(self._filled, self._filled + count), slice(taken, taken + count)
            self._samples[0, place] = block.body[part]
            self._samples[1, place] = block.spool[part]
            self._filled += count
            taken += count
            if self._filled == size:
                self._filled = 0
                stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
                self._watch(stamp, block.sample_period)
                self._close_chunk()
                if (self._chunks + self.settings.phase) % self._every == 0:
                    self.latest = self._judged(stamp, block.sequence)
                    estimates.append(self.latest)
        return estimates

    def _watch(self, stamp: int, period: float) -> None:
        """Forget what was learned since a channel stands still, as the chunk that ends at ``stamp`` shows."""
        self._standing.take(self._samples)
        stands = self._standing.stands
        if stands and not self._stands:
            # The first of the equal samples is still a good one; stamps are rounded.
            age = self._standing.age or self._samples.shape[1] * period
            self._go_back(stamp - round((age - 0.5 * period) * 1e9))
        self._stands = stands

    def _go_back(self, stamp: int) -> None:
        """Go back to the last estimate that was good at ``stamp`` (ns)."""
        self._gone_back = True
        known = self._good.back(stamp)
        if known is None:
            self.regression = self._new_regression()
            self._powers, self._used = np.full(4, math.nan), 0
        else:
            self.regression, self._powers = copy.deepcopy(known[0]), known[1].copy()
        if self.latest is not None:
            self.latest = self._good.held(self.latest, State.SETTLING)

    def _judged(self, stamp: int, sequence: int) -> Estimate:
        """Return the estimate that is due: what the samples give, or the last good one."""
        estimate = self._estimate(stamp, sequence)
        if self._stands or self._standing.doubtful:
            return self._good.held(estimate, State.NOT_EXCITED)
        if not self.gate.confirmed and (self._good.any or estimate.parameters[0].known):
            return self._good.held(estimate, State.SETTLING)
        if estimate.state is State.TRACKING:
            assert self.regression is not None
            self._good.keep(estimate, (copy.deepcopy(self.regression), self._powers.copy()))
        return estimate

    def update_temperature(self, stamp: int, celsius: float, deviation: float = math.nan) -> None:
        """Take the oil's temperature at ``stamp`` (ns), deg C, its standard deviation (NaN: unknown)."""
        self.oil.take(stamp, celsius, deviation)

    def stale(self) -> Estimate | None:
        """Return the last estimate as one that is held because no data arrive; ``None`` before the first."""
        if self.latest is None:
            return None
        return replace(self.latest.held(), lost_blocks=self.gate.lost, refused_blocks=self.gate.refused)

    def _restart(self, period: float) -> None:
        settings = self.settings
        if self._conditioning is None or self._conditioning.sample_period != period:
            self._conditioning = Conditioning(
                period, settings.low_cut, settings.high_cut, settings.sliding_velocity
            )
            chunk = max(8, round(CHUNK / period))
            self._samples = np.empty((2, chunk), np.float32)
            self._rows = np.empty((chunk, COLUMNS))
            former = self.regression
            self.regression = self._new_regression()
            if former is not None:
                self.regression.parameters[:] = former.parameters
                self.regression.covariance[:] = former.covariance
                self.regression.errors[:] = former.errors
        self._standing = StandingWatch(period)
        self._conditioning.reset()
        self._filled = self._since_restart = 0

    def _new_regression(self) -> ExponentialForgetting:
        assert self._conditioning is not None
        factor = math.exp(-self._conditioning.sample_period / self.settings.memory)
        certain = (_START / _ERROR) ** 2
        return ExponentialForgetting(len(_NAMES), factor, certain, largest=3.0 * certain)

    def _close_chunk(self) -> None:
        conditioning, regression, rows = self._conditioning, self.regression, self._rows
        assert conditioning is not None
        assert regression is not None
        self._chunks += 1
        if self._stands:
            conditioning.reset()
            self._since_restart, self._settling, self._excited = 0, True, False
            return
        conditioning.take(self._samples[0], self._samples[1], rows)
        self._settling = self._since_restart < conditioning.settling
        self._since_restart += len(rows)
        if self._settling:
            self._excited = False
            return
        target = -self.settings.moving_mass * rows[:, SPOOL]
        means = np.mean(np.square(rows), axis=0)
        self._excited = bool(
            math.sqrt(means[VELOCITY]) > 2.0 * self.settings.sliding_velocity
            and means[BODY] > self.settings.minimum_excitation**2
        )
        scaled = rows[:, : DIRECTION + 1] * self._scale
        residual = target - scaled @ regression.parameters
        if self._excited:
            regression.update(scaled, target)
            self._fresh += len(rows)
            self._used += len(rows)
        new = np.array([np.mean(residual**2), np.mean(target**2), means[BODY], means[DISPLACEMENT]])
        share = min(1.0, CHUNK / self.settings.period)
        self._powers = np.where(np.isnan(self._powers), new, (1.0 - share) * self._powers + share * new)

    @property
    def _scale(self) -> NDArray[np.float64]:
        settings = self.settings
        return np.array([settings.spring_stiffness, settings.viscous_coefficient, settings.coulomb_force])

    def _estimate(self, stamp: int, sequence: int) -> Estimate:
        conditioning, regression = self._conditioning, self.regression
        assert conditioning is not None
        assert regression is not None
        values = regression.parameters * self._scale
        deviations = regression.standard_deviations * self._scale
        learned = bool(values[0] > 0.0 and deviations[0] < LEARNED * values[0] and self._used)
        validity = Validity.UNKNOWN
        if learned:
            validity = Validity.VALID if self._excited else Validity.HELD
        state = State.TRACKING if learned else State.LEARNING
        if self._settling or not self._excited:
            state = State.SETTLING if self._settling else State.NOT_EXCITED
        parameters = tuple(
            Quantity(name, unit, *((float(value), float(deviation), validity) if learned else ()))
            for name, unit, value, deviation in zip(_NAMES, _UNITS, values, deviations, strict=True)
        )
        period = conditioning.sample_period
        delay = conditioning.delay * period
        self.oil.follow(stamp - round(delay * 1e9), self._fresh * period)
        self._fresh = 0
        estimate = Estimate(
            stamp=stamp,
            model="coulomb",
            state=state,
            last_sequence=sequence,
            samples=self._used,
            delay=delay,
            memory=self.settings.memory,
            parameters=parameters,
            natural_frequency=Quantity("natural_frequency", "Hz"),
            damping_ratio=Quantity("damping_ratio", "1"),
            **self._seen(learned),
            lost_blocks=self.gate.lost,
            refused_blocks=self.gate.refused,
            referred_viscous_coefficient=self.oil.referred(parameters[1]),
            oil_temperature=self.oil.temperature(stamp - round(delay * 1e9)),
        )
        return _with_derived(estimate, self.settings.moving_mass) if learned else estimate

    def _seen(self, learned: bool) -> dict[str, Quantity]:
        residual, target, body, displacement = self._powers
        seen = Validity.UNKNOWN if math.isnan(body) else Validity.VALID
        relative = Quantity("residual", "1")
        if learned and self._excited and target > 0.0:
            relative = replace(relative, value=math.sqrt(residual / target), validity=Validity.VALID)
        return {
            "residual": relative,
            "excitation": Quantity("excitation", "m/s^2", math.sqrt(body), validity=seen),
            "relative_displacement": Quantity(
                "relative_displacement", "m", math.sqrt(displacement), validity=seen
            ),
        }


def _with_derived(estimate: Estimate, mass: float) -> Estimate:
    """Return ``estimate`` with natural frequency and damping ratio; parameters count as independent."""
    stiffness, viscous, _ = estimate.parameters
    natural = math.sqrt(stiffness.value / mass) / (2.0 * math.pi)
    share = 0.5 * stiffness.standard_deviation / stiffness.value
    size = 2.0 * math.sqrt(stiffness.value * mass)
    ratio = viscous.value / size
    deviation = math.hypot(viscous.standard_deviation / size, ratio * share)
    return replace(
        estimate,
        natural_frequency=Quantity("natural_frequency", "Hz", natural, natural * share, stiffness.validity),
        damping_ratio=Quantity("damping_ratio", "1", ratio, deviation, stiffness.validity),
    )
