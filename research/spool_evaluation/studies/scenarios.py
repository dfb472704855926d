"""Scenarios of the monitor drawn from a seed: healthy valves, drifts and faults, and what has to be found."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from pydantic import Field
from spool_core.numbers import Array
from spool_sim.excitation import MachineOrders
from spool_sim.valve import NotNegative, Number, Valve

#: s that the machine takes to stand still or to come up.
FADE = 2.0

Generator = np.random.Generator


@dataclass(frozen=True, slots=True)
class Scenario:
    """Scenario with its truth.

    Attributes:
        kind: the sort of scenario, a row of the table.
        drawn_valve: as it is; the monitor gets the same data but for what drifts.
        gaps: (begin, end) of lost data, s.
        gain_error: of the spool's accelerometer from the start.
        follows: kinds that may follow from what happened, neither wanted nor false.

    """

    kind: str
    seed: int
    seconds: float
    sample_rate: float
    drawn_valve: Valve
    coulomb_force: float
    noise: float
    gain_error: float
    machine: StoppingMachine
    changes: tuple[PlannedChange, ...] = ()
    faults: tuple[ChannelFault, ...] = ()
    gaps: tuple[tuple[float, float], ...] = ()
    expected: tuple[Expected, ...] = ()
    follows: tuple[str, ...] = ()


class StoppingMachine(MachineOrders):
    """Machine excitation that stands still at times.

    Attributes:
        rests: (begin, end) of each standstill, s; the vibration fades within 2 s.
    """

    rests: tuple[tuple[NotNegative, Number], ...] = Field(default=())

    def _steady(self, t: Array) -> Array:
        total = super()._steady(t)
        for begin, end in self.rests:
            outside = np.maximum(begin - t, t - end) / FADE
            total = total * np.clip(outside, 0.0, 1.0)
        return total


@dataclass(frozen=True, slots=True)
class PlannedChange:
    """``quantity`` of the simulator runs to ``target`` from ``at`` in ``duration`` (s)."""

    quantity: str
    target: float
    at: float
    duration: float


@dataclass(frozen=True, slots=True)
class ChannelFault:
    """What becomes of the channels from ``at`` (s) on; ``value`` is the fault's size.

    ``clipping``: full scale, m/s^2; ``offset``: m/s^2; ``scale``: gain; ``dead``: noise that is left, m/s^2.
    ``stuck`` is the spool's: it moves with its body from then on.
    """

    kind: Literal["dead", "clipping", "offset", "scale", "swapped", "stuck"]
    channel: Literal["body", "spool"]
    at: float
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Expected:
    """It has to be raised from ``begin`` to ``by`` (s); ``causes``: the right ones, if named.

    ``reached`` (s) is when the change is as large as it must be to be found; delays count from there.
    """

    kind: str
    causes: tuple[str, ...]
    begin: float
    reached: float
    by: float


def channel(draw: Generator) -> Literal["body", "spool"]:
    """Return which channel it happens to."""
    return "body" if draw.random() < 0.5 else "spool"


#: Draws a scenario of a kind.
Draw: TypeAlias = Callable[[Generator, str], Scenario]
#: s of a ramp over minutes, of one in a step, and of one before something else happens; s of long scenarios.
SLOW, STEP, EARLY = (200.0, 300.0), (0.0, 0.0), (10.0, 20.0)
SLOW_SECONDS, TWO_SECONDS = 420.0, 220.0


def after(*happens: Callable[[Generator, Scenario], Scenario], seconds: float = 180.0) -> Draw:
    """Return what draws a healthy scenario and lets things happen to it, one after the other."""

    def draw(generator: Generator, kind: str) -> Scenario:
        case = draw_case(generator, kind, seconds)
        for happen in happens:
            case = happen(generator, case)
        return case

    return draw


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


def dies(draw: Generator, case: Scenario) -> Scenario:
    """Let a channel die late, showing nothing any more."""
    fault = ChannelFault("dead", channel(draw), float(round(draw.uniform(*LATE), 2)))
    return hurt(case, fault, 10.0)


def sticks_for_good(draw: Generator, case: Scenario) -> Scenario:
    """Let the spool stick late."""
    return hurt(case, ChannelFault("stuck", "spool", float(round(draw.uniform(*LATE), 2))), 20.0)


def sticks(draw: Generator, case: Scenario) -> Scenario:
    """Let the spool stick in its bore."""
    return hurt(case, ChannelFault("stuck", "spool", when(draw)), 15.0)


def exchanged(draw: Generator, case: Scenario) -> Scenario:
    """Let the plugs of the channels be exchanged."""
    return hurt(case, ChannelFault("swapped", "spool", when(draw)), 15.0)


def loses_data(draw: Generator, case: Scenario) -> Scenario:
    """Let data be lost, for up to a second; and again."""
    at = when(draw)
    holes = ((at, at + 0.4), (at + 30.0, at + 31.0))
    return replace(case, gaps=holes, expected=(Expected("data_fault", (), at, at, at + 3.0),))


def dead(draw: Generator, kind: str) -> Scenario:
    """A channel shows noise only."""
    left = float(draw.choice([0.0, 0.02, 0.08]))
    fault = ChannelFault("dead", channel(draw), when(draw), left)
    return hurt(draw_case(draw, kind), fault, 10.0)


def clipping(draw: Generator, kind: str) -> Scenario:
    """A channel is cut off at a share of its rms."""
    fault = ChannelFault("clipping", channel(draw), when(draw), float(draw.uniform(0.6, 1.3)))
    return hurt(draw_case(draw, kind), fault, 15.0)


def offset(draw: Generator, kind: str) -> Scenario:
    """The mean of a channel moves."""
    size = float(draw.choice([-1.0, 1.0]) * draw.uniform(1.0, 6.0))
    fault = ChannelFault("offset", channel(draw), when(draw), size)
    return hurt(draw_case(draw, kind), fault, 15.0)


def scale(draw: Generator, kind: str) -> Scenario:
    """A channel's sensitivity changes by 20 to 50 %."""
    gain = float(1.0 + draw.choice([-1.0, 1.0]) * draw.uniform(0.2, 0.5))
    fault = ChannelFault("scale", channel(draw), when(draw), gain)
    # A sensor's gain is no part of the online model either: it leaves what the gain changed.
    return hurt(draw_case(draw, kind), fault, 15.0)


