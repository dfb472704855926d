"""Drifts of the valve, its oil and its speed, drawn from a seed."""

from __future__ import annotations

from dataclasses import replace

from .healthy import Generator, draw_case, draw_valve, with_warming
from .scenario import Expected, PlannedChange, Scenario

#: s, from when on something may happen, and s within which it must be found once it is large enough.
HAPPENS, FOUND = (70.0, 90.0), 30.0

#: Share of the first order's inertia force that dry friction reaches at most: more locks the spool.
LOCKS = 0.75


def drift(
    draw: Generator,
    case: Scenario,
    change: tuple[str, float, float],
    needed: float,
    expected: tuple[str, str],
    duration: tuple[float, float] = (20.0, 50.0),
) -> Scenario:
    """Let ``change`` (quantity, from, to) happen; where it is ``needed``, ``expected`` must be found."""
    quantity, start, target = change
    at = float(draw.uniform(*HAPPENS))
    lasts = float(draw.uniform(*duration))
    reached = at + lasts * needed / abs(target - start)
    event = Expected(expected[0], (expected[1],), at, reached, reached + FOUND)
    return replace(
        case,
        changes=(*case.changes, PlannedChange(quantity, target, at, lasts)),
        expected=(*case.expected, event),
    )


def wears(draw: Generator, case: Scenario, duration: tuple[float, float] = (20.0, 50.0)) -> Scenario:
    """Let the viscous coefficient fall to 40 to 70 %."""
    drag = case.drawn_valve.viscous_coefficient
    change = ("viscous_coefficient", drag, drag * float(draw.uniform(0.4, 0.7)))
    return drift(draw, case, change, 0.2 * drag, ("friction_drift", "wear"), duration)


def rubs(draw: Generator, case: Scenario, duration: tuple[float, float] = (20.0, 50.0)) -> Scenario:
    """Let the dry friction rise by 0.15 to 0.4 N, but not lock the spool."""
    force = case.drawn_valve.moving_mass * case.machine.orders[0][1]
    start = min(case.coulomb_force, LOCKS * force - 0.15)
    target = min(start + float(draw.uniform(0.15, 0.4)), LOCKS * force)
    change = ("coulomb_force", start, target)
    return drift(
        draw,
        replace(case, coulomb_force=start),
        change,
        0.1,
        ("friction_drift", "oil_contamination"),
        duration,
    )


def tires(draw: Generator, case: Scenario) -> Scenario:
    """Let the spring lose 15 to 40 % of its stiffness; where the machine shakes it then, it resonates."""
    stiffness = case.drawn_valve.spring_stiffness
    change = ("spring_stiffness", stiffness, stiffness * float(draw.uniform(0.6, 0.85)))
    case = drift(draw, case, change, 0.1 * stiffness, ("spring_change", "softer"))
    return replace(case, follows=("resonance",))


def thickens(draw: Generator, case: Scenario) -> Scenario:
    """Let the drag rise at the same temperature: oil that is too thick."""
    drag = case.drawn_valve.viscous_coefficient
    change = ("viscous_coefficient", drag, drag * float(draw.uniform(1.35, 1.9)))
    return drift(draw, case, change, 0.2 * drag, ("friction_drift", "oil_viscosity"))


def seen_after_standstill(_: Generator, case: Scenario) -> Scenario:
    """Let what happens be found later by as much as the machine stands still: nothing is seen then."""
    begin, end = case.machine.rests[1]
    event = case.expected[0]
    if event.by + 2.0 > begin:
        event = replace(event, by=event.by + end - begin + 4.0)
    return replace(case, expected=(event,), seconds=200.0)


def passes(draw: Generator, kind: str, spring: int) -> Scenario:
    """Let the machine run into resonance, from above or below, stay there and leave it."""
    valve = draw_valve(draw, spring=spring, oil=1)
    case = draw_case(draw, kind, valve=valve)
    natural, at = valve.natural_frequency, float(draw.uniform(HAPPENS[0], 100.0))
    start = case.machine.speed_profile[0][1] / 60.0
    ramp, stay = draw.uniform(3.0, 15.0), draw.uniform(5.0, 20.0)
    meets = natural * draw.uniform(0.97, 1.03)
    profile = (
        (0.0, start), (at, start), (at + ramp, meets), (at + ramp + stay, meets),
        (at + 2 * ramp + stay, start),
    )  # fmt: skip
    # Within 8 % of the natural frequency a lightly damped spool resonates beyond doubt.
    surely, early = (0.92, 0.7) if start < natural else (1.08, 1.3)
    reached = at + ramp * (start - surely * natural) / (start - meets)
    near = at + ramp * max(0.0, (start - early * natural) / (start - meets))
    event = Expected("resonance", (), near, reached, reached + 3.0)
    speeds = tuple((time, 60.0 * frequency) for time, frequency in profile)
    machine = case.machine.model_copy(update={"speed_profile": speeds})
    return replace(case, machine=machine, expected=(event,))


def passes_and_wears(draw: Generator, kind: str) -> Scenario:
    """Let the clearance grow, and the machine run into resonance, while the oil warms."""
    case = passes(draw, kind, int(draw.integers(2)))
    return wears(draw, with_warming(draw, case))
