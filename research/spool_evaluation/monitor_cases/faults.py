"""Faults drawn from a seed: a stuck spool, faulty channels, lost data."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from .healthy import Generator, draw_case
from .scenario import ChannelFault, Expected, Scenario

#: s, from when to when it may happen, and where something else happens before it.
HAPPENS, LATE = (70.0, 120.0), (160.0, 180.0)


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
    """Let data be lost, for up to a second; and once more."""
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
