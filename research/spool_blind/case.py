"""Blind case: a record, what is hidden in it, and how visible that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from spool_blind.simulator.channels import Channels

from .condition import ExperimentCondition, Scale, draw_condition
from .effects import EFFECTS
from .hidden import Hidden, Kind
from .out_of_catalogue import OUT_OF_CATALOGUE
from .visibility import Visibility, look, noncentrality, threshold

Array = NDArray[np.float64]

NONE = "none"
#: At clear size the remainder after the base is at least this many times the noise floor, rms over rms.
CLEAR = 1.0
#: For out-of-catalogue effects gain and delay may be so many times out of tolerance: those have names.
OUT_OF_CATALOGUE_TOLERANCE = 10.0
#: Least noncentrality of a test between an effect and a simpler one that it contains: noise covers less.
DISTINCT = 40.0
#: The spool still moves by this share of what it would with nothing hidden: a locked one tells nothing.
LEAST_TRAVEL = 0.2
#: Two accelerometers see these only in how the motion sets in.
FROM_REST = ("asymmetric_friction",)
GROWTH, GROWTHS, DRAWS = 1.5, 3, 12
#: Of 20 seeds in a row: so many with nothing hidden, one effect, two effects; the rest no catalogue lists.
SHARES = (4, 10, 3)

PAIRS: tuple[str, ...] = tuple(
    f"{one}+{other}"
    for one, other in combinations(sorted(EFFECTS), 2)
    if EFFECTS[one].group != EFFECTS[other].group
    and {"gain", "delay"} != {EFFECTS[one].group, EFFECTS[other].group}
)


@dataclass(frozen=True, slots=True)
class BlindCase:
    """Blind case: a record with its truth.

    Attributes:
        seed: makes it again.
        hidden: "none", an effect's id, two joined by "+", or an out-of-catalogue effect's name.
        accepted: verdicts that are right.
        factor: size over the size that was drawn.
        condition: drawn.
        plant: drawn, with what is hidden.
        channels: drawn, with what is hidden.
        truth: values a fit should find, by effect, then by parameter; SI.
        visibility: of what is hidden, together; ``None`` where nothing is.
        time, body, spool: the record, s and m/s^2, shape (n,).
    """

    seed: int
    hidden: str
    accepted: tuple[str, ...]
    factor: float
    condition: ExperimentCondition
    plant: Mapping[str, float]
    channels: Channels
    truth: Mapping[str, Mapping[str, float]]
    visibility: Visibility | None
    time: Array
    body: Array
    spool: Array

    @property
    def kind(self) -> str:
        """Kind of what is hidden, see ``kind_of``."""
        return kind_of(self.hidden)

    @property
    def threshold(self) -> float:
        """Detection threshold: evidence at which a test that knows the effect sees half of the records."""
        return threshold(max(1, sum(len(values) for values in self.truth.values())))


def kind_of(hidden: str) -> str:
    """Return none, effect, pair or out_of_catalogue."""
    if hidden == NONE:
        return NONE
    if "+" in hidden:
        return "pair"
    return "effect" if hidden in EFFECTS else "out_of_catalogue"


def hidden_by(seed: int) -> str:
    """Return what the case of ``seed`` hides: any 20 seeds in a row hold the same mixture."""
    none, single, pairs = SHARES
    block, place = divmod(seed, 20)
    if place < none:
        return NONE
    if place < none + single:
        return sorted(EFFECTS)[(block * single + place - none) % len(EFFECTS)]
    generator = np.random.default_rng([seed, 7])
    if place < none + single + pairs:
        return str(generator.choice(PAIRS))
    each = 20 - none - single - pairs
    return sorted(OUT_OF_CATALOGUE)[(block * each + place - none - single - pairs) % len(OUT_OF_CATALOGUE)]


def make(
    seed: int, hidden: str | None = None, *, factor: float | None = None, moderate: bool = False
) -> BlindCase:
    """Make the case of ``seed``.

    Args:
        seed: the same gives the same record, bit for bit on one machine.
        hidden: what to hide; left out, the seed decides.
        factor: size over what is drawn; left out, the size is clear (see ``CLEAR``).
        moderate: under a moderate condition, see ``draw_condition``.

    Raises:
        KeyError: ``hidden`` names nothing that can be hidden.
        RuntimeError: nothing clear was found in ``DRAWS`` draws.
    """
    hidden = hidden_by(seed) if hidden is None else hidden
    kinds = [] if hidden == NONE else [_kind(name) for name in hidden.split("+")]
    tolerance = OUT_OF_CATALOGUE_TOLERANCE if kind_of(hidden) == "out_of_catalogue" else 1.0
    generator = np.random.default_rng(seed)
    for _ in range(DRAWS):
        from_rest = any(name in FROM_REST for name in hidden.split("+"))
        condition = draw_condition(generator, from_rest=from_rest, moderate=moderate)
        scale = condition.scale()
        things = [kind.draw(generator, condition, scale) for kind in kinds]
        noise_seed = int(generator.integers(2**31))
        if not things or factor is not None:
            size = 1.0 if factor is None else factor
            return _record(
                seed, hidden, BlindTrial(condition, [thing.sized(size) for thing in things]), noise_seed, size
            )
        for growth in range(GROWTHS + 1):
            size = GROWTH**growth
            grown = [thing.sized(size) for thing in things]
            alone = [BlindTrial(condition, [thing], tolerance) for thing in grown]
            if all(trial.clear(scale) for trial in alone):
                trial = alone[0] if len(alone) == 1 else BlindTrial(condition, grown)
                # Friction may keep the spool from the stop, or its sensor from the rail, but for one hit.
                if len(alone) == 1 or all(trial.differs(other) for other in alone):
                    return _record(seed, hidden, trial, noise_seed, size)
            if not all(thing.size or thing.edges for thing in things):
                break
    raise RuntimeError(f"seed {seed}: {hidden} was not clear under any of {DRAWS} conditions")


def _kind(name: str) -> Kind:
    return EFFECTS[name] if name in EFFECTS else OUT_OF_CATALOGUE[name]


class BlindTrial:
    """Trial of a size: the motion with something hidden, and how visible that is."""

    def __init__(self, condition: ExperimentCondition, things: list[Hidden], tolerance: float = 1.0) -> None:
        plant = condition.base
        for thing in things:
            plant = plant.with_(**thing.plant)
        self.condition, self.things, self.plant = condition, things, plant
        self.motion = condition.move(plant)
        moving = self.motion.time > 0.0
        self.travel = float(self.motion.displacement[moving].std())
        noise = condition.noise_share * float(self.motion.spool[moving].std())
        values: dict[str, float] = {"gain": condition.gain, "delay": condition.delay, "noise": noise}
        for thing in things:
            values.update(thing.channel)
        self.channels = Channels(**values)
        self.quiet = replace(self.channels, noise=0.0)
        _, self.spool = self.quiet.read(self.motion, sample_times(condition), np.random.default_rng(0))
        self.visibility: Visibility | None = self._look(tolerance) if things else None

    def _look(self, tolerance: float) -> Visibility:
        condition = self.condition
        t = sample_times(condition)
        before = round(condition.before * condition.sample_rate)
        whole = np.arange(-before, t.size) / condition.sample_rate
        return look(
            condition.base.numbers,
            condition.amplitude * condition.excitation.at(whole),
            self.spool,
            condition.sample_rate,
            first=before,
            noise=self.channels.noise,
            tolerance=tolerance,
        )

    def clear(self, scale: Scale) -> bool:
        """Return whether what is hidden is seen, distinguished from less, and lets the spool move."""
        seen = self.visibility is None or self.visibility.over_noise >= CLEAR
        return seen and self.travel >= LEAST_TRAVEL * scale.travel and all(map(self._distinct, self.things))

    def _distinct(self, thing: Hidden) -> bool:
        if not thing.simpler:
            return True
        simpler = replace(thing, plant={**thing.plant, **thing.simpler}, simpler={})
        others = [simpler if entry is thing else entry for entry in self.things]
        difference = self.spool - BlindTrial(self.condition, others).spool
        numbers, rate = self.condition.base.numbers, self.condition.sample_rate
        return noncentrality(difference, numbers, rate, self.channels.noise) >= DISTINCT

    def differs(self, other: BlindTrial) -> bool:
        """Return whether the record without noise differs from ``other``, and not in one second only.

        Both in steps of one length: friction is sensitive to those.
        """
        motion = self.condition.move(other.plant, like=self.plant)
        _, spool = other.quiet.read(motion, sample_times(self.condition), np.random.default_rng(0))
        squares = (self.spool - spool) ** 2
        seconds = np.arange(0, squares.size, round(self.condition.sample_rate))
        loudest = int(np.argmax(np.add.reduceat(squares, seconds)))
        squares[seconds[loudest] :][: round(self.condition.sample_rate)] = 0.0
        return float(np.sqrt(squares.mean())) >= CLEAR * self.channels.noise


def sample_times(condition: ExperimentCondition) -> Array:
    """Return the instants of the record's samples, s, shape (n,)."""
    return np.arange(round(condition.duration * condition.sample_rate)) / condition.sample_rate


def _record(seed: int, hidden: str, trial: BlindTrial, noise_seed: int, factor: float) -> BlindCase:
    t = sample_times(trial.condition)
    body, spool = trial.channels.read(trial.motion, t, np.random.default_rng(noise_seed))
    names = [] if hidden == NONE else hidden.split("+")
    return BlindCase(
        seed=seed,
        hidden=hidden,
        accepted=OUT_OF_CATALOGUE[hidden].accepted if hidden in OUT_OF_CATALOGUE else (hidden,),
        factor=factor,
        condition=trial.condition,
        plant=trial.plant.numbers,
        channels=trial.channels,
        truth={name: thing.truth for name, thing in zip(names, trial.things, strict=True) if thing.truth},
        visibility=trial.visibility,
        time=t,
        body=body,
        spool=spool,
    )
