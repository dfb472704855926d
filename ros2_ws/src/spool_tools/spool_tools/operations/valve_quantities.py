"""Quantities that follow from a valve file by the paper's equations."""

from __future__ import annotations

import math
from collections.abc import Iterator

from spool_sim.sensors import PAPER_CHAIN
from spool_sim.valve.description import FILM, Valve
from spool_sim.valve.lubrication import fluid_friction_coefficient

#: m/s, a spool at 60 Hz with a stroke of 9 mm exceeds it on average: the paper's conclusions.
SPEED = 0.5
#: m/s^2, standard gravity (ISO 80000-3).
GRAVITY = 9.80665


def quantities(valve: Valve) -> Iterator[str]:
    """Yield a line for each quantity of ``valve``: name, value, unit and meaning."""
    yield f"valve {valve.id}"
    yield f"undamped natural frequency: {valve.natural_frequency:.4g} Hz"
    lacking = [name for name in (*FILM, "oil_temperature") if not valve.knows(name)]
    if lacking:
        yield f"not given: {', '.join(lacking)}: fits need none of them, a simulation and the drag do"
        return
    yield f"damping ratio: {valve.damping_ratio:.3g}, of the oil alone"
    yield f"viscous coefficient: {valve.viscous_coefficient:.4g} N s/m at {valve.oil_temperature:g} deg C"
    if valve.knows("spool_mass"):
        yield (
            f"fluid friction coefficient, equation (6): {friction_coefficient(valve):.3g} at {SPEED:g} m/s "
            "under the spool's weight: Newton's drag over the normal load"
        )
    yield (
        f"lambda: gap height over combined rms roughness; {valve.radial_clearance / 3.0 * 1e6:.3g} um of "
        f"roughness is the limit of fluid friction (3), {valve.radial_clearance * 1e6:.3g} um that of mixed "
        "friction (1)"
    )
    yield (
        "largest error of a measured acceleration, equation (31): "
        f"{100.0 * PAPER_CHAIN.relative_uncertainty:.3g} % of the reading with the paper's measuring chain"
    )


def friction_coefficient(valve: Valve) -> float:
    """Return the fluid friction coefficient of ``valve`` at SPEED under its spool's weight, equation (6)."""
    return fluid_friction_coefficient(
        dynamic_viscosity=valve.dynamic_viscosity,
        speed=SPEED,
        area=math.pi * valve.land_diameter * valve.land_length,
        normal_load=valve.spool_mass * GRAVITY,
        film_thickness=valve.radial_clearance,
    )
