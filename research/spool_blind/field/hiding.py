"""Hidden physics of a field case: nothing, effects of the catalogue, or a law outside of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spool_blind.case import NONE, PAIRS
from spool_blind.condition import ExperimentCondition, Scale
from spool_blind.effects import EFFECTS
from spool_blind.hidden import Generator, Hidden, between

from .laws import FIELD_LAWS

#: Of 12 seeds in a row: so many with nothing hidden, one effect, two effects; the rest a law of no catalogue.
BLOCK, SHARES = 12, (4, 4, 2)
#: Size over that of the clear cases, evenly in its logarithm: nobody looks whether it can be seen.
SIZE = (0.2, 1.5)
#: Share of the drifting viscosities that follow an exponential; its time constant over the record's length.
EXPONENTIAL, WARMING_TIME = 0.5, (0.15, 0.8)


@dataclass(frozen=True, slots=True)
class HiddenPhysics:
    """Hidden physics as it was drawn.

    Attributes:
        name: "none", an effect's id, two joined by "+", or a law's id.
        parts: each effect or law by its name.
        factor: size over that of the clear cases.
        reads_as: names that are right alone for a law outside of the catalogue.
    """

    name: str
    parts: dict[str, Hidden]
    factor: float
    reads_as: tuple[str, ...] = ()


def field_hidden_by(seed: int) -> str:
    """Return what the field case of ``seed`` hides: any 12 seeds in a row hold the same mixture."""
    none, single, pairs = SHARES
    block, place = divmod(seed, BLOCK)
    if place < none:
        return NONE
    if place < none + single:
        return sorted(EFFECTS)[(block * single + place - none) % len(EFFECTS)]
    if place < none + single + pairs:
        return str(np.random.default_rng([seed, 11]).choice(PAIRS))
    each = BLOCK - none - single - pairs
    return sorted(FIELD_LAWS)[(block * each + place - none - single - pairs) % len(FIELD_LAWS)]


def draw_hidden(
    generator: Generator, name: str, condition: ExperimentCondition, scale: Scale
) -> HiddenPhysics:
    """Draw what ``name`` hides under ``condition``, whose motion with nothing hidden is ``scale``.

    Raises:
        KeyError: ``name`` is none of those that can be hidden.
    """
    factor = float(np.exp(between(generator, *np.log(SIZE))))
    if name in FIELD_LAWS:
        law = FIELD_LAWS[name]
        hidden = law.draw(generator, condition, scale).sized(factor)
        return HiddenPhysics(name, {name: hidden}, factor, law.reads_as(hidden, condition, scale))
    parts = {}
    for one in [] if name == NONE else name.split("+"):
        hidden = EFFECTS[one].draw(generator, condition, scale).sized(factor)
        parts[one] = warming(generator, hidden, condition) if one == "damping_drift" else hidden
    return HiddenPhysics(name, parts, factor)


def warming(generator: Generator, linear: Hidden, condition: ExperimentCondition) -> Hidden:
    """Return the drift ``linear`` in time, or with the same change over the record along an exponential."""
    exponential = generator.random() < EXPONENTIAL
    constant = between(generator, *WARMING_TIME) * condition.duration
    if not exponential:
        return linear
    change = linear.plant["damping_rate"] * condition.duration
    share = change / (1.0 - float(np.exp(-condition.duration / constant)))
    return replace(
        linear,
        plant={"warming_share": share, "warming_time": constant},
        truth={"damping_drift_rate": share / constant, "damping_drift_time": constant},
        size=("warming_share",),
    )
