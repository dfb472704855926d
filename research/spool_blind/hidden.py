"""Hidden effects: how large they are, and what they do to plant and channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .condition import ExperimentCondition, Scale

Generator = np.random.Generator
#: A limit is not drawn further in than this share of the peak.
LEAST_EDGE = 0.3


@dataclass(frozen=True, slots=True)
class Hidden:
    """Hidden effect at the size it was drawn with.

    Attributes:
        plant: numbers of the plant that it sets, see ``laws.NAMES``.
        channel: attributes of ``Channels`` that it sets.
        truth: values that a fit should find, by the names of the catalogue's parameters, SI.
        size: names in ``plant``, ``channel`` and ``truth`` that grow with its size.
        edges: names of limits, with the peak that they cut; larger is further below the peak.
        simpler: numbers of the plant that make it a simpler effect, from which it must be distinguished.
    """

    plant: Mapping[str, float] = field(default_factory=dict)
    channel: Mapping[str, float] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    size: tuple[str, ...] = ()
    edges: Mapping[str, float] = field(default_factory=dict)
    simpler: Mapping[str, float] = field(default_factory=dict)

    def sized(self, factor: float) -> Hidden:
        """Return the same, ``factor`` times as large."""

        def scaled(values: Mapping[str, float]) -> dict[str, float]:
            return {name: self._scaled(name, value, factor) for name, value in values.items()}

        channel = scaled(self.channel)
        if "gain" in channel:  # its size is what it differs from 1 by
            channel["gain"] = 1.0 + factor * (self.channel["gain"] - 1.0)
        return replace(self, plant=scaled(self.plant), channel=channel, truth=scaled(self.truth))

    def _scaled(self, name: str, value: float, factor: float) -> float:
        if name in self.edges:
            peak = self.edges[name]
            return max(peak - factor * (peak - value), LEAST_EDGE * peak)
        return value * factor if name in self.size else value


Draw = Callable[[Generator, ExperimentCondition, Scale], Hidden]


@dataclass(frozen=True, slots=True)
class Kind:
    """Kind of hidden effect.

    Attributes:
        draw: draws it at clear size for a condition and the motion it has without it.
        group: two of a pair come from different groups.
        accepted: verdicts that are right; for an effect of the catalogue its own id.
        richer: a law of friction that contains Coulomb friction.
    """

    draw: Draw
    group: str
    accepted: tuple[str, ...]
    richer: bool = False


def between(generator: Generator, low: float, high: float) -> float:
    """Draw evenly from ``low`` to ``high``."""
    return float(generator.uniform(low, high))


def either_sign(generator: Generator, value: float, positive: float = 0.5) -> float:
    """Return ``value`` with a drawn sign, plus with the chance ``positive``."""
    return value if generator.random() < positive else -value
