"""Lubrication of the land: oils by name, and the film's coefficient of friction."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError

from spool_sim.valve import HIGHEST_TEMPERATURE, LOWEST_TEMPERATURE, Valve

#: deg C between the points. Interpolated linearly, the ratio is up to 1.4e-5 too large above 0 deg C, 6e-5 at
#: -40 deg C.
STEP = 0.1


def fluid_friction_coefficient(
    *, dynamic_viscosity: float, speed: float, area: float, normal_load: float, film_thickness: float
) -> float:
    """Return the fluid friction coefficient eta = mu v A / (F_N h), equation (6); no unit.

    It is what Coulomb's coefficient would have to be for Newton's drag.

    Args:
        dynamic_viscosity: mu, Pa s.
        speed: v, m/s.
        area: A, m^2.
        normal_load: F_N, N, > 0.
        film_thickness: h, m, > 0.

    Raises:
        ValueError: load or film thickness not > 0.
    """
    if not (normal_load > 0.0 and film_thickness > 0.0):
        raise ValueError(f"normal_load {normal_load:g} N and film_thickness {film_thickness:g} m must be > 0")
    return dynamic_viscosity * speed * area / (normal_load * film_thickness)


@dataclass(slots=True)
class OilTable:
    """Ratio to the viscosity at the valve's reference temperature, made at its first use."""

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
