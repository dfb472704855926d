"""Viscosity table of a valve's oil over temperature, quick enough for every sample."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError

from .description import Valve
from .viscosity import HIGHEST_TEMPERATURE, LOWEST_TEMPERATURE

#: deg C between the points. Interpolated linearly, the ratio is up to 1.4e-5 too large above 0 deg C, 6e-5 at
#: -40 deg C.
STEP = 0.1


@dataclass(slots=True)
class OilTable:
    """Viscosity table: ratio to the viscosity at the valve's reference temperature, made at its first use."""

    valve: Valve
    _temperatures: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False)
    _ratios: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False)

    def ratio(self, temperature: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the ratio at ``temperature`` (deg C, any shape), at the law's ends that of the end.

        Raises:
            InputError: the valve names no oil.
        """
        if self._temperatures.size == 0:
            self._fill()
        return np.interp(temperature, self._temperatures, self._ratios)

    def _fill(self) -> None:
        count = round((HIGHEST_TEMPERATURE - LOWEST_TEMPERATURE) / STEP) + 1
        points = []
        self.valve.dynamic_viscosity_at(self.valve.oil_temperature)
        for temperature in np.linspace(LOWEST_TEMPERATURE, HIGHEST_TEMPERATURE, count).tolist():
            try:
                viscosity = self.valve.dynamic_viscosity_at(temperature)
            except InputError:  # warmer than the law holds for
                break
            points.append((temperature, viscosity / self.valve.dynamic_viscosity))
        self._temperatures, self._ratios = np.array(points).T
