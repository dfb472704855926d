"""Field case: a record as a measuring chain stores it, its truth and how much that matters, and its files.

A name is demanded only of an effect that matters. Its share is the difference between the records with and
without it, the base refitted to the one without: stiffness, drag, and gain and delay within their tolerances
take what they can.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq
from scipy.optimize import lsq_linear
from scipy.signal import welch
from scipy.stats import chi2, ncx2

from spool_blind.condition import DELAY_TOLERANCE, GAIN_TOLERANCE, NOISE, ExperimentCondition, draw_condition
from spool_blind.field.foreign import KINDS, foreign_names
from spool_blind.field.hiding import HiddenPhysics, draw_hidden, field_hidden_by
from spool_blind.field.logger import POINTS, LoggerFilter, draw_filters
from spool_blind.field.nuisances import (
    ALLOWED_DELAY,
    BODY,
    CHANNELS,
    NUISANCES,
    SPOOL,
    FieldNuisance,
    Seen,
    draw_nuisances,
    names_by,
)
from spool_blind.hidden import EFFECTS, FROM_REST, NONE, Hidden, kind_of
from spool_blind.simulator import Plant, SpoolMotion, dry, transmissibility

Array = NDArray[np.float64]

#: First number of each of a case's streams of random numbers: no other family of cases has them.
FAMILY = 17
CONDITION, HIDDEN, NUISANCE_NAMES, NUISANCE_SIZES, NOISE_STREAM, LOGGER = range(6)
#: s that a record ends ahead of its motion: delays of filters are taken off by looking ahead.
LOOK_AHEAD = 0.05
UNEXPLAINED = "unexplained"

#: Seeds by window: confidence is calibrated on the first, checked on the second; the third is touched by no
#: choice and gives the errors that are reported. All others are development, those from 300,000 on since the
#: figures that they gave were made without a logger's filter.
WINDOWS: dict[str, range] = {
    "calibration": range(100_000, 200_000),
    "check": range(200_000, 300_000),
    "report": range(500_000, 600_000),
}
DEVELOPMENT = "development"

#: Share of the spool's acceleration (rms) that a name has to be worth: the default of `gap --least-share`.
LEAST_SHARE = 0.0025
#: For laws of no catalogue gain and delay may be so many times out of tolerance: those have names.
OUT_OF_CATALOGUE_TOLERANCE = 10.0
#: Rate of false alarms, and power at the threshold: half of the records.
FALSE_ALARM, POWER = 0.01, 0.5
#: Laws of friction that contain Coulomb friction, or come close to it where their passage is short.
LIKE_COULOMB = ("stribeck_friction", "mixed_friction", "asymmetric_friction", "presliding_friction")
#: Relative steps of stiffness, drag and friction for slopes.
STEPS = {"stiffness": 0.002, "damping": 0.02, "coulomb_force": 0.02}
#: Steps of a refit at most, and share of the remaining error above which another one is not worth its time.
ROUNDS, ENOUGH = 6, 0.97
#: Change of a number in one step at most.
LARGEST_CHANGE = (0.6, 1.6)


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCase:
    """A record behind a measuring chain, with its truth.

    Attributes:
        seed: makes it again.
        hidden: "none", an effect's id, two joined by "+", or the id of a law outside of the catalogue.
        accepted: verdicts that are right; with "unexplained" among them, so is that next to names.
        factor: size over that of an effect that is clear.
        condition: drawn.
        plant: numbers of the plant, with what is hidden.
        truth: values a fit should find, by effect, then by parameter; SI.
        time, body, spool: the record as it is stored, s and m/s^2, shape (n,); NaN where a sample is empty.
        chain: both channels, with their nuisances.
        importance: of each hidden effect or law.
    """

    seed: int
    hidden: str
    accepted: tuple[str, ...]
    factor: float
    condition: ExperimentCondition
    plant: Mapping[str, float]
    truth: Mapping[str, Mapping[str, float]]
    time: Array
    body: Array
    spool: Array
    chain: MeasuringChain
    importance: Mapping[str, Importance]

    @property
    def kind(self) -> str:
        """Kind of what is hidden, see ``kind_of``."""
        return kind_of(self.hidden)

    @property
    def window(self) -> str:
        """Window of its seed, see :mod:`spool_blind.field.case`."""
        return window_of(self.seed)

    @property
    def nuisances(self) -> tuple[FieldNuisance, ...]:
        """What the measuring chain does to the record."""
        return self.chain.nuisances

    @property
    def sampled(self) -> str:
        """Kind of the filters that it was sampled behind, and whether they differ."""
        body, spool = (self.chain.filters[name] for name in CHANNELS)
        return body.kind if body == spool else f"{body.kind}, channels differ"

    def told(self) -> dict[str, Any]:
        """Return what is true of it, for JSON, SI units."""
        condition = self.condition
        return {
            "seed": self.seed,
            "kind": self.kind,
            "hidden": self.hidden,
            "accepted": list(self.accepted),
            "factor": self.factor,
            "effects": {name: dict(values) for name, values in self.truth.items()},
            "plant": dict(self.plant),
            "drive": condition.excitation.kind,
            "amplitude_m_s2": condition.amplitude,
            "band_Hz": [condition.excitation.low, condition.excitation.high],
            "sample_rate_Hz": condition.sample_rate,
            "duration_s": condition.duration,
            "nominal_stiffness_N_m": condition.nominal_stiffness,
            "window": self.window,
            "importance": {
                name: {**asdict(one), "matters": one.matters} for name, one in self.importance.items()
            },
            "nuisances": [
                {"id": one.id, "channel": one.channel, "size": one.size, "unit": one.unit}
                for one in self.nuisances
            ],
            "observation": {name: one.told() for name, one in self.chain.filters.items()},
            "noise_m_s2": dict(self.chain.noise),
            "gain": self.chain.gain,
            "delay_s": self.chain.delay,
        }


def make_field(seed: int, hidden: str | None = None, nuisances: Sequence[str] | None = None) -> FieldCase:
    """Make the field case of ``seed``.

    Args:
        seed: the same gives the same record, bit for bit on one machine.
        hidden: what to hide; left out, the seed decides.
        nuisances: names of the nuisances; left out, the seed decides.

    Raises:
        KeyError: ``hidden`` or ``nuisances`` name nothing that there is.
    """
    hidden = field_hidden_by(seed) if hidden is None else hidden
    names = hidden.split("+")
    from_rest = any(name in FROM_REST for name in names)
    condition = draw_condition(_stream(seed, CONDITION), from_rest=from_rest)
    physics = draw_hidden(_stream(seed, HIDDEN), hidden, condition, condition.scale())
    plant = plant_of(condition, list(physics.parts.values()))
    motion = condition.move(plant)
    time = np.arange(round((condition.duration - LOOK_AHEAD) * condition.sample_rate)) / condition.sample_rate
    if nuisances is None:
        nuisances = foreign_names(seed) or names_by(_stream(seed, NUISANCE_NAMES), names)
    kinds = NUISANCES | KINDS
    drawn = draw_nuisances(_stream(seed, NUISANCE_SIZES), nuisances, _seen(condition, motion), kinds)
    chain = _chain(seed, condition, physics, motion, drawn)
    judge = ImportanceJudge(condition, chain, physics.parts, time, motion)
    importance = {name: judge.importance(name) for name in physics.parts}
    like_coulomb = {name for name in physics.parts if importance[name].matters and judge.is_coulomb(name)}
    stored = chain.record(condition.move(plant, points=POINTS), time)
    return FieldCase(
        seed=seed,
        hidden=hidden,
        accepted=accepted_verdicts(physics, importance, like_coulomb, (*drawn, chain)),
        factor=physics.factor,
        condition=condition,
        plant=plant.numbers,
        chain=chain,
        truth={name: part.truth for name, part in physics.parts.items() if part.truth},
        importance=importance,
        time=stored[0],
        body=stored[1],
        spool=stored[2],
    )


def accepted_verdicts(
    physics: HiddenPhysics,
    importance: Mapping[str, Importance],
    like_coulomb: set[str],
    faults: Sequence[FieldNuisance | MeasuringChain],
) -> tuple[str, ...]:
    """Return the verdicts that are right, ids in the order of the alphabet.

    What matters is named, what does not may be; so may what ``faults`` do to the spool's channel. A law of
    no catalogue has to leave something unexplained, unless it reads as a name.
    """
    # Each hidden thing gets one of these labels.
    choices: list[tuple[str, ...]] = []
    for name in physics.parts:
        said = (name,) if name in EFFECTS else (UNEXPLAINED, *physics.reads_as)
        if name in like_coulomb:
            said = (*said, "coulomb_friction")
        choices.append(said if importance[name].matters else ("", *said))
    for one in faults:
        choices += [("", name) for name in one.may_be_named]
    return tuple(dict.fromkeys(_joined(row) for row in product(*choices)))


@dataclass(frozen=True, slots=True)
class MeasuringChain:
    """Gain, delay and range of the spool's channel, filter and noise of both, and nuisances.

    Attributes:
        gain, delay, full_scale: of the spool's channel over the body's, 1, s and m/s^2 (0: none); a delay
            that the filters make is not counted.
        filters: of the logger, by channel.
        noise: rms of the converters' white noise by channel, m/s^2: no filter passes it.
        nuisances: in the order of the chain.
        seed: of the noise.
    """

    gain: float
    delay: float
    full_scale: float
    filters: Mapping[str, LoggerFilter]
    noise: Mapping[str, float]
    nuisances: tuple[FieldNuisance, ...]
    seed: int

    @property
    def may_be_named(self) -> tuple[str, ...]:
        """A delay that a data sheet does not allow, where the channels' filters differ."""
        delay = self.filters[SPOOL].delay - self.filters[BODY].delay
        return ("spool_delay",) if abs(delay) > ALLOWED_DELAY else ()

    def quiet(self, channel: str, motion: SpoolMotion, time: Array) -> Array:
        """Return the reading (m/s^2) at ``time`` (s) without noise and nuisances."""
        return self._sampled(channel, motion.spool if channel == SPOOL else motion.body, motion, time)

    def record(self, motion: SpoolMotion, time: Array) -> tuple[Array, Array, Array]:
        """Return the record as it is stored: time (s), body and spool (m/s^2)."""
        body, spool = (self._reading(channel, motion, time) for channel in CHANNELS)
        for one in self.nuisances:
            time, body, spool = one.on_samples(time, body, spool)
        return time, body, spool

    def noise_of(self, channel: str, quiet: Array, rate: float) -> Array:
        """Return all noise of a channel whose reading is ``quiet`` (m/s^2, ``rate`` Hz)."""
        total = self._white(channel, quiet.size, rate)
        for one in self._of(channel):
            total = total + one.like_noise(channel, quiet, rate)
        return total

    def _of(self, channel: str) -> list[FieldNuisance]:
        return [one for one in self.nuisances if channel in one.sizes]

    def _white(self, channel: str, size: int, rate: float) -> Array:
        noise = np.random.default_rng([self.seed, CHANNELS.index(channel)]).standard_normal(size)
        noise *= self.noise[channel]
        for one in self._of(channel):
            noise = one.on_noise(channel, noise, rate)
        return noise

    def _sampled(self, channel: str, signal: Array, motion: SpoolMotion, instants: Array) -> Array:
        read = self.filters[channel].read
        if channel == BODY:
            return read(signal, motion, instants)
        row = self.gain * read(signal, motion, instants - self.delay)
        return np.clip(row, -self.full_scale, self.full_scale) if self.full_scale > 0.0 else row

    def _reading(self, channel: str, motion: SpoolMotion, time: Array) -> Array:
        own = self._of(channel)
        signal = motion.spool if channel == SPOOL else motion.body
        instants = time
        for one in own:
            signal = one.on_motion(channel, signal, 1.0 / motion.step)
            instants = one.instants(instants)
        row = self._sampled(channel, signal, motion, instants)
        rate = (time.size - 1) / (time[-1] - time[0])
        row = row + self._white(channel, row.size, rate)
        for one in own:
            row = one.on_reading(channel, row + one.disturbance(channel, row, rate), time)
        return (
            np.clip(row, -self.full_scale, self.full_scale) if channel == SPOOL and self.full_scale else row
        )


