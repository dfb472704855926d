"""Scenarios drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from spool_sim.valve import Valve

from .case import Case, Change, ChannelFault, Expected, StoppingMachine

Generator = np.random.Generator

#: s, from which on something may happen, and s within which it must be found once it is large enough.
HAPPENS, FOUND = 70.0, 30.0

#: Stiffness, N/m, of the two springs, viscosity, Pa s at 40 deg C, and name of the two oils.
SPRINGS, OILS = (1632.0, 5846.0), ((0.0612, "HL68"), (0.0198, "Azolla ZS22"))


def _valve(draw: Generator, *, spring: int | None = None, oil: int | None = None) -> Valve:
    stiffness = SPRINGS[draw.integers(2) if spring is None else spring]
    viscosity, name = OILS[draw.integers(2) if oil is None else oil]
    return Valve(
        id="valve_1", moving_mass=0.18, spool_mass=0.172,
        spring_stiffness=stiffness * draw.uniform(0.97, 1.03),
        land_diameter=0.02, land_length=0.032, radial_clearance=15e-6,
        dynamic_viscosity=viscosity, oil_temperature=40.0, oil=name,
    )  # fmt: skip


def _machine(
    draw: Generator,
    valve: Valve,
    profile: tuple[tuple[float, float], ...] = (),
    rests: tuple[tuple[float, float], ...] = (),
) -> StoppingMachine:
    """Return a machine at a speed away from resonance, or one that runs through ``profile`` (s, Hz)."""
    profile = profile or ((0.0, _away(draw, valve)),)
    first = draw.uniform(4.0, 10.0)
    return StoppingMachine(
        speed_profile=tuple((time, 60.0 * frequency) for time, frequency in profile),
        orders=((1.0, first), (2.0, 0.25 * first)),
        broadband_rms=draw.uniform(0.8, 2.0),
        broadband_low=6.0,
        broadband_high=120.0,
        broadband_lines=40,
        seed=int(draw.integers(2**31)),
        rests=rests,
    )


def _away(draw: Generator, valve: Valve) -> float:
    """Return a shaft frequency, Hz, well above the natural one."""
    return float(valve.natural_frequency * draw.uniform(1.45, 2.2))


def _healthy(draw: Generator, kind: str, valve: Valve | None = None, seconds: float = 180.0) -> Case:
    valve = valve or _valve(draw)
    return Case(
        kind=kind,
        seed=int(draw.integers(2**31)),
        seconds=seconds,
        sample_rate=float(draw.choice([1000.0, 1250.0, 2000.0])),
        drawn_valve=valve,
        coulomb_force=float(draw.uniform(0.05, 0.25)),
        noise=float(draw.uniform(0.02, 0.1)),
        gain_error=float(draw.uniform(-0.02, 0.02)),
        machine=_machine(draw, valve),
    )


def _warms(draw: Generator, case: Case) -> Change:
    target = float(draw.uniform(50.0, 65.0))
    return Change("oil_temperature", target, 10.0, case.seconds - 20.0)


def healthy(draw: Generator) -> Case:
    """Nothing happens."""
    return _healthy(draw, "healthy")


def healthy_warming(draw: Generator) -> Case:
    """The oil warms by 10 to 25 K."""
    case = _healthy(draw, "healthy, oil warms")
    return replace(case, changes=(_warms(draw, case),))


def healthy_speed(draw: Generator) -> Case:
    """The machine changes its speed again and again, away from resonance."""
    case = _healthy(draw, "healthy, speed changes")
    return replace(case, machine=_machine(draw, case.drawn_valve, speeds(draw, case.drawn_valve, 180.0)))


def healthy_standstill(draw: Generator) -> Case:
    """The machine stands still twice."""
    case = _healthy(draw, "healthy, standstills")
    first = draw.uniform(50.0, 80.0)
    rests = (
        (first, first + draw.uniform(10.0, 20.0)),
        (first + 45.0, first + 45.0 + draw.uniform(5.0, 15.0)),
    )
    return replace(case, machine=_machine(draw, case.drawn_valve, rests=rests))


def speeds(draw: Generator, valve: Valve, seconds: float) -> tuple[tuple[float, float], ...]:
    """Return a profile (s, Hz) of steps and ramps away from resonance."""
    points, time, frequency = [(0.0, _away(draw, valve))], 0.0, 0.0
    while time < seconds:
        frequency = _away(draw, valve)
        hold, ramp = draw.uniform(8.0, 40.0), draw.uniform(0.5, 8.0)
        points += [(time + hold, points[-1][1]), (time + hold + ramp, frequency)]
        time += hold + ramp
    return tuple(points)


def healthy_hour(draw: Generator) -> Case:
    """An hour with warming and cooling oil, changes of speed and standstills."""
    case = _healthy(draw, "healthy hour", seconds=3600.0)
    valve = case.drawn_valve
    rests = tuple(
        (600.0 * number + start, 600.0 * number + start + draw.uniform(10.0, 120.0))
        for number, start in enumerate(draw.uniform(100.0, 400.0, 6))
    )
    warm = float(draw.uniform(45.0, 65.0))
    changes = (
        Change("oil_temperature", warm, float(draw.uniform(30.0, 300.0)), float(draw.uniform(600.0, 1500.0))),
        Change(
            "oil_temperature", float(draw.uniform(35.0, warm)), 2200.0, float(draw.uniform(300.0, 1200.0))
        ),
    )
    machine = _machine(draw, valve, speeds(draw, valve, 3600.0), rests)
    # Fewer lines of the broadband: an hour has to be simulated in seconds.
    machine = machine.model_copy(update={"broadband_lines": 16, "broadband_high": 75.0})
    return replace(case, machine=machine, changes=changes, sample_rate=1000.0)


def _drift(
    draw: Generator,
    case: Case,
    quantity: str,
    healthy: float,
    target: float,
    needed: float,
    expected: tuple[str, tuple[str, ...]],
    *,
    step: bool = False,
) -> Case:
    """Let ``quantity`` run from ``healthy`` to ``target``; a change of ``needed`` must be found."""
    at = float(draw.uniform(HAPPENS, 90.0))
    duration = 0.0 if step else float(draw.uniform(20.0, 50.0))
    reached = at + duration * needed / abs(target - healthy)
    event = Expected(expected[0], expected[1], at, reached, reached + FOUND)
    return replace(case, changes=(*case.changes, Change(quantity, target, at, duration)), expected=(event,))


def _wear(draw: Generator, kind: str, *, step: bool, warms: bool = False) -> Case:
    case = _healthy(draw, kind)
    if warms:
        case = replace(case, changes=(_warms(draw, case),))
    drag = case.drawn_valve.viscous_coefficient
    left = drag * draw.uniform(0.4, 0.7)
    cause = ("friction_drift", ("wear",))
    return _drift(draw, case, "viscous_coefficient", drag, left, 0.2 * drag, cause, step=step)


def wear_ramp(draw: Generator) -> Case:
    """The clearance grows: less drag at the same temperature, little by little."""
    return _wear(draw, "wear, ramp", step=False)


def wear_step(draw: Generator) -> Case:
    """The clearance grows at once."""
    return _wear(draw, "wear, step", step=True)


def wear_warming(draw: Generator) -> Case:
    """The clearance grows while the oil warms."""
    return _wear(draw, "wear, oil warms", step=False, warms=True)


def contamination(draw: Generator, *, warms: bool = False) -> Case:
    """Dry friction rises."""
    case = _healthy(draw, "contamination, oil warms" if warms else "contamination")
    if warms:
        case = replace(case, changes=(_warms(draw, case),))
    start = case.coulomb_force
    target = start + draw.uniform(0.15, 0.4)
    cause = ("friction_drift", ("oil_contamination",))
    return _drift(draw, case, "coulomb_force", start, target, 0.1, cause)


def contamination_warming(draw: Generator) -> Case:
    """Dry friction rises while the oil warms."""
    return contamination(draw, warms=True)


def other_oil(draw: Generator) -> Case:
    """The drag rises at the same temperature: oil that is too thick."""
    case = _healthy(draw, "oil viscosity, unexplained")
    drag = case.drawn_valve.viscous_coefficient
    cause = ("friction_drift", ("oil_viscosity",))
    target = drag * draw.uniform(1.35, 1.9)
    return _drift(draw, case, "viscous_coefficient", drag, target, 0.2 * drag, cause)


def spring_fatigue(draw: Generator) -> Case:
    """A spring loses stiffness."""
    case = _healthy(draw, "spring change")
    stiffness = case.drawn_valve.spring_stiffness
    target = stiffness * draw.uniform(0.6, 0.85)
    event = ("spring_change", ("softer",))
    case = _drift(draw, case, "spring_stiffness", stiffness, target, 0.1 * stiffness, event)
    return replace(case, follows=("resonance",))


def _resonance(draw: Generator, spring: int) -> Case:
    valve = _valve(draw, spring=spring, oil=1)
    case = _healthy(draw, f"resonance near {round(valve.natural_frequency)} Hz", valve)
    case = replace(case, kind=f"resonance near {(15, 29)[spring]} Hz")
    natural, at = valve.natural_frequency, float(draw.uniform(HAPPENS, 100.0))
    start = natural * draw.uniform(1.6, 2.0)
    ramp, stay = draw.uniform(5.0, 15.0), draw.uniform(5.0, 20.0)
    meets = natural * draw.uniform(0.97, 1.03)
    profile = (
        (0.0, start), (at, start), (at + ramp, meets), (at + ramp + stay, meets),
        (at + 2 * ramp + stay, start),
    )  # fmt: skip
    # Within 8 % of the natural frequency a lightly damped spool resonates beyond doubt.
    reached = at + ramp * (start - 1.08 * natural) / (start - meets)
    near = at + ramp * (start - 1.3 * natural) / (start - meets)
    event = Expected("resonance", (), near, reached, reached + 3.0)
    return replace(case, machine=_machine(draw, valve, profile), expected=(event,))


def resonance_15(draw: Generator) -> Case:
    """The machine passes the soft spring's natural frequency."""
    return _resonance(draw, 0)


