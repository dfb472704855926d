"""Estimator of a running valve: the model in parallel with the machine, and the last estimate that was good.

The model is m a = -c v - k z - F_c sgn(v) (paper eq. (29) with Coulomb friction), ``a`` the spool's
acceleration, ``z`` and ``v`` its displacement and velocity in the body.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Fault, Verdict
from spool_core.kernels.samples import OutlierFilter
from spool_core.kernels.strokes import StrokeWatch
from spool_core.numbers import Array
from spool_core.rate_check import REFUTE
from spool_core.uncertainty import Quantity, Validity
from spool_sim.valve import Valve

from spool_estimator.chunks import CHUNK
from spool_estimator.estimate import QUANTITIES, Estimate, State, unknown
from spool_estimator.identification.oil import OilLaw, OilReference, oil_law
from spool_estimator.prediction import DELAY
from spool_estimator.recursive import RecursiveLeastSquares
from spool_estimator.tracking import Knowledge, Tracker

#: Relative standard deviation of the stiffness at which learning ends.
LEARNED = 0.02

NAMES = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
_UNITS = ("N/m", "N s/m", "N")

#: Estimates that are kept: those of the time in which a wrong sample rate is found, and one before.
KEPT = 5
#: s before a wrong sample rate was found in which it may have set in.
LATE = REFUTE + 0.5
#: How many phases the estimates of several valves are spread over: the chunks of a second.
PHASES = 10


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Values that an estimator has to know beforehand.

    Two accelerometers see forces per mass only: ``moving_mass`` (kg) sets the scale of every parameter.
    ``spring_stiffness`` (N/m), ``viscous_coefficient`` (N s/m) and ``coulomb_force`` (N) are orders of
    magnitude to start from. ``memory`` (s): time constant of forgetting. ``low_cut``, ``high_cut`` (Hz): the
    band. ``minimum_excitation`` (m/s^2): rms body acceleration in the band below which parameters are held.
    ``period`` (s): one estimate in this time; the first one comes ``phase`` chunks early, see ``phase_of``.
    ``oil``: the law by which the viscous coefficient is referred to one temperature, where it is known.
    """

    moving_mass: float
    spring_stiffness: float = 3000.0
    viscous_coefficient: float = 5.0
    coulomb_force: float = 0.5
    memory: float = 4.0
    low_cut: float = 4.0
    high_cut: float = 300.0
    sliding_velocity: float = 1.0e-3
    minimum_excitation: float = 0.2
    period: float = 1.0
    phase: int = 0
    oil: OilLaw | None = None

    @property
    def scale(self) -> Array:
        """Orders of magnitude of k (N/m), c (N s/m) and F_c (N), shape (3,)."""
        return np.array([self.spring_stiffness, self.viscous_coefficient, self.coulomb_force])


def phase_of(name: str) -> int:
    """Return a phase that spreads the estimates of many valves; the same name always has the same.

    ``name`` is the valve's namespace, with or without the slash in front.
    """
    return zlib.crc32(name.strip("/").encode()) % PHASES


def settings_for(valve: Valve, **changes: Any) -> EstimatorSettings:
    """Return the settings that a valve's description gives, with ``changes`` by name."""
    return EstimatorSettings(
        moving_mass=valve.moving_mass,
        oil=oil_law(valve),
        **{
            "spring_stiffness": valve.spring_stiffness,
            "viscous_coefficient": valve.likely_viscous_coefficient,
            **changes,
        },
    )


@dataclass(frozen=True, slots=True)
class Learned:
    """Parameters of an estimator at the end of a chunk, and how certain they are.

    Attributes:
        values, covariance: of k (N/m), c (N s/m), F_c (N), shapes (3,) and (3, 3).
        certain: whether the values are known well enough to be told.
        excited, settling: of the chunk.
        powers: mean squares of error and inertia force (N^2), body acceleration and displacement, shape (4,);
            NaN where unknown, as the last two are until they have settled after a restart.
        delay: s, of the described motion behind the newest sample.
        refits: how often a fit to the last samples took the place of all that was learned before.

    """

    values: Array
    covariance: Array
    certain: bool
    excited: bool
    settling: bool
    powers: Array
    delay: float
    refits: int = 0

    @property
    def state(self) -> State:
        """State of an estimate that is made of it."""
        if self.settling:
            return State.SETTLING
        if not self.excited:
            return State.NOT_EXCITED
        return State.TRACKING if self.certain else State.LEARNING

    @property
    def validity(self) -> Validity:
        """Validity of the parameters."""
        if not self.certain:
            return Validity.UNKNOWN
        return Validity.VALID if self.excited else Validity.HELD


