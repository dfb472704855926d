"""The estimator's core: blocks in, estimates out, no clock of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_sim.valve import Valve
from spool_stream.block import Block
from spool_stream.block_gate import BlockGate, Verdict
from spool_stream.quantity import Quantity, Validity

from .conditioning import BODY, COLUMNS, DIRECTION, DISPLACEMENT, SPOOL, VELOCITY, Conditioning
from .estimate import Estimate, State
from .oil import OilLaw, OilReference, oil_law
from .recursive import RecursiveLeastSquares
from .window import ChunkWindow

#: s, samples are taken into the regression in chunks of this length.
CHUNK = 0.1

#: N, force noise that the prior is weighed with, and the least that a record is believed to have.
NOISE, SMALLEST_NOISE = 0.05, 1.0e-3

#: The valve has changed when the parameters leave this many times the residual power of the last second's own
#: best fit; then each chunk takes the share DOUBT of the old information away.
CHANGED, DOUBT = 1.25, 0.3

#: More than that is asked for in proportion to the square of the velocity's relative uncertainty.
UNCERTAIN = 40.0

#: Relative change of the stiffness up to which a second of data is believed to show a changed valve.
SPRING_CHANGE = 0.5

#: Relative standard deviation of the stiffness at which learning ends.
LEARNED = 0.02

_NAMES = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
_UNITS = ("N/m", "N s/m", "N")


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """What an estimator needs to know beforehand.

    Two accelerometers see forces per mass only: ``moving_mass`` (kg) sets the scale of every parameter.
    ``spring_stiffness`` (N/m), ``viscous_coefficient`` (N s/m) and ``coulomb_force`` (N) are orders of
    magnitude for a weak prior. ``memory`` (s): time constant of forgetting. ``low_cut``, ``high_cut`` (Hz):
    the band. ``minimum_excitation`` (m/s^2): rms body acceleration in the band below which parameters are
    held. ``period`` (s): one estimate in this time. ``oil``: the law by which the viscous coefficient is
    referred to one temperature, where it is known.
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
    oil: OilLaw | None = None


@dataclass(slots=True)
class _Chunk:
    """Samples on their way into the regression."""

    rows: NDArray[np.float64]
    filled: int = 0


