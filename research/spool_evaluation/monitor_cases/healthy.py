"""Healthy valves on a machine, drawn from a seed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from spool_sim.valve.description import Valve

from .scenario import PlannedChange, Scenario, StoppingMachine

Generator = np.random.Generator
Profile = tuple[tuple[float, float], ...]

#: Stiffness, N/m, of the two springs, viscosity, Pa s at 40 deg C, and name of the two oils.
SPRINGS, OILS = (1632.0, 5846.0), ((0.0612, "HL68"), (0.0198, "Azolla ZS22"))

#: Shaft frequency over natural frequency of machines that run below and above resonance; the second order of
#: the slower ones lies above it.
BELOW, ABOVE = (0.65, 0.8), (1.45, 2.2)


def draw_valve(draw: Generator, *, spring: int | None = None, oil: int | None = None) -> Valve:
    """Return one of the springs, or (every third) any between them, with one of the oils."""
    stiffness = SPRINGS[draw.integers(2) if spring is None else spring] * draw.uniform(0.97, 1.03)
    between = float(np.exp(draw.uniform(math.log(SPRINGS[0]), math.log(SPRINGS[1]))))
    if draw.random() < 1.0 / 3.0 and spring is None:
        stiffness = between
    viscosity, name = OILS[draw.integers(2) if oil is None else oil]
    return Valve(
        id="valve_1", moving_mass=0.18, spool_mass=0.172, spring_stiffness=stiffness,
        land_diameter=0.02, land_length=0.032, radial_clearance=15e-6,
        dynamic_viscosity=viscosity, oil_temperature=40.0, oil=name,
    )  # fmt: skip


def draw_machine(
    draw: Generator, valve: Valve, profile: Profile = (), rests: Profile = (), *, below: bool | None = None
) -> StoppingMachine:
    """Return a machine at a speed away from resonance, or one that runs through ``profile`` (s, Hz)."""
    below = bool(draw.random() < 0.5) if below is None else below
    profile = profile or ((0.0, away(draw, valve, below=below)),)
    first = draw.uniform(2.5, 10.0)
    orders: Profile = ((1.0, first), (2.0, draw.uniform(0.2, 0.5) * first))
    if below:
        orders = (*orders, (4.0, 0.2 * first))
    return StoppingMachine(
        speed_profile=tuple((time, 60.0 * frequency) for time, frequency in profile),
        orders=orders,
        broadband_rms=draw.uniform(0.08, 0.3) * first,
        broadband_low=6.0,
        broadband_high=120.0,
        broadband_lines=40,
        seed=int(draw.integers(2**31)),
        rests=rests,
    )


def away(draw: Generator, valve: Valve, *, below: bool) -> float:
    """Return a shaft frequency, Hz, away from the natural one."""
    return float(valve.natural_frequency * draw.uniform(*(BELOW if below else ABOVE)))


def draw_speeds(draw: Generator, valve: Valve, seconds: float, *, below: bool) -> Profile:
    """Return a profile (s, Hz) of steps and ramps away from resonance."""
    points, time = [(0.0, away(draw, valve, below=below))], 0.0
    while time < seconds:
        hold, ramp = draw.uniform(8.0, 40.0), draw.uniform(0.5, 8.0)
        points += [(time + hold, points[-1][1]), (time + hold + ramp, away(draw, valve, below=below))]
        time += hold + ramp
    return tuple(points)


def draw_case(draw: Generator, kind: str, seconds: float = 180.0, valve: Valve | None = None) -> Scenario:
    """Return a case to which nothing happens; its machine overcomes its dry friction."""
    valve = valve or draw_valve(draw)
    machine = draw_machine(draw, valve)
    force = valve.moving_mass * machine.orders[0][1]
    return Scenario(
        kind=kind,
        seed=int(draw.integers(2**31)),
        seconds=seconds,
        sample_rate=float(draw.choice([800.0, 1000.0, 1250.0, 2000.0])),
        drawn_valve=valve,
        coulomb_force=float(min(0.25, draw.uniform(0.05, 0.3) * force)),
        noise=float(draw.uniform(0.02, 0.1)),
        gain_error=float(draw.uniform(-0.02, 0.02)),
        machine=machine,
    )


def with_speeds(draw: Generator, case: Scenario) -> Scenario:
    """Let the machine change its speed again and again, away from resonance."""
    valve = case.drawn_valve
    below = case.machine.speed_profile[0][1] < 60.0 * valve.natural_frequency
    profile = draw_speeds(draw, valve, case.seconds, below=below)
    speeds = tuple((time, 60.0 * frequency) for time, frequency in profile)
    return replace(case, machine=case.machine.model_copy(update={"speed_profile": speeds}))


def with_standstills(draw: Generator, case: Scenario) -> Scenario:
    """Let the machine stand still twice."""
    first, second = draw.uniform(45.0, 60.0), draw.uniform(120.0, 130.0)
    rests = ((first, first + draw.uniform(8.0, 15.0)), (second, second + draw.uniform(5.0, 15.0)))
    return replace(case, machine=case.machine.model_copy(update={"rests": rests}))


def with_warming(draw: Generator, case: Scenario) -> Scenario:
    """Let the oil warm by 10 to 25 K."""
    warms = PlannedChange("oil_temperature", float(draw.uniform(50.0, 65.0)), 10.0, case.seconds - 20.0)
    return replace(case, changes=(*case.changes, warms))


def healthy_hour(draw: Generator) -> Scenario:
    """An hour with warming and cooling oil, changes of speed and standstills."""
    case = with_speeds(draw, draw_case(draw, "healthy hour", seconds=3600.0))
    rests = tuple(
        (600.0 * number + start, 600.0 * number + start + draw.uniform(10.0, 120.0))
        for number, start in enumerate(draw.uniform(100.0, 400.0, 6))
    )
    warm = float(draw.uniform(45.0, 65.0))
    begins, lasts = float(draw.uniform(30.0, 300.0)), float(draw.uniform(600.0, 1500.0))
    cools, cooling = float(draw.uniform(35.0, warm)), float(draw.uniform(300.0, 1200.0))
    changes = (
        PlannedChange("oil_temperature", warm, begins, lasts),
        PlannedChange("oil_temperature", cools, 2200.0, cooling),
    )
    # Fewer lines of the broadband: an hour has to be simulated in seconds.
    update = {"broadband_lines": 16, "broadband_high": 75.0, "rests": rests}
    return replace(case, machine=case.machine.model_copy(update=update), changes=changes, sample_rate=1000.0)