@dataclass(slots=True)
class LastGood:
    """The newest that track, each with what its estimator knew then."""

    _kept: deque[tuple[Estimate, Knowledge]] = field(default_factory=lambda: deque(maxlen=KEPT))

    @property
    def any(self) -> bool:
        """Whether there is a good estimate."""
        return bool(self._kept)

    def keep(self, estimate: Estimate, knowledge: Knowledge) -> None:
        """Keep an estimate that tracks."""
        self._kept.append((estimate, knowledge))

    def move(self, nanoseconds: int) -> None:
        """Give all the time of a clock that was set back: what is known is not from a time to come."""
        moved = [(replace(one, stamp=one.stamp + nanoseconds), known) for one, known in self._kept]
        self._kept = deque(moved, KEPT)

    def back(self, stamp: int) -> Knowledge | None:
        """Forget what is newer than ``stamp`` (ns); return what was known with the newest that is not."""
        while self._kept and self._kept[-1][0].stamp > stamp:
            self._kept.pop()
        return self._kept[-1][1] if self._kept else None

    def held(self, now: Estimate, state: State) -> Estimate:
        """Return the last good estimate as one that is held at ``now``; with none, that nothing is known."""
        if not self._kept:
            others: dict[str, Any] = {
                name: unknown(getattr(now, name)) for name in QUANTITIES if name != "oil_temperature"
            }
            state = State.LEARNING if state is State.SETTLING else state
            parameters = tuple(unknown(one) for one in now.parameters)
            return replace(now, state=state, parameters=parameters, **others)
        return replace(
            self._kept[-1][0].held(),
            stamp=now.stamp,
            state=state,
            last_sequence=now.last_sequence,
            samples=now.samples,
            delay=now.delay,
            oil_temperature=now.oil_temperature,
            lost_blocks=now.lost_blocks,
            refused_blocks=now.refused_blocks,
        )