@dataclass(slots=True)
class Estimator:
    """Identify stiffness, viscous coefficient and Coulomb force of one valve from its blocks.

    The model is m a = -c v - k z - F_c sgn(v) (paper eq. (29) with Coulomb friction), ``a`` the spool's
    acceleration, ``z`` and ``v`` its displacement and velocity in the body, each conditioned alike.
    """

    settings: EstimatorSettings
    gate: BlockGate = field(default_factory=BlockGate)
    regression: RecursiveLeastSquares = field(init=False)
    oil: OilReference = field(init=False)
    _window: ChunkWindow = field(init=False)
    latest: Estimate | None = field(default=None, init=False)
    _conditioning: Conditioning | None = field(default=None, init=False)
    _chunk: _Chunk = field(init=False)
    _since_restart: int = field(default=0, init=False)
    _samples: int = field(default=0, init=False)
    _referred_samples: int = field(default=0, init=False)
    _chunks: int = field(default=0, init=False)
    _excited: bool = field(default=False, init=False)
    _settling: bool = field(default=True, init=False)
    _powers: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        settings = self.settings
        scale = [settings.spring_stiffness, settings.viscous_coefficient, settings.coulomb_force]
        self.regression = RecursiveLeastSquares(np.array(scale), CHUNK / settings.memory, noise=NOISE)
        self.oil = OilReference(settings.oil, settings.memory)
        self._window = ChunkWindow(np.array(scale))
        self._chunk = _Chunk(np.empty((0, COLUMNS)))
        self._powers = np.full(4, math.nan)

    def update(self, block: Block) -> list[Estimate]:
        """Take one block; return the estimates that fell due within it, none for most blocks.

        How a stream is split into blocks changes nothing but ``last_sequence``.
        """
        verdict = self.gate.judge(block)
        if verdict is Verdict.REFUSED:
            return []
        if verdict is Verdict.RESTARTS or self._conditioning is None:
            self._restart(block.sample_period)
        assert self._conditioning is not None
        rows = np.empty((block.body.size, COLUMNS))
        self._conditioning.take(block.body, block.spool, rows)
        estimates = []
        taken = 0
        chunk = self._chunk
        while taken < len(rows):
            count = min(len(chunk.rows) - chunk.filled, len(rows) - taken)
            chunk.rows[chunk.filled : chunk.filled + count] = rows[taken : taken + count]
            chunk.filled += count
            taken += count
            if chunk.filled == len(chunk.rows):
                self._close_chunk(chunk)
                if self._chunks % max(1, round(self.settings.period / CHUNK)) == 0:
                    stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
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
        held = _holding(self.latest)
        return replace(held, lost_blocks=self.gate.lost, refused_blocks=self.gate.refused)

    def _restart(self, period: float) -> None:
        if self._conditioning is None or self._conditioning.sample_period != period:
            settings = self.settings
            self._conditioning = Conditioning(
                period, settings.low_cut, settings.high_cut, settings.sliding_velocity
            )
            self._chunk = _Chunk(np.empty((max(8, round(CHUNK / period)), COLUMNS)))
        self._conditioning.reset()
        self._chunk.filled = 0
        self._window.clear()
        self._since_restart = 0

    def _close_chunk(self, chunk: _Chunk) -> None:
        assert self._conditioning is not None
        rows = chunk.rows
        chunk.filled = 0
        self._chunks += 1
        self._since_restart += len(rows)
        self._settling = self._since_restart - len(rows) < self._conditioning.settling
        if self._settling:
            self._excited = False
            return
        target = -self.settings.moving_mass * rows[:, SPOOL]
        moving = np.sqrt(np.mean(rows[:, VELOCITY] ** 2)) > 2.0 * self.settings.sliding_velocity
        body = float(np.mean(rows[:, BODY] ** 2))
        self._excited = bool(moving and body > self.settings.minimum_excitation**2)
        displacement = float(np.mean(rows[:, DISPLACEMENT] ** 2))
        if self._excited:
            self._regress(np.ascontiguousarray(rows[:, : DIRECTION + 1]), target)
            self._samples += len(rows)
        residual = target - rows[:, : DIRECTION + 1] @ self.regression.parameters
        new = np.array([np.mean(residual**2), np.mean(target**2), body, displacement])
        share = CHUNK / self.settings.period
        self._powers = np.where(np.isnan(self._powers), new, (1.0 - share) * self._powers + share * new)

    def _regress(self, rows: NDArray[np.float64], target: NDArray[np.float64]) -> None:
        """Weigh the chunk by how well any parameters fit there; doubt the past where it fits far worse."""
        self._window.add(rows, target)
        present, own = self._window.variances(self.regression.parameters)
        threshold = CHANGED + UNCERTAIN * self._velocity_uncertainty(rows[:, VELOCITY]) ** 2
        if self._window.full and present > threshold * own and self._plausible(self._window.best()):
            self.regression.discount(DOUBT)
        self.regression.update(rows, target, NOISE**2 / (own + SMALLEST_NOISE**2))

    def _plausible(self, best: NDArray[np.float64]) -> bool:
        """Return whether the window's own fit can be a changed valve.

        One tone far above resonance can't tell a spring from errors of the integration: there the fit takes
        the spring away. A spring changes by less.
        """
        stiffness = float(self.regression.parameters[DISPLACEMENT])
        return bool(abs(best[DISPLACEMENT] - stiffness) < SPRING_CHANGE * abs(stiffness))

    def _velocity_uncertainty(self, velocity: NDArray[np.float64]) -> float:
        """Return the relative error of the integrated velocity that dry friction causes, 1.

        At a reversal the acceleration jumps by 2 F_c / m somewhere between two samples; its integral is
        off by up to half that jump times the sample period, and the high-pass forgets it only after a while.
        """
        assert self._conditioning is not None
        period = self._conditioning.sample_period
        jump = 2.0 * abs(self.regression.parameters[DIRECTION]) / self.settings.moving_mass
        reversals = np.count_nonzero(np.diff(np.signbit(velocity))) / (velocity.size * period)
        remembered = max(1.0, reversals / (3.0 * self.settings.low_cut))
        error = jump * period / math.sqrt(12.0) * math.sqrt(remembered)
        return float(error / max(float(np.sqrt(np.mean(velocity**2))), 1.0e-9))

    def _estimate(self, stamp: int, sequence: int) -> Estimate:
        values, deviations = self.regression.parameters, self.regression.standard_deviations
        learned = bool(values[0] > 0.0 and deviations[0] < LEARNED * values[0])
        if self._settling:
            state = State.SETTLING
        elif not self._excited:
            state = State.NOT_EXCITED
        else:
            state = State.TRACKING if learned else State.LEARNING
        validity = Validity.UNKNOWN
        if learned:
            validity = Validity.VALID if self._excited else Validity.HELD
        parameters = tuple(
            _judged(name, unit, value, deviation, validity)
            for name, unit, value, deviation in zip(_NAMES, _UNITS, values, deviations, strict=True)
        )
        assert self._conditioning is not None
        delay = self._conditioning.delay * self._conditioning.sample_period
        described = stamp - round(delay * 1e9)
        fresh = self._samples - self._referred_samples
        self._referred_samples = self._samples
        self.oil.follow(described, fresh * self._conditioning.sample_period)
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
            **self._derived(validity),
            referred_viscous_coefficient=self.oil.referred(
                viscous or Quantity("viscous_coefficient", "N s/m")
            ),
            oil_temperature=self.oil.temperature(described),
            lost_blocks=self.gate.lost,
            refused_blocks=self.gate.refused,
        )

    def _derived(self, validity: Validity) -> dict[str, Quantity]:
        """Return what follows from the parameters and what the signals themselves show."""
        mass = self.settings.moving_mass
        stiffness, viscous, _ = (float(value) for value in self.regression.parameters)
        covariance = self.regression.covariance * np.outer(self.regression.scale, self.regression.scale)
        frequency = Quantity("natural_frequency", "Hz")
        damping = Quantity("damping_ratio", "1")
        if validity is not Validity.UNKNOWN:
            natural = math.sqrt(stiffness / mass) / (2.0 * math.pi)
            deviation = 0.5 * natural * math.sqrt(covariance[0, 0]) / stiffness
            frequency = replace(frequency, value=natural, standard_deviation=deviation, validity=validity)
            ratio = viscous / (2.0 * math.sqrt(stiffness * mass))
            slope = np.array([-0.5 * ratio / stiffness, ratio / viscous if viscous else 0.0])
            deviation = math.sqrt(max(0.0, float(slope @ covariance[:2, :2] @ slope)))
            damping = replace(damping, value=ratio, standard_deviation=deviation, validity=validity)
        residual, target, body, displacement = self._powers
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