def window_of(seed: int) -> str:
    """Return the window that ``seed`` belongs to, a key of ``WINDOWS`` or ``DEVELOPMENT``."""
    return next((name for name, seeds in WINDOWS.items() if seed in seeds), DEVELOPMENT)


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


def threshold(parameters: int) -> float:
    """Return the evidence at which a test for ``parameters`` numbers sees half of the records.

    The test raises one false alarm in a hundred records.
    """
    critical = float(chi2.ppf(1.0 - FALSE_ALARM, parameters))
    low, high = 0.0, 10.0 * critical
    for _ in range(60):
        middle = 0.5 * (low + high)
        if ncx2.sf(critical, parameters, middle) < POWER:
            low = middle
        else:
            high = middle
    return high


class ImportanceJudge:
    """Judge of the importance of what is hidden in one record."""

    def __init__(
        self,
        condition: ExperimentCondition,
        chain: MeasuringChain,
        parts: Mapping[str, Hidden],
        time: Array,
        motion: SpoolMotion,
    ) -> None:
        self.condition, self.chain, self.parts = condition, chain, parts
        self.time, self.motion = time, motion
        self.plant = plant_of(condition, list(parts.values()))
        self.spool = chain.quiet(SPOOL, motion, time)
        self._density = self._densities()

    def importance(self, name: str) -> Importance:
        """Return how much the effect ``name`` matters."""
        hidden = self.parts[name]
        others = [part for other, part in self.parts.items() if other != name]
        sensor = hidden.channel
        numbers = plant_of(self.condition, others)
        ideal: dict[str, Any] = {"gain": 1.0, "delay": 0.0, "full_scale": 0.0}
        bare = replace(self.chain, nuisances=(), **{name: ideal[name] for name in sensor})
        without = self._reading(bare, numbers)
        tolerance = 1.0 if name in EFFECTS else OUT_OF_CATALOGUE_TOLERANCE
        found = self._left(bare, numbers, ("stiffness", "damping"), tolerance)
        limit = threshold(max(1, len(hidden.truth)))
        return Importance(float((self.spool - without).std() / self.spool.std()), *found, limit)

    def is_coulomb(self, name: str) -> bool:
        """Return whether the friction ``name`` is like Coulomb friction of the same loss."""
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
        """Return share and evidence of the remainder once the numbers ``free``, gain, delay are refitted."""
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


