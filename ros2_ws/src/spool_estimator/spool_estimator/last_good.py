"""Last good estimates, and what was known with each, to go back to where the data turn out to be bad."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from spool_core.rate_check import REFUTE
from spool_core.uncertainty import Quantity

from .estimate import Estimate, State

Known = TypeVar("Known")

#: Estimates that are kept: those of the time in which a wrong sample rate is found, and one before.
KEPT = 5
#: s before a wrong sample rate was found in which it may have set in.
LATE = REFUTE + 0.5


@dataclass(slots=True)
class LastGood(Generic[Known]):
    """Last good estimates: the newest that track, each with what its estimator knew then."""

    _kept: deque[tuple[Estimate, Known]] = field(default_factory=lambda: deque(maxlen=KEPT))

    @property
    def any(self) -> bool:
        """Whether there is a good estimate."""
        return bool(self._kept)

    def keep(self, estimate: Estimate, knowledge: Known) -> None:
        """Keep an estimate that tracks."""
        self._kept.append((estimate, knowledge))

    def back(self, stamp: int) -> Known | None:
        """Forget what is newer than ``stamp`` (ns); return what was known with the newest that is not."""
        while self._kept and self._kept[-1][0].stamp > stamp:
            self._kept.pop()
        return self._kept[-1][1] if self._kept else None

    def held(self, now: Estimate, state: State) -> Estimate:
        """Return the last good estimate as one that is held at ``now``; with none, that nothing is known."""
        if not self._kept:
            return replace(
                now,
                state=State.LEARNING if state is State.SETTLING else state,
                parameters=tuple(_nothing(one) for one in now.parameters),
                natural_frequency=_nothing(now.natural_frequency),
                damping_ratio=_nothing(now.damping_ratio),
                residual=_nothing(now.residual),
                excitation=_nothing(now.excitation),
                relative_displacement=_nothing(now.relative_displacement),
                referred_viscous_coefficient=_nothing(now.referred_viscous_coefficient),
            )
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


def _nothing(quantity: Quantity) -> Quantity:
    return Quantity(quantity.name, quantity.unit)
