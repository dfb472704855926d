"""Plausibility of a valve's numbers by physics alone: what no valve has, and the unit that explains it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

#: kg/m^3, density of steel (EN 10088-1 gives 7700 to 8000 for stainless steels, plain steels lie in between).
STEEL = 7850.0
#: m/s^2, standard gravity (ISO 80000-3).
GRAVITY = 9.80665
#: Diameters: spools are some 4 to 10 long; four times the longest, of solid steel, is the heaviest believed.
LONGEST = 40.0
#: Share of a solid steel land that the lightest spool weighs: aluminium is a third of steel, a tube with thin
#: walls some tenth of that, and a third of it is left as a margin.
LIGHTEST = 0.01
#: Pa s: some 30 times ISO VG 680 at 40 deg C, one of the thickest grades of ISO 3448.
THICKEST = 20.0
#: m, sag under the spool's weight where no land is known: springs of 1.6 Hz, softer than any that centre a
#: spool (the softest of the paper's table 2 have 15 Hz, 1 mm).
LARGEST_SAG = 0.1

#: Units that people write instead, by key: name, value of one in SI.
_SLIPS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "moving_mass": (("g", 1e-3),),
    "spool_mass": (("g", 1e-3),),
    "spring_stiffness": (("N/mm", 1e3),),
    "land_diameter": (("mm", 1e-3),),
    "land_length": (("mm", 1e-3),),
    "radial_clearance": (("um", 1e-6), ("mm", 1e-3)),
    "dynamic_viscosity": (("mPa s", 1e-3),),
}


def implausible(given: Mapping[str, float]) -> list[str]:
    """Return a sentence for each number that no spool valve has; empty where all can be.

    Bounds follow from the valve's own geometry, so that they hold for every size: the mass of a steel
    cylinder of the land's diameter, and the sag under the spool's own weight.

    Args:
        given: numbers of a description that lie within their bounds, by key; what is left out is not judged.
    """
    said = _masses(given)
    mass, stiffness = given["moving_mass"], given["spring_stiffness"]
    sag = mass * GRAVITY / stiffness
    if sag > given.get("land_length", LARGEST_SAG) and not said:
        said.append(
            f"spring_stiffness: {stiffness:g} N/m would give way by {sag:.2g} m under the "
            f"spool's own weight; did you write N/mm? the file takes N/m: {1e3 * stiffness:g}"
            + ("" if "land_diameter" in given else f"; or moving_mass in g? it takes kg: {mass / 1e3:g}")
        )
    viscosity = given.get("dynamic_viscosity", 0.0)
    if viscosity > THICKEST:
        said.append(
            f"dynamic_viscosity: {viscosity:g} Pa s is no hydraulic oil; did you write mPa s? "
            f"the file takes Pa s: {viscosity / 1e3:g}"
        )
    return said


def _masses(given: Mapping[str, float]) -> list[str]:
    """Judge the masses by the land; where that is not known they are judged with the spring alone."""
    if "land_diameter" not in given:
        return []
    diameter = given["land_diameter"]
    area = 0.25 * math.pi * diameter**2
    heaviest = STEEL * area * LONGEST * diameter
    lightest = LIGHTEST * STEEL * area * given.get("land_length", 0.0)
    said = []
    for key in ("moving_mass", "spool_mass"):
        mass = given.get(key)
        if mass is None:
            continue
        if mass > heaviest:
            said.append(
                f"{key}: {mass:g} kg is no spool of {1e3 * diameter:g} mm diameter (solid steel, "
                f"{LONGEST:g} diameters long: {heaviest:.3g} kg); did you write g? the file takes kg: "
                f"{mass / 1e3:g}"
            )
        elif mass < lightest:
            said.append(
                f"{key}: {mass:g} kg is less than {100.0 * LIGHTEST:g} % of its land in steel "
                f"({lightest:.2g} kg); the file takes kg"
            )
    return said


def unit_guesses(mapping: Mapping[str, Any], refused: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return a guess for each refused number that another unit would explain.

    Args:
        mapping: keys and values as the file has them.
        refused: lowest and highest value allowed, by the key of each number that lies outside.
    """
    said = []
    for key, (lowest, highest) in refused.items():
        try:
            value = float(mapping[key])
        except (KeyError, TypeError, ValueError):
            continue
        for unit, factor in _SLIPS.get(key, ()):
            if lowest <= value * factor <= highest:
                said.append(f"{key}: did you write {unit}? that would be {value * factor:g}")
                break
    return said
