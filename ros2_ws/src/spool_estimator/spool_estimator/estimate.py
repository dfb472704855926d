"""What the estimator says."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from spool_stream.quantity import Quantity


class State(enum.IntEnum):
    """State of an estimate; the numbers are those of ``spool_msgs/msg/ModelEstimate``."""

    UNKNOWN = 0
    LEARNING = 1
    TRACKING = 2
    NOT_EXCITED = 3
    STALE = 4
    SETTLING = 5


@dataclass(frozen=True, slots=True)
class Estimate:
    """One valve's model at a time.

    ``stamp`` (ns) is the acquisition time of the newest sample used, ``delay`` (s) how long before it the
    described motion was, ``memory`` (s) the time constant of forgetting. ``last_sequence`` is that of the
    block in which the newest sample came; ``samples`` counts those used since the start.
    """

    stamp: int
    model: str
    state: State
    last_sequence: int
    samples: int
    delay: float
    memory: float
    parameters: tuple[Quantity, ...]
    natural_frequency: Quantity
    damping_ratio: Quantity
    residual: Quantity
    excitation: Quantity
    relative_displacement: Quantity
    lost_blocks: int = 0
    refused_blocks: int = 0

    def parameter(self, name: str) -> Quantity:
        """Return a parameter by its name.

        Raises:
            KeyError: the model has no such parameter.

        """
        for quantity in self.parameters:
            if quantity.name == name:
                return quantity
        raise KeyError(name)
