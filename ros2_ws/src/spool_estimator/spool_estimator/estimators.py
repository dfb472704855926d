"""Estimators: what every one does, and all there are."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from spool_stream.block import Block
from spool_stream.block_gate import BlockGate
from spool_stream.errors import InputError

from .equation_estimator import EquationEstimator
from .estimate import Estimate
from .estimator import Estimator, EstimatorSettings


class StreamEstimator(Protocol):
    """Blocks in, estimates out, no clock; picklable, bounded, the same for any split into blocks to 0.5 s."""

    settings: EstimatorSettings
    gate: BlockGate
    latest: Estimate | None

    @property
    def lacking(self) -> int:
        """Samples until the next estimate falls due; 0 before the first block."""

    def update(self, block: Block) -> list[Estimate]:
        """Take one block; return the estimates that fell due within it."""

    def update_temperature(self, stamp: int, celsius: float, deviation: float = math.nan) -> None:
        """Take the oil's temperature at ``stamp`` (ns), deg C, its standard deviation (NaN: unknown)."""

    def stale(self) -> Estimate | None:
        """Return the last estimate as one that is held; ``None`` before the first."""


#: By name: the model run in parallel with the machine; equation error with exponential forgetting.
ESTIMATORS: dict[str, Callable[[EstimatorSettings], StreamEstimator]] = {
    "prediction": Estimator,
    "equation": EquationEstimator,
}


def make_estimator(name: str, settings: EstimatorSettings) -> StreamEstimator:
    """Return a fresh estimator by its name.

    Raises:
        InputError: there is none of that name.
    """
    if name not in ESTIMATORS:
        raise InputError(f"estimator {name}: there is no such method; there are {', '.join(ESTIMATORS)}")
    return ESTIMATORS[name](settings)