def resonance_29(draw: Generator) -> Case:
    """The machine passes the stiff spring's natural frequency."""
    return _resonance(draw, 1)


def _fault(draw: Generator, kind: str, fault: ChannelFault, event: str, within: float) -> Case:
    case = _healthy(draw, kind)
    expected = Expected(
        event, () if event == "stuck_spool" else (fault.kind,), fault.at, fault.at, fault.at + within
    )
    return replace(case, faults=(fault,), expected=(expected,))


def _when(draw: Generator) -> float:
    return float(round(draw.uniform(HAPPENS, 120.0), 2))


def _channel(draw: Generator) -> str:
    return "body" if draw.random() < 0.5 else "spool"


def stuck(draw: Generator) -> Case:
    """The spool sticks in its bore."""
    return _fault(draw, "stuck spool", ChannelFault("stuck", "spool", _when(draw)), "stuck_spool", 15.0)


def dead(draw: Generator) -> Case:
    """A channel shows noise only."""
    left = float(draw.choice([0.0, 0.02]))
    fault = ChannelFault("dead", _channel(draw), _when(draw), left)  # type: ignore[arg-type]
    return _fault(draw, "sensor dead", fault, "sensor_fault", 10.0)


def clipping(draw: Generator) -> Case:
    """A channel is cut off at a share of its rms (the value, until the levels are known)."""
    fault = ChannelFault("clipping", _channel(draw), _when(draw), float(draw.uniform(0.6, 1.0)))  # type: ignore[arg-type]
    return _fault(draw, "sensor clipping", fault, "sensor_fault", 15.0)