def _judged(name: str, unit: str, value: float, deviation: float, validity: Validity) -> Quantity:
    """Return the parameter, unknown while learning, implausible where clearly negative."""
    if validity is Validity.UNKNOWN:
        return Quantity(name, unit)
    if value < -3.0 * deviation and value < 0.0:
        validity = Validity.IMPLAUSIBLE
    return Quantity(name, unit, float(value), float(deviation), validity)


def _holding(estimate: Estimate) -> Estimate:
    """Return ``estimate`` as stale: what was valid is held, what the signals showed is unknown."""

    def held(quantity: Quantity) -> Quantity:
        return replace(quantity, validity=Validity.HELD) if quantity.known else quantity

    def gone(quantity: Quantity) -> Quantity:
        return Quantity(quantity.name, quantity.unit)

    return replace(
        estimate,
        state=State.STALE,
        parameters=tuple(held(quantity) for quantity in estimate.parameters),
        natural_frequency=held(estimate.natural_frequency),
        damping_ratio=held(estimate.damping_ratio),
        referred_viscous_coefficient=held(estimate.referred_viscous_coefficient),
        oil_temperature=gone(estimate.oil_temperature),
        residual=gone(estimate.residual),
        excitation=gone(estimate.excitation),
        relative_displacement=gone(estimate.relative_displacement),
    )


def settings_for(valve: Valve, **changes: float) -> EstimatorSettings:
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
