"""`./spool valve check`: what follows from a valve file by the paper's equations, and what looks wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from spool_sim.valve.description import Valve

app = typer.Typer(
    no_args_is_help=True,
    help="Look at valve files.\n\nExample: ./spool valve check 4weh10_soft",
)

#: m/s, a spool at 60 Hz with a stroke of 9 mm exceeds it on average: the paper's conclusions.
SPEED = 0.5
#: m/s^2, standard gravity (ISO 80000-3).
GRAVITY = 9.80665


@app.callback()
def group() -> None:
    """Look at valve files."""


@app.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE", help="YAML file, or a shipped valve's name.")],
) -> None:
    """Show what follows from a valve file; exit 1 where a number looks wrong.

    Example: ./spool valve check 4weh10_soft
    """
    from spool_sim.valve.description import find_valve  # noqa: PLC0415
    from spool_sim.valve.plausibility import implausible  # noqa: PLC0415 - numba is needed here only

    valve = find_valve(file)
    for line in quantities(file):
        print(line)
    wrong = implausible(valve)
    for said in wrong:
        print(f"looks wrong: {said}")
    raise typer.Exit(1 if wrong else 0)


def quantities(file: str) -> Iterator[str]:
    """Yield a line for each quantity of the valve ``file``: name, value, unit and meaning.

    Raises:
        InputError: no such valve, or a file that describes none.
    """
    from spool_sim.sensors import PAPER_CHAIN  # noqa: PLC0415
    from spool_sim.valve.description import find_valve  # noqa: PLC0415

    valve = find_valve(file)
    yield f"valve {valve.id}"
    yield f"undamped natural frequency: {valve.natural_frequency:.4g} Hz"
    yield f"damping ratio: {valve.damping_ratio:.3g}, of the oil alone"
    yield f"viscous coefficient: {valve.viscous_coefficient:.4g} N s/m at {valve.oil_temperature:g} deg C"
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
    from spool_sim.valve.lubrication import fluid_friction_coefficient  # noqa: PLC0415

    return fluid_friction_coefficient(
        dynamic_viscosity=valve.dynamic_viscosity,
        speed=SPEED,
        area=math.pi * valve.land_diameter * valve.land_length,
        normal_load=valve.spool_mass * GRAVITY,
        film_thickness=valve.radial_clearance,
    )
