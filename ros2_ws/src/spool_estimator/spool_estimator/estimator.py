"""Estimator core: blocks in, estimates out, no clock of its own."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_identification.oil import OilLaw, OilReference, oil_law
from spool_sim.valve.description import Valve
from spool_stream.block import Block
from spool_stream.block_gate import BlockGate, Fault, Verdict
from spool_stream.quantity import Quantity, Validity

from spool_estimator.motion.prediction import DELAY
from spool_estimator.recursion.recursive import RecursiveLeastSquares
from spool_estimator.recursion.sliding import SlidingLeastSquares

from .estimate import Estimate, State
from .last_good import LATE, LastGood
from .tracking import CHUNK, Knowledge, Tracker

#: Relative standard deviation of the stiffness at which learning ends.
LEARNED = 0.02

#: How many phases the estimates of several valves are spread over.
PHASES = 10

_NAMES = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
_UNITS = ("N/m", "N s/m", "N")

#: Ways to forget: by an exponential, in excited directions only, or by a window that slides.
EXPONENTIAL, WINDOW = FORGETTING = ("exponential", "window")


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Settings of an estimator: what it needs to know beforehand.

    Two accelerometers see forces per mass only: ``moving_mass`` (kg) sets the scale of every parameter.
    ``spring_stiffness`` (N/m), ``viscous_coefficient`` (N s/m) and ``coulomb_force`` (N) are orders of
    magnitude to start from. ``memory`` (s): time constant of forgetting, or length of the window;
    ``forgetting``: one of FORGETTING. ``low_cut``, ``high_cut`` (Hz): the band. ``minimum_excitation``
    (m/s^2): rms body acceleration in the band below which parameters are held. ``period`` (s): one estimate
    in this time; the first one comes ``phase`` chunks early, see ``phase_of``. ``oil``: the law by which the
    viscous coefficient is referred to one temperature, where it is known.
    """

    moving_mass: float
    spring_stiffness: float = 3000.0
    viscous_coefficient: float = 5.0
    coulomb_force: float = 0.5
    memory: float = 4.0
    forgetting: str = EXPONENTIAL
    low_cut: float = 4.0
    high_cut: float = 300.0
    sliding_velocity: float = 1.0e-3
    minimum_excitation: float = 0.2
    period: float = 1.0
    phase: int = 0
    oil: OilLaw | None = None


