"""Viscosity by temperature: ASTM D341 (Walther's law) through an oil's two catalogue points.

log10(log10(nu + 0.7)) = A - B log10(T), with nu in mm^2/s and T in K. The two catalogue points give A and B.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from spool_core.errors import InputError

CELSIUS_ZERO = 273.15
_OFFSET = 0.7

#: deg C over which catalogue points of hydraulic mineral oils may be extended.
LOWEST_TEMPERATURE, HIGHEST_TEMPERATURE = -40.0, 150.0
#: mm^2/s; below it ASTM D341 wants further terms.
LOWEST_VISCOSITY = 2.0

#: ISO 3448, table 1: the grade's number is the mid-point viscosity at 40 deg C, which may differ by 10 %.
#: That at 100 deg C is what ASTM D2270 gives for the viscosity index VISCOSITY_INDEX.
_GRADES = {10: 2.66, 15: 3.41, 22: 4.29, 32: 5.36, 46: 6.76, 68: 8.73, 100: 11.4}
#: Of the grades: solvent-refined mineral oils of the groups HL and HM (ISO 11158) have 95 to 105.
VISCOSITY_INDEX = 100
#: kg/m^3, density of mineral hydraulic oils, by which dynamic follows from kinematic viscosity: data sheets
#: say 840 to 890 at 15 deg C.
DENSITY = 870.0


@dataclass(frozen=True, slots=True)
class Oil:
    """Hydraulic oil by its catalogue points.

    Attributes:
        name: as in valve files.
        viscosity_40, viscosity_100: kinematic viscosity at 40 and 100 deg C, mm^2/s.
        source: where the points come from.
    """

    name: str
    viscosity_40: float
    viscosity_100: float
    source: str

    def kinematic_viscosity(self, temperature: float) -> float:
        """Return the kinematic viscosity, mm^2/s, at ``temperature`` (deg C).

        Raises:
            InputError: the temperature, or the viscosity there, is outside of what the law holds for.
        """
        if not LOWEST_TEMPERATURE <= temperature <= HIGHEST_TEMPERATURE:
            raise InputError(
                f"oil temperature: {temperature:g} deg C is out of range for {self.name}, "
                f"use {LOWEST_TEMPERATURE:g} to {HIGHEST_TEMPERATURE:g} deg C"
            )
        viscosity: float = 10.0 ** (10.0 ** self._double_logarithm(temperature)) - _OFFSET
        if viscosity < LOWEST_VISCOSITY:
            raise InputError(
                f"oil temperature: at {temperature:g} deg C {self.name} has {viscosity:.2g} mm^2/s, "
                f"less than the {LOWEST_VISCOSITY:g} mm^2/s down to which ASTM D341 holds; use a lower one"
            )
        return viscosity

    def _double_logarithm(self, temperature: float) -> float:
        at_40, at_100 = _double_logarithm(self.viscosity_40), _double_logarithm(self.viscosity_100)
        low, high = math.log10(40.0 + CELSIUS_ZERO), math.log10(100.0 + CELSIUS_ZERO)
        share = (math.log10(temperature + CELSIUS_ZERO) - low) / (high - low)
        return at_40 * (1.0 - share) + at_100 * share


def _double_logarithm(viscosity: float) -> float:
    return math.log10(math.log10(viscosity + _OFFSET))


OILS: dict[str, Oil] = {
    oil.name: oil
    for oil in (
        Oil("HL68", 68.0, 8.7, "ISO VG 68 mineral oil, grade HL of DIN 51524-1: typical data sheet"),
        Oil("Azolla ZS22", 22.0, 4.3, "ISO VG 22 mineral oil, grade HM: maker's data sheet"),
        *(
            Oil(f"ISO VG {grade}", float(grade), at_100, f"ISO 3448 with viscosity index {VISCOSITY_INDEX}")
            for grade, at_100 in _GRADES.items()
        ),
    )
}