def offset(draw: Generator) -> Case:
    """The mean of a channel moves."""
    size = float(draw.choice([-1.0, 1.0]) * draw.uniform(1.0, 6.0))
    fault = ChannelFault("offset", _channel(draw), _when(draw), size)  # type: ignore[arg-type]
    return _fault(draw, "sensor offset", fault, "sensor_fault", 15.0)


def swapped(draw: Generator) -> Case:
    """The plugs of the channels are exchanged."""
    return _fault(
        draw, "sensors swapped", ChannelFault("swapped", "spool", _when(draw)), "sensor_fault", 15.0
    )


def scale(draw: Generator) -> Case:
    """A channel's sensitivity changes by 20 to 50 %."""
    gain = float(1.0 + draw.choice([-1.0, 1.0]) * draw.uniform(0.2, 0.5))
    fault = ChannelFault("scale", _channel(draw), _when(draw), gain)  # type: ignore[arg-type]
    return _fault(draw, "sensor mis-scaled", fault, "sensor_fault", 15.0)


def gaps(draw: Generator) -> Case:
    """Data are lost, for up to a second; and once more."""
    case = _healthy(draw, "data gaps")
    at = _when(draw)
    holes = ((at, at + 0.4), (at + 30.0, at + 31.0))
    event = Expected("data_fault", (), at, at, at + 3.0)
    return replace(case, gaps=holes, expected=(event,))


SCENARIOS: tuple[Callable[[Generator], Case], ...] = (
    healthy, healthy_warming, healthy_speed, healthy_standstill, wear_ramp, wear_step, wear_warming,
    contamination, contamination_warming, other_oil, spring_fatigue, resonance_15, resonance_29, stuck, dead,
    clipping, offset, swapped, scale, gaps,
)  # fmt: skip


def draw_cases(count: int, seed: int) -> list[Case]:
    """Return ``count`` scenarios, every kind in turn; each depends on ``seed`` and its own number alone."""
    return [
        SCENARIOS[number % len(SCENARIOS)](np.random.default_rng([seed, number])) for number in range(count)
    ]


def draw_hours(count: int, seed: int) -> list[Case]:
    """Return ``count`` healthy hours."""
    return [healthy_hour(np.random.default_rng([seed, 7, number])) for number in range(count)]