@dataclass(slots=True)
class Estimator:
    """Estimator of stiffness, viscous coefficient and Coulomb force of one valve from its blocks.

    The model is m a = -c v - k z - F_c sgn(v) (paper eq. (29) with Coulomb friction), ``a`` the spool's
    acceleration, ``z`` and ``v`` its displacement and velocity in the body; it is run in parallel with
    the machine.

    Parameters are held as they were last while a channel stands still or the stamps do not confirm the sample
    rate; what was learned from such samples is forgotten.
    """

    settings: EstimatorSettings
    gate: BlockGate = field(default_factory=BlockGate)
    oil: OilReference = field(init=False)
    latest: Estimate | None = field(default=None, init=False)
    tracker: Tracker | None = field(default=None, init=False)
    _samples: int = field(default=0, init=False)
    _referred_samples: int = field(default=0, init=False)
    _chunks: int = field(default=0, init=False)
    _good: LastGood[Knowledge] = field(default_factory=LastGood, init=False)
    _stands: bool = field(default=False, init=False)
    _gone_back: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.oil = OilReference(self.settings.oil, self.settings.memory)

    @property
    def regression(self) -> RecursiveLeastSquares | SlidingLeastSquares | None:
        """The least squares behind the parameters; ``None`` before the first block."""
        return self.tracker.regression if self.tracker else None

    @property
    def lacking(self) -> int:
        """Samples until the next estimate falls due; 0 before the first block."""
        if self.tracker is None:
            return 0
        done = (self._chunks + self.settings.phase) % self._every
        return (self._every - done) * self.tracker.chunk - self.tracker.filled

    @property
    def _every(self) -> int:
        """Chunks from one estimate to the next."""
        return max(1, round(self.settings.period / CHUNK))

    def update(self, block: Block) -> list[Estimate]:
        """Take one block; return the estimates that fell due within it, none for most blocks.

        How a stream is split into blocks changes nothing but ``last_sequence``, as long as they are shorter
        than 0.5 s: the sample rate is confirmed by their stamps.
        """
        verdict = self.gate.judge(block)
        if verdict is Verdict.REFUSED:
            if self.gate.fault is Fault.RATE and not self._gone_back:
                self._go_back(max(self.gate.rate.began, block.stamp - round(LATE * 1e9)))
            return []
        self._gone_back = False
        if verdict is Verdict.RESTARTS or self.tracker is None:
            self._restart(block.sample_period)
        tracker = self.tracker
        assert tracker is not None
        if tracker.filled + block.body.size < tracker.chunk:  # as most blocks
            tracker.take(block.body, block.spool)
            return []
        estimates = []
        taken = 0
        every = self._every
        while taken < block.body.size:
            start = taken
            taken = min(start + tracker.chunk - tracker.filled, block.body.size)
            if not tracker.take(block.body[start:taken], block.spool[start:taken]):
                continue
            self._chunks += 1
            stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
            self._watch(tracker, stamp)
            if tracker.excited:
                self._samples += tracker.chunk
            if (self._chunks + self.settings.phase) % every == 0:
                self.latest = self._judged(tracker, stamp, block.sequence)
                estimates.append(self.latest)
        return estimates

    def _watch(self, tracker: Tracker, stamp: int) -> None:
        """Forget what was learned since a channel stands still, as the chunk that ends at ``stamp`` shows."""
        stands = tracker.standing.stands
        if stands and not self._stands:
            # The first of the equal samples is still a good one; stamps are rounded.
            age = tracker.standing.age or tracker.chunk * tracker.sample_period
            self._go_back(stamp - round((age - 0.5 * tracker.sample_period) * 1e9))
        self._stands = stands

    def _go_back(self, stamp: int) -> None:
        """Go back to the last estimate that was good at ``stamp`` (ns)."""
        self._gone_back = True
        if self.tracker is None or self.latest is None:
            return
        self.tracker.restore(self._good.back(stamp))
        self.latest = self._good.held(self.latest, State.SETTLING)

    def _judged(self, tracker: Tracker, stamp: int, sequence: int) -> Estimate:
        """Return the estimate that is due: what the samples give, or the last good one."""
        estimate = self._estimate(tracker, stamp, sequence)
        if self._stands or tracker.standing.doubtful:
            return self._good.held(estimate, State.NOT_EXCITED)
        if not self.gate.confirmed and (self._good.any or estimate.parameters[0].known):
            return self._good.held(estimate, State.SETTLING)
        if estimate.state is State.TRACKING:
            self._good.keep(estimate, tracker.knowledge())
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
        if self.tracker is None:
            scale = [settings.spring_stiffness, settings.viscous_coefficient, settings.coulomb_force]
            self.tracker = Tracker(
                period,
                settings.moving_mass,
                np.array(scale),
                settings.memory,
                settings.forgetting == WINDOW,
                settings.low_cut,
                settings.high_cut,
                settings.sliding_velocity,
                settings.minimum_excitation,
            )
        elif self.tracker.sample_period != period:
            self.tracker.set_period(period)
        self.tracker.begin()

    def _estimate(self, tracker: Tracker, stamp: int, sequence: int) -> Estimate:
        values, covariance = tracker.regression.parameters, tracker.covariance
        deviations = np.sqrt(np.diag(covariance))
        learned = bool(tracker.started and deviations[0] < LEARNED * values[0])
        if tracker.settling:
            state = State.SETTLING
        elif not tracker.excited:
            state = State.NOT_EXCITED
        else:
            state = State.TRACKING if learned else State.LEARNING
        validity = Validity.UNKNOWN
        if learned:
            validity = Validity.VALID if tracker.excited else Validity.HELD
        parameters = tuple(
            _parameter(name, unit, value, deviation, validity)
            for name, unit, value, deviation in zip(
                _NAMES, _UNITS, values.tolist(), deviations.tolist(), strict=True
            )
        )
        delay = DELAY * tracker.sample_period
        described = stamp - round(delay * 1e9)
        fresh = self._samples - self._referred_samples
        self._referred_samples = self._samples
        self.oil.follow(described, fresh * tracker.sample_period)
        viscous = next((one for one in parameters if one.name == "viscous_coefficient"), None)
        return Estimate(
            stamp=stamp,
            model="coulomb",
            state=state,
            last_sequence=sequence,
            samples=self._samples,
            delay=delay,
            memory=self.settings.memory,
            parameters=parameters,
            **self._derived(tracker, covariance, validity),
            referred_viscous_coefficient=self.oil.referred(
                viscous or Quantity("viscous_coefficient", "N s/m")
            ),
            oil_temperature=self.oil.temperature(described),
            lost_blocks=self.gate.lost,
            refused_blocks=self.gate.refused,
        )

    def _derived(
        self, tracker: Tracker, covariance: NDArray[np.float64], validity: Validity
    ) -> dict[str, Quantity]:
        """Return what follows from the parameters and what the signals themselves show."""
        mass = self.settings.moving_mass
        stiffness, viscous, _ = tracker.regression.parameters.tolist()
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
        residual, target, body, displacement, _ = tracker.powers.tolist()
        seen = Validity.UNKNOWN if math.isnan(body) else Validity.VALID
        relative = math.sqrt(residual / target) if target > 0.0 and validity is Validity.VALID else math.nan
        fit = Validity.UNKNOWN if math.isnan(relative) else Validity.VALID
        return {
            "natural_frequency": frequency,
            "damping_ratio": damping,
            "residual": Quantity("residual", "1", relative, validity=fit),
            "excitation": Quantity("excitation", "m/s^2", math.sqrt(body), validity=seen),
            "relative_displacement": Quantity(
                "relative_displacement", "m", math.sqrt(displacement), validity=seen
            ),
        }


def _parameter(name: str, unit: str, value: float, deviation: float, validity: Validity) -> Quantity:
    """Return the parameter, unknown while learning, implausible where clearly negative."""
    if validity is Validity.UNKNOWN:
        return Quantity(name, unit)
    if value < -3.0 * deviation and value < 0.0:
        validity = Validity.IMPLAUSIBLE
    return Quantity(name, unit, value, deviation, validity)


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
            "viscous_coefficient": valve.viscous_coefficient,
            **changes,
        },
    )
