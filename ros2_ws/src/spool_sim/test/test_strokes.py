"""Strokes of a simulated solenoid."""

from __future__ import annotations

import numpy as np
import pytest
from spool_sim.excitation import Standstill
from spool_sim.simulator import Simulator
from spool_sim.strokes import Strokes
from spool_sim.valve import find_valve

STROKES = Strokes(period=2.0, first=0.5, hold=0.8, force=20.0, rise=0.01, travel=0.003)


def places(strokes: Strokes, *moments: float) -> list[float]:
    """Return where the spool is, m, at ``moments``, s."""
    simulator = Simulator(find_valve("4weh10_soft"), Standstill(), coulomb_force=0.1, strokes=strokes)
    found = []
    for moment in moments:
        list(simulator.records(moment - simulator.time))
        found.append(simulator._state.displacement)
    return found


def test_the_spool_travels_to_its_stop_and_the_springs_bring_it_back() -> None:
    before, at_stop, after = places(STROKES, 0.4, 1.2, 2.4)
    assert before == 0.0
    assert at_stop == pytest.approx(0.003, rel=0.02)
    assert abs(after) < 1e-4


def test_strokes_to_both_sides_take_turns() -> None:
    strokes = STROKES.model_copy(update={"both": True})
    assert strokes.command(np.array([0.4, 0.6, 1.4, 2.6, 4.6])).tolist() == [0.0, 1.0, 0.0, -1.0, 1.0]
    assert places(strokes, 3.2) == [pytest.approx(-0.003, rel=0.02)]


def test_the_force_follows_the_command_by_its_time_constant() -> None:
    push = STROKES.push(np.array([0.5, 0.51, 0.52, 1.3, 1.31]))
    falls = np.exp(-1.0)
    expected = [0.0, 20.0 * (1.0 - falls), 20.0 * (1.0 - falls**2), 20.0, 20.0 * falls]
    assert push == pytest.approx(expected, rel=1e-9)
