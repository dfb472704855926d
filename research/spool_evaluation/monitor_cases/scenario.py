"""Scenario: what the machine does, what happens to valve, oil and sensors, and what has to be found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field
from spool_sim.excitation import Array, MachineOrders
from spool_sim.valve.description import Valve
from spool_sim.valve.validation import NotNegative, Number

#: s that the machine takes to stand still or to come up.
FADE = 2.0


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
    """Planned change: ``quantity`` of the simulator runs to ``target`` from ``at`` in ``duration`` (s)."""

    quantity: str
    target: float
    at: float
    duration: float


@dataclass(frozen=True, slots=True)
class ChannelFault:
    """Channel fault: what becomes of the channels from ``at`` (s) on; ``value`` is the fault's size.

    ``clipping``: full scale, m/s^2; ``offset``: m/s^2; ``scale``: gain; ``dead``: noise that is left, m/s^2.
    ``stuck`` is the spool's: it moves with its body from then on.
    """

    kind: Literal["dead", "clipping", "offset", "scale", "swapped", "stuck"]
    channel: Literal["body", "spool"]
    at: float
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Expected:
    """Expected event: it has to be raised from ``begin`` to ``by`` (s); ``causes``: the right ones, if named.

    ``reached`` (s) is when the change is as large as it must be to be found; delays count from there.
    """

    kind: str
    causes: tuple[str, ...]
    begin: float
    reached: float
    by: float


@dataclass(frozen=True, slots=True)
class Scenario:
    """Scenario with its truth.

    Attributes:
        kind: the sort of scenario, a row of the table.
        drawn_valve: as it is; the monitor is told the same data but for what drifts.
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
