"""Strokes: what a solenoid does to the spool, as a force over time and the command behind it.

The force follows the command as the solenoid's current does, by a time constant. The spool moves from the
centre to a stop, stays there while the command lasts, and the springs bring it back.
"""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict
from spool_core.numbers import Array

from spool_sim.model import Model
from spool_sim.terms import term
from spool_sim.valve import NotNegative, Positive

#: s/m, loss of the contact at a stop of a spool in oil: half of a rebound at 0.3 m/s (chosen).
DISSIPATION = 2.0


class Strokes(BaseModel):
    """Strokes that a solenoid valve makes at regular times. Frozen.

    Attributes:
        period: s from one stroke out of the centre to the next; longer than ``hold``.
        first: s, time of the first one.
        hold: s for which the command lasts.
        force: N, of the energised solenoid.
        rise: s, time constant of the force.
        travel: m from the centre to the stop.
        both: whether the strokes go to both sides in turn (positions a and b).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    period: Positive
    first: NotNegative = 0.0
    hold: Positive = 0.5
    force: Positive = 20.0
    rise: Positive = 0.01
    travel: Positive = 0.003
    both: bool = False

    def _phase(self, t: Array) -> tuple[Array, Array]:
        """Return the time since the last command (s, negative before the first) and its side, 1 or -1."""
        number = np.floor((t - self.first) / self.period)
        side = np.where(self.both & (number % 2.0 == 1.0), -1.0, 1.0)
        return np.where(number >= 0.0, t - self.first - number * self.period, -1.0), side

    def command(self, t: Array) -> Array:
        """Return the command at times ``t`` (s): 1 for position a, -1 for b, 0 for the centre."""
        since, side = self._phase(t)
        return np.where((since >= 0.0) & (since < self.hold), side, 0.0)

    def push(self, t: Array) -> Array:
        """Return the solenoid's force (N, shape of ``t``) at times ``t`` (s)."""
        since, side = self._phase(t)
        on = -np.expm1(-np.clip(since, 0.0, self.hold) / self.rise)
        off = np.exp(-np.clip(since - self.hold, 0.0, None) / self.rise)
        return np.where(since < 0.0, 0.0, self.force * side * on * off)

    def acting_on(self, model: Model) -> Model:
        """Return ``model`` with the stops and the solenoid's force that the strokes need."""
        present = {one.name for one in model.terms}
        more = tuple(term(name) for name in ("constant_force", "end_stop") if name not in present)
        values = {"push": 0.0, "stop_gap": self.travel, "stop_dissipation": DISSIPATION}
        return Model(model.name, (*model.terms, *more), {**values, **model.values}, model.uncertainty)