def _joined(names: Sequence[str]) -> str:
    said = sorted({name for name in names if name}, key=lambda name: (name == UNEXPLAINED, name))
    return "+".join(said) or NONE


def _stream(seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng([FAMILY, seed, stream])


def _seen(condition: ExperimentCondition, motion: SpoolMotion) -> Seen:
    rows = dict(_moving(motion))
    return Seen(
        rms={name: float(row.std()) for name, row in rows.items()},
        peak={name: float(np.abs(row).max()) for name, row in rows.items()},
        rate=condition.sample_rate,
        duration=condition.duration,
        low=condition.excitation.low,
        high=condition.excitation.high,
    )


def _moving(motion: SpoolMotion) -> Iterator[tuple[str, Array]]:
    inside = motion.time > 0.0
    yield BODY, motion.body[inside]
    yield SPOOL, motion.spool[inside]


def _chain(
    seed: int,
    condition: ExperimentCondition,
    physics: HiddenPhysics,
    motion: SpoolMotion,
    nuisances: tuple[FieldNuisance, ...],
) -> MeasuringChain:
    generator = _stream(seed, NOISE_STREAM)
    sensor: dict[str, float] = {}
    for part in physics.parts.values():
        sensor.update(part.channel)
    shares = {SPOOL: condition.noise_share, BODY: float(np.exp(generator.uniform(*np.log(NOISE))))}
    rows = dict(_moving(motion))
    return MeasuringChain(
        gain=sensor.get("gain", condition.gain),
        delay=sensor.get("delay", condition.delay),
        full_scale=sensor.get("full_scale", 0.0),
        filters=draw_filters(_stream(seed, LOGGER), condition.sample_rate, alike="delay" in sensor),
        noise={name: shares[name] * float(rows[name].std()) for name in CHANNELS},
        nuisances=nuisances,
        seed=int(generator.integers(2**31)),
    )