Profile = tuple[tuple[float, float], ...]

#: Stiffness, N/m, of the two springs, viscosity, Pa s at 40 deg C, and name of the two oils.
SPRINGS, OILS = (1632.0, 5846.0), ((0.0612, "HL68"), (0.0198, "Azolla ZS22"))

#: Shaft frequency over natural frequency of machines that run below and above resonance; the second order of
#: the slower ones lies above it.
BELOW, ABOVE = (0.65, 0.8), (1.45, 2.2)

#: s, from when on something may happen, and s within which it must be found once it is large enough.
HAPPENS, FOUND = (70.0, 90.0), 30.0

#: Share of the first order's inertia force that dry friction reaches at most: more locks the spool.
LOCKS = 0.75

#: s, from when to when it may happen, and where something else happens before it.
FAULT_HAPPENS, LATE = (70.0, 120.0), (160.0, 180.0)


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


def when(draw: Generator) -> float:
    """Return when it happens, s."""
    return float(round(draw.uniform(*FAULT_HAPPENS), 2))


def hurt(case: Scenario, fault: ChannelFault, within: float) -> Scenario:
    """Let ``fault`` happen; it must be found ``within`` s."""
    # A gain that jumps is seen by its jump, or once it lasts by the ratio of the sensitivities.
    named = ("scale", "sensitivity") if fault.kind == "scale" else (fault.kind,)
    kind, causes = ("stuck_spool", ()) if fault.kind == "stuck" else ("sensor_fault", named)
    event = Expected(kind, causes, fault.at, fault.at, fault.at + within)
    return replace(case, faults=(fault,), expected=(*case.expected, event))


#: By kind, in the order of the table.
SCENARIOS: dict[str, Draw] = {
    "healthy": after(),
    "healthy, oil warms": after(with_warming),
    "healthy, speed changes": after(with_speeds),
    "healthy, standstills": after(with_standstills),
    "wear, ramp": after(wears),
    "wear, slow ramp": after(partial(wears, duration=SLOW), seconds=SLOW_SECONDS),
    "wear, step": after(partial(wears, duration=STEP)),
    "wear, oil warms": after(with_warming, wears),
    "wear, speed changes": after(with_speeds, wears),
    "contamination": after(rubs),
    "contamination, slow ramp": after(partial(rubs, duration=SLOW), seconds=SLOW_SECONDS),
    "contamination, oil warms": after(with_warming, rubs),
    "contamination, standstills": after(with_standstills, rubs, seen_after_standstill),
    "oil viscosity, unexplained": after(thickens),
    "spring change": after(tires),
    "spring change, speed changes": after(with_speeds, tires),
    "resonance near 15 Hz": partial(passes, spring=0),
    "resonance near 29 Hz": partial(passes, spring=1),
    "stuck spool": after(sticks),
    "sensor dead": dead,
    "sensor clipping": clipping,
    "sensor offset": offset,
    "sensors swapped": after(exchanged),
    "sensor mis-scaled": scale,
    "data gaps": after(loses_data),
    "wear, then sensor dead": after(partial(wears, duration=EARLY), dies, seconds=TWO_SECONDS),
    "contamination, then stuck": after(partial(rubs, duration=EARLY), sticks_for_good, seconds=TWO_SECONDS),
    "wear and spring change": after(wears, tires),
    "wear and resonance, oil warms": passes_and_wears,
}


def draw_scenario(kind: str, generator: Generator) -> Scenario:
    """Return a scenario of ``kind``."""
    return SCENARIOS[kind](generator, kind)


def draw_cases(count: int, seed: int) -> list[Scenario]:
    """Return ``count`` scenarios, every kind in turn; each depends on ``seed`` and its own number alone."""
    kinds = list(SCENARIOS)
    return [
        draw_scenario(kinds[number % len(kinds)], np.random.default_rng([seed, number]))
        for number in range(count)
    ]
