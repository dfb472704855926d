"""Field case: a record as a measuring chain stores it, with its truth; nobody looks what it shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from spool_blind.case import FROM_REST, NONE, kind_of, sample_times
from spool_blind.condition import ExperimentCondition
from spool_blind.effects import EFFECTS
from spool_blind.simulator.plant import SpoolMotion

from .condition import NOISE, draw_field_condition
from .hiding import HiddenPhysics, draw_hidden, field_hidden_by
from .importance import Importance, ImportanceJudge, plant_of
from .measuring_chain import MeasuringChain
from .nuisances.drawing import draw_nuisances, names_by
from .nuisances.nuisance import BODY, CHANNELS, SPOOL, FieldNuisance, Seen
from .seeds import window_of

Array = NDArray[np.float64]

#: First number of each of a case's streams of random numbers: no other family of cases has them.
FAMILY = 17
CONDITION, HIDDEN, NUISANCE_NAMES, NUISANCE_SIZES, NOISE_STREAM = range(5)
#: s that a record ends ahead of its motion: delays of filters are taken off by looking ahead.
LOOK_AHEAD = 0.05
UNEXPLAINED = "unexplained"


@dataclass(frozen=True, slots=True)
class FieldCase:
    """Field case: a record with its truth.

    Attributes:
        seed: makes it again.
        hidden: "none", an effect's id, two joined by "+", or the id of a law outside of the catalogue.
        accepted: verdicts that are right; if "unexplained" is, so is it next to names.
        factor: size over that of the clear cases.
        condition: drawn.
        plant: numbers of the plant, with what is hidden.
        chain: both channels, with their nuisances.
        truth: values a fit should find, by effect, then by parameter; SI.
        importance: of each hidden effect or law.
        time, body, spool: the record as it is stored, s and m/s^2, shape (n,); NaN where a sample is empty.
    """

    seed: int
    hidden: str
    accepted: tuple[str, ...]
    factor: float
    condition: ExperimentCondition
    plant: Mapping[str, float]
    chain: MeasuringChain
    truth: Mapping[str, Mapping[str, float]]
    importance: Mapping[str, Importance]
    time: Array
    body: Array
    spool: Array

    @property
    def kind(self) -> str:
        """Kind of what is hidden, see ``spool_blind.case.kind_of``."""
        return kind_of(self.hidden)

    @property
    def window(self) -> str:
        """Window of its seed, see :mod:`spool_blind.field.seeds`."""
        return window_of(self.seed)

    @property
    def nuisances(self) -> tuple[FieldNuisance, ...]:
        """What the measuring chain does to the record."""
        return self.chain.nuisances


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
    condition = draw_field_condition(_stream(seed, CONDITION), from_rest=from_rest)
    physics = draw_hidden(_stream(seed, HIDDEN), hidden, condition, condition.scale())
    plant = plant_of(condition, list(physics.parts.values()))
    motion = condition.move(plant)
    time = sample_times(condition)
    time = time[: time.size - round(LOOK_AHEAD * condition.sample_rate)]
    if nuisances is None:
        nuisances = names_by(_stream(seed, NUISANCE_NAMES), names)
    drawn = draw_nuisances(_stream(seed, NUISANCE_SIZES), nuisances, _seen(condition, motion))
    chain = _chain(seed, condition, physics, motion, drawn)
    judge = ImportanceJudge(condition, chain, physics.parts, time)
    importance = {name: judge.importance(name) for name in physics.parts}
    like_coulomb = {name for name in physics.parts if importance[name].matters and judge.is_coulomb(name)}
    stored = chain.record(motion, time)
    return FieldCase(
        seed=seed,
        hidden=hidden,
        accepted=accepted_verdicts(physics, importance, like_coulomb, drawn),
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
    nuisances: Sequence[FieldNuisance],
) -> tuple[str, ...]:
    """Return the verdicts that are right, ids in the order of the alphabet.

    What matters is named, what does not may be; so may what a nuisance does to the spool's channel. A law of
    no catalogue has to leave something unexplained, unless it reads as a name.
    """
    # Of each hidden thing one of these is said.
    choices: list[tuple[str, ...]] = []
    for name in physics.parts:
        said = (name,) if name in EFFECTS else (UNEXPLAINED, *physics.reads_as)
        if name in like_coulomb:
            said = (*said, "coulomb_friction")
        choices.append(said if importance[name].matters else ("", *said))
    for one in nuisances:
        choices += [("", name) for name in one.may_be_named]
    return tuple(dict.fromkeys(_joined(row) for row in product(*choices)))


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
        noise={name: shares[name] * float(rows[name].std()) for name in CHANNELS},
        nuisances=nuisances,
        seed=int(generator.integers(2**31)),
    )