@dataclass(slots=True)
class Estimator:
    """Estimator of one valve's stiffness, viscous coefficient and Coulomb force from its blocks.

    Uses no clock; picklable, bounded, the same for any split into blocks that are shorter than 0.5 s:
    the sample rate is confirmed by their stamps. Parameters are held as they were last while a channel stands
    still or the stamps do not confirm the sample rate; what was learned from such samples is forgotten.
    """

    settings: EstimatorSettings
    gate: BlockGate = field(default_factory=BlockGate)
    outliers: OutlierFilter = field(default_factory=OutlierFilter, init=False)
    strokes: StrokeWatch = field(default_factory=StrokeWatch, init=False)
    oil: OilReference = field(init=False)
    latest: Estimate | None = field(default=None, init=False)
    tracker: Tracker | None = field(default=None, init=False)
    _samples: int = field(default=0, init=False)
    _fresh: int = field(default=0, init=False)
    _refits: int = field(default=0, init=False)
    _chunks: int = field(default=0, init=False)
    _good: LastGood = field(default_factory=LastGood, init=False)
    _stands: bool = field(default=False, init=False)
    _gone_back: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.oil = OilReference(self.settings.oil, self.settings.memory)

    @property
    def regression(self) -> RecursiveLeastSquares | None:
        """The least squares behind the parameters; ``None`` before the first block."""
        return self.tracker.regression if self.tracker else None

    @property
    def _began(self) -> Tracker:
        assert self.tracker is not None
        return self.tracker

    @property
    def _missing(self) -> tuple[int, int]:
        """Samples in a chunk, and those that the present one lacks; 0 and 0 before the first block."""
        return (self.tracker.chunk, self.tracker.chunk - self.tracker.filled) if self.tracker else (0, 0)

    def _restart(self, period: float) -> None:
        """Begin the motion again with samples ``period`` s apart; what was learned is kept."""
        settings = self.settings
        if self.tracker is None:
            self.tracker = Tracker(
                period,
                settings.moving_mass,
                settings.scale,
                settings.memory,
                settings.low_cut,
                settings.high_cut,
                settings.sliding_velocity,
                settings.minimum_excitation,
            )
        elif self.tracker.sample_period != period:
            self.tracker.set_period(period)
        self.tracker.begin()

    def _learned(self) -> Learned:
        tracker = self._began
        values, covariance = tracker.regression.parameters, tracker.covariance
        return Learned(
            values,
            covariance,
            bool(tracker.started and np.sqrt(covariance[0, 0]) < LEARNED * values[0]),
            tracker.excited,
            tracker.settling,
            np.array([*tracker.powers[:3], tracker.displacement.mean_square]),
            DELAY * tracker.sample_period,
            tracker.refits,
        )

    @property
    def lacking(self) -> int:
        """Samples until the next estimate falls due; 0 before the first block."""
        size, missing = self._missing
        done = (self._chunks + self.settings.phase) % self._every
        return (self._every - done - 1) * size + missing if size else 0

    @property
    def _every(self) -> int:
        """Chunks from one estimate to the next."""
        return max(1, round(self.settings.period / CHUNK))

    def update(self, block: Block, verdict: Verdict | None = None) -> list[Estimate]:
        """Take one block; return the estimates that fell due within it, none for most blocks.

        ``verdict``: that of ``gate`` where it has judged the block; without one, the block is judged here.
        """
        verdict = verdict or self.gate.judge(block)
        if verdict is Verdict.REFUSED:
            if self.gate.fault is Fault.RATE and not self._gone_back:
                self._go_back(max(self.gate.rate.began, block.stamp - round(LATE * 1e9)))
            return []
        self._gone_back = False
        restarts, raw = verdict is Verdict.RESTARTS, block
        block = self.outliers.cleaned(block, restarts=restarts)
        # Of blocks that are taken together the last one counts: the first is older than the one before it.
        if self.gate.before is not None and block.end < self.gate.before[1]:
            self._good.move(block.stamp - self.gate.before[1])
        if restarts or not self._missing[0]:
            self._restart(block.sample_period)
            self.oil.restart()
        estimates: list[Estimate] = []
        natural = math.sqrt(self.settings.spring_stiffness / self.settings.moving_mass) / (2.0 * math.pi)
        for part, pause in self.strokes.kept(block, raw, natural, restarts=restarts):
            if pause is not None:
                self._restart(part.sample_period)
            estimates += self._follow(part)
        return estimates

    def _follow(self, block: Block) -> list[Estimate]:
        """Take samples that continue the last ones; return the estimates that fell due within them."""
        estimates = []
        taken = 0
        while taken < block.body.size:
            most = self._every - (self._chunks + self.settings.phase) % self._every
            count, full = self._began.take(block.body[taken:], block.spool[taken:], most)
            taken += count
            if not full:
                continue
            self._chunks += full
            self._stands = self._stands and full == 1
            stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
            # What was learned since a channel stands still is forgotten.
            stands = self._began.standing.stands
            if stands and not self._stands:
                # The first of the equal samples is still a good one; stamps are rounded.
                period = self._began.standing.sample_period
                age = self._began.standing.age or self._missing[0] * period
                self._go_back(stamp - round((age - 0.5 * period) * 1e9))
            self._stands = stands
            used = self._began.used
            self._samples += used
            self._fresh += used
            if (self._chunks + self.settings.phase) % self._every == 0:
                self.latest = self._estimate(stamp, block.sequence)
                estimates.append(self.latest)
        return estimates

    def update_temperature(self, stamp: int, celsius: float, deviation: float = math.nan) -> None:
        """Take the oil's temperature at ``stamp`` (ns), deg C, its standard deviation (NaN: unknown)."""
        self.oil.take(stamp, celsius, deviation)

    def stale(self) -> Estimate | None:
        """Return the last estimate as one that is held because no data arrive; ``None`` before the first."""
        if self.latest is None:
            return None
        return replace(self.latest.held(), lost_blocks=self.gate.lost, refused_blocks=self.gate.refused)

    def _go_back(self, stamp: int) -> None:
        """Go back to the last estimate that was good at ``stamp`` (ns)."""
        self._gone_back = True
        known = self._good.back(stamp)
        if self.latest is not None:
            if self.tracker is not None:
                self.tracker.restore(known)
            self.latest = self._good.held(self.latest, State.SETTLING)

    def _estimate(self, stamp: int, sequence: int) -> Estimate:
        """Return the estimate that is due: what the samples give, or the last good one."""
        learned = self._learned()
        deviations = np.sqrt(learned.covariance.diagonal())
        parameters = tuple(
            _parameter(*named, value, deviation, learned) if learned.certain else Quantity(*named)
            for named, value, deviation in zip(
                zip(NAMES, _UNITS, strict=True), learned.values.tolist(), deviations.tolist(), strict=True
            )
        )
        described = stamp - round(learned.delay * 1e9)
        forgets = learned.refits != self._refits
        self.oil.follow(described, math.inf if forgets else self._fresh * self._began.standing.sample_period)
        self._fresh, self._refits = 0, learned.refits
        estimate = Estimate(
            stamp=stamp,
            model="coulomb",
            state=learned.state,
            last_sequence=sequence,
            samples=self._samples,
            delay=learned.delay,
            memory=self.settings.memory,
            parameters=parameters,
            **_derived(learned, self.settings.moving_mass),
            referred_viscous_coefficient=self.oil.referred(parameters[1]),
            oil_temperature=self.oil.temperature(described),
            lost_blocks=self.gate.lost,
            refused_blocks=self.gate.refused,
        )
        if self._stands or self._began.standing.doubtful:
            return self._good.held(estimate, State.NOT_EXCITED)
        if not self.gate.confirmed and (self._good.any or estimate.parameters[0].known):
            return self._good.held(estimate, State.SETTLING)
        if estimate.state is State.TRACKING:
            self._good.keep(estimate, self._began.knowledge())
        return estimate


