"""What a force term tells about itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from spool_stream.errors import InputError

from ..valve import Valve

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a force term.

    Attributes:
        name: as in YAML files, messages and reports.
        unit: SI.
        low, high: bounds, both allowed.
        start: where a fit or a simulation starts when neither valve nor user says otherwise.
        meaning: one line.
        valve_attribute: attribute of :class:`Valve` that gives the start value, if any.
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    meaning: str
    valve_attribute: str | None = None

    def start_for(self, valve: Valve) -> float:
        """Return the start value for ``valve``, in ``unit``."""
        return self.start if self.valve_attribute is None else float(getattr(valve, self.valve_attribute))

    def check(self, value: float, where: str = "parameter") -> float:
        """Return ``value`` if it lies within the bounds.

        Raises:
            InputError: not a number or out of range; name, value and range are named.
        """
        if not self.low <= value <= self.high:
            raise InputError(
                f"{where}: {self.name}: {value:g} {self.unit} is out of range, "
                f"use {self.low:g} to {self.high:g} {self.unit}"
            )
        return value


class Term(ABC):
    """A force in the balance of the spool; all terms of a model add up to zero.

    Attributes:
        name: as in model files and reports.
        parameters: what the force depends on beside the motion.
        law: the force as text.
        source: equation in the paper.
        meaning: what it stands for on the machine.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    law: ClassVar[str]
    source: ClassVar[str]
    meaning: ClassVar[str]

    @abstractmethod
    def force(
        self, displacement: Array, velocity: Array, acceleration: Array, values: Mapping[str, float]
    ) -> Array:
        """Return the force, N, shape (n,).

        Args:
            displacement: z, relative to the body, m, shape (n,).
            velocity: z', relative to the body, m/s, shape (n,).
            acceleration: of the spool itself, z'' + w'', m/s^2, shape (n,).
            values: parameter values by name, in their units.
        """
