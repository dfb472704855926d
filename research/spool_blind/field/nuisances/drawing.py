"""Registry of nuisances, and how many of them a record carries."""

from __future__ import annotations

from collections.abc import Sequence

from .added import BiasDrift, ColouredNoise, CrossAxis, MainsHum, Spikes
from .converted import Clipping, GainDrift, Jitter, LostSamples, Quantisation
from .filtered import AcCoupling, AntiAlias, ExtraMode
from .nuisance import FieldNuisance, Generator, Seen

NUISANCES: dict[str, type[FieldNuisance]] = {
    kind.id: kind
    for kind in (
        MainsHum, BiasDrift, AcCoupling, AntiAlias, CrossAxis, GainDrift, Spikes, LostSamples, Quantisation,
        Jitter, Clipping, ColouredNoise, ExtraMode,
    )
}  # fmt: skip
#: Share of the records that carry nuisances, and how many at most.
SHARE, MOST = 2.0 / 3.0, 3


def names_by(generator: Generator, hidden: Sequence[str]) -> tuple[str, ...]:
    """Draw the names of a record's nuisances: none, or one to three that ``hidden`` is not mistaken for."""
    carries = generator.random() < SHARE
    count = int(generator.integers(1, MOST + 1))
    possible = [name for name, kind in NUISANCES.items() if not set(kind.excludes) & set(hidden)]
    chosen = generator.choice(possible, count, replace=False)
    return tuple(str(name) for name in chosen) if carries else ()


def draw_nuisances(generator: Generator, names: Sequence[str], seen: Seen) -> tuple[FieldNuisance, ...]:
    """Draw each of ``names``; in the order of the measuring chain.

    Raises:
        KeyError: there is no such nuisance.
    """
    drawn = [NUISANCES[name].draw(generator, seen) for name in names]
    return tuple(sorted(drawn, key=lambda one: one.stage))