def _parameter(name: str, unit: str, value: float, deviation: float, learned: Learned) -> Quantity:
    negative = value < -3.0 * deviation and value < 0.0
    return Quantity(name, unit, value, deviation, Validity.IMPLAUSIBLE if negative else learned.validity)


def _derived(learned: Learned, mass: float) -> dict[str, Any]:
    """Return what follows from the parameters and what the signals themselves show; ``mass`` in kg."""
    validity, covariance = learned.validity, learned.covariance
    stiffness, viscous, _ = learned.values.tolist()
    frequency = Quantity("natural_frequency", "Hz")
    damping = Quantity("damping_ratio", "1")
    if validity is not Validity.UNKNOWN:
        natural = math.sqrt(stiffness / mass) / (2.0 * math.pi)
        deviation = 0.5 * natural * math.sqrt(covariance[0, 0]) / stiffness
        frequency = Quantity("natural_frequency", "Hz", natural, deviation, validity)
        ratio = viscous / (2.0 * math.sqrt(stiffness * mass))
        slope = np.array([-0.5 * ratio / stiffness, ratio / viscous if viscous else 0.0])
        deviation = math.sqrt(max(0.0, float(slope @ covariance[:2, :2] @ slope)))
        damping = Quantity("damping_ratio", "1", ratio, deviation, validity)
    residual, target, body, displacement = learned.powers.tolist()
    relative = math.sqrt(residual / target) if target > 0.0 and validity is Validity.VALID else math.nan
    fit = Validity.UNKNOWN if math.isnan(relative) else Validity.VALID
    left = math.sqrt(residual) if fit is Validity.VALID else math.nan
    return {
        "natural_frequency": frequency,
        "damping_ratio": damping,
        "residual": Quantity("residual", "1", relative, validity=fit),
        "residual_force": Quantity("residual_force", "N", left, validity=fit),
        "excitation": _rms("excitation", "m/s^2", body),
        "relative_displacement": _rms("relative_displacement", "m", displacement),
    }


def _rms(name: str, unit: str, power: float) -> Quantity:
    validity = Validity.UNKNOWN if math.isnan(power) else Validity.VALID
    return Quantity(name, unit, math.sqrt(power), validity=validity)
