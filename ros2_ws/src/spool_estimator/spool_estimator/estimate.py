"""Estimate: what an estimator says."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from typing import Any

from spool_core.uncertainty import Quantity, Validity


class State(enum.IntEnum):
    """Whether an estimate follows its valve; the numbers are those of ``spool_msgs/msg/ModelEstimate``."""

    UNKNOWN = 0
    LEARNING = 1
    TRACKING = 2
    NOT_EXCITED = 3
    STALE = 4
    SETTLING = 5


#: Quantities of an estimate besides the model's parameters, and those that are held while no data arrive.
QUANTITIES = (
    "referred_viscous_coefficient", "oil_temperature", "natural_frequency", "damping_ratio", "residual",
    "excitation", "relative_displacement",
)  # fmt: skip
_HELD = ("natural_frequency", "damping_ratio", "referred_viscous_coefficient")

_NOT_REFERRED = Quantity("referred_viscous_coefficient", "N s/m")
_NOT_MEASURED = Quantity("oil_temperature", "deg C")
_NOT_LEFT = Quantity("residual_force", "N")


@dataclass(frozen=True, slots=True)
class Estimate:
    """One valve's model as identified up to a time.

    ``stamp`` (ns) is the acquisition time of the newest sample used, ``delay`` (s) how long before it the
    described motion was, ``memory`` (s) the time constant of forgetting. ``last_sequence`` is that of the
    block in which the newest sample came; ``samples`` counts those used since the start.
    ``referred_viscous_coefficient`` is the viscous one at the reference temperature of the valve's data.
    ``residual_force`` is what the model leaves, rms; ``residual`` is its share of the spool's inertia force.
    No message has the former. ``source`` is the valve's id, the ``frame_id`` of the message.
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
    referred_viscous_coefficient: Quantity = _NOT_REFERRED
    oil_temperature: Quantity = _NOT_MEASURED
    residual_force: Quantity = _NOT_LEFT
    source: str = ""

    def parameter(self, name: str) -> Quantity:
        """Return a parameter by its name.

        Raises:
            KeyError: the model has no such parameter.

        """
        for quantity in self.parameters:
            if quantity.name == name:
                return quantity
        raise KeyError(name)

    def held(self) -> Estimate:
        """Return this as stale: what was valid is held, what the signals showed is unknown."""
        held = tuple(_held(quantity) for quantity in self.parameters)
        others: dict[str, Any] = {
            name: (_held if name in _HELD else unknown)(getattr(self, name)) for name in QUANTITIES
        }
        return replace(self, state=State.STALE, parameters=held, residual_force=_NOT_LEFT, **others)


def _held(quantity: Quantity) -> Quantity:
    return replace(quantity, validity=Validity.HELD) if quantity.known else quantity


def unknown(quantity: Quantity) -> Quantity:
    """Return ``quantity`` as one that is not known."""
    return Quantity(quantity.name, quantity.unit)
