"""Faults drawn from a seed: a stuck spool, faulty channels, lost data."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from .drifts import passes, rubs, tires, wears
from .healthy import Generator, draw_case, with_warming
from .scenario import ChannelFault, Expected, Scenario

#: s, from when to when it may happen.
HAPPENS = (70.0, 120.0)


def when(draw: Generator) -> float:
    """Return when it happens, s."""
    return float(round(draw.uniform(*HAPPENS), 2))


def channel(draw: Generator) -> Literal["body", "spool"]:
    """Return which channel it happens to."""
    return "body" if draw.random() < 0.5 else "spool"


def hurt(case: Scenario, fault: ChannelFault, within: float) -> Scenario:
    """Let ``fault`` happen; it must be found ``within`` s."""
    kind, causes = ("stuck_spool", ()) if fault.kind == "stuck" else ("sensor_fault", (fault.kind,))
    event = Expected(kind, causes, fault.at, fault.at, fault.at + within)
    return replace(case, faults=(fault,), expected=(*case.expected, event))


def stuck(draw: Generator) -> Scenario:
    """The spool sticks in its bore."""
    return hurt(draw_case(draw, "stuck spool"), ChannelFault("stuck", "spool", when(draw)), 15.0)


def dead(draw: Generator) -> Scenario:
    """A channel shows noise only."""
    left = float(draw.choice([0.0, 0.02, 0.08]))
    fault = ChannelFault("dead", channel(draw), when(draw), left)
    return hurt(draw_case(draw, "sensor dead"), fault, 10.0)


def clipping(draw: Generator) -> Scenario:
    """A channel is cut off at a share of its rms."""
    fault = ChannelFault("clipping", channel(draw), when(draw), float(draw.uniform(0.6, 1.3)))
    return hurt(draw_case(draw, "sensor clipping"), fault, 15.0)


def offset(draw: Generator) -> Scenario:
    """The mean of a channel moves."""
    size = float(draw.choice([-1.0, 1.0]) * draw.uniform(1.0, 6.0))
    fault = ChannelFault("offset", channel(draw), when(draw), size)
    return hurt(draw_case(draw, "sensor offset"), fault, 15.0)


def swapped(draw: Generator) -> Scenario:
    """The plugs of the channels are exchanged."""
    return hurt(draw_case(draw, "sensors swapped"), ChannelFault("swapped", "spool", when(draw)), 15.0)


def scale(draw: Generator) -> Scenario:
    """A channel's sensitivity changes by 20 to 50 %."""
    gain = float(1.0 + draw.choice([-1.0, 1.0]) * draw.uniform(0.2, 0.5))
    fault = ChannelFault("scale", channel(draw), when(draw), gain)
    # A sensor's gain is no part of the online model either: it leaves what the gain changed.
    return hurt(draw_case(draw, "sensor mis-scaled"), fault, 15.0)


def gaps(draw: Generator) -> Scenario:
    """Data are lost, for up to a second; and once more."""
    case = draw_case(draw, "data gaps")
    at = when(draw)
    holes = ((at, at + 0.4), (at + 30.0, at + 31.0))
    event = Expected("data_fault", (), at, at, at + 3.0)
    return replace(case, gaps=holes, expected=(event,))


def wear_then_dead(draw: Generator) -> Scenario:
    """The clearance grows, and a minute later a channel dies."""
    case = wears(draw, draw_case(draw, "wear, then sensor dead", seconds=220.0), (10.0, 20.0))
    return hurt(case, ChannelFault("dead", channel(draw), float(round(draw.uniform(160.0, 180.0), 2))), 10.0)


def contamination_then_stuck(draw: Generator) -> Scenario:
    """Dry friction rises until the spool sticks for good."""
    case = rubs(draw, draw_case(draw, "contamination, then stuck", seconds=220.0), (10.0, 20.0))
    return hurt(case, ChannelFault("stuck", "spool", float(round(draw.uniform(160.0, 180.0), 2))), 20.0)


def wear_and_spring(draw: Generator) -> Scenario:
    """Clearance and spring change in the same minute."""
    return tires(draw, wears(draw, draw_case(draw, "wear and spring change")))


def resonance_and_wear(draw: Generator) -> Scenario:
    """The clearance grows, and the machine runs into resonance while the oil warms."""
    case = passes(draw, "wear and resonance, oil warms", int(draw.integers(2)))
    return wears(draw, with_warming(draw, case))
