"""Plant: a spool with what acts on it, and how it moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .laws import NAMES, PLACE
from .stepping import step_through

Array = NDArray[np.float64]

#: s, longest step, and rad, how far the stiffest contact may turn within one.
LONGEST_STEP, LARGEST_TURN = 25e-6, 0.03
#: Stiffness of all slip elements together over force by travel: of four, 1 + 1/2 + 1/3 + 1/4.
SLIP_STIFFNESS = 25.0 / 12.0
#: s of motion after the record's end, for a channel that is ahead.
AFTER = 0.01


@dataclass(frozen=True, slots=True)
class Plant:
    """Plant numbers by name, see ``laws.NAMES``; what is not named is absent."""

    numbers: Mapping[str, float]

    def __post_init__(self) -> None:
        unknown = set(self.numbers) - set(NAMES)
        if unknown:
            raise KeyError(f"a plant has no {', '.join(sorted(unknown))}")

    def array(self) -> Array:
        """Return the numbers in the order of ``laws.NAMES``."""
        values = np.zeros(len(NAMES))
        for name, value in self.numbers.items():
            values[PLACE[name]] = value
        return values

    def with_(self, **numbers: float) -> Plant:
        """Return the same plant with other or further numbers."""
        return Plant({**self.numbers, **numbers})

    @property
    def longest_step(self) -> float:
        """Longest step that the plant's stiffest contact allows, s."""

        def over(force: str, travel: str) -> float:
            return self.numbers[force] / self.numbers[travel] if travel in self.numbers else 0.0

        stiffest = max(
            self.numbers.get("stop_stiffness", 0.0),
            self.numbers.get("bristle_stiffness", 0.0),
            over("preload_force", "preload_travel"),
            over("soft_preload", "soft_travel"),
            SLIP_STIFFNESS * over("slip_force", "slip_travel"),
            self.numbers["stiffness"],
        )
        return min(LONGEST_STEP, LARGEST_TURN / float(np.sqrt(stiffest / self.numbers["mass"])))


@dataclass(frozen=True, slots=True)
class SpoolMotion:
    """Motion of a plant: values in the middles of equal steps.

    Attributes:
        time: s since the record's start; negative before it, shape (n,).
        step: s.
        body: acceleration of the body, m/s^2, shape (n,).
        spool: acceleration of the spool, m/s^2, shape (n,).
        displacement: of the spool relative to the body, m, shape (n,).
    """

    time: Array
    step: float
    body: Array
    spool: Array
    displacement: Array


def steps(duration: float, sample_rate: float, before: float, longest: float) -> tuple[Array, float]:
    """Return the middles of the steps (s) from ``before`` s ahead of the record's start to its end, and h.

    Each sample instant is a border of two steps; none is longer than ``longest`` s.
    """
    per_sample = int(np.ceil(1.0 / sample_rate / longest))
    h = 1.0 / sample_rate / per_sample
    first = -round(before * sample_rate) * per_sample
    last = round((duration + AFTER) * sample_rate) * per_sample
    return np.asarray((np.arange(first, last) + 0.5) * h, dtype=np.float64), h


def move(plant: Plant, time: Array, h: float, body: Array) -> SpoolMotion:
    """Move ``plant`` from rest under ``body`` (m/s^2, in the middles ``time`` of steps of ``h`` s)."""
    spool, displacement = step_through(body, h, float(time[0] - 0.5 * h), plant.array())
    return SpoolMotion(time, h, body, spool, displacement)
