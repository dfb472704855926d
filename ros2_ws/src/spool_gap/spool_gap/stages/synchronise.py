"""Synchronisation of all runs to the measured motion, once it can go several ways."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.fitting.synchronised import DAMPING_RATIO, synchronised_simulation
from spool_gap.registry import EFFECTS
from spool_gap.selection.completeness import is_closed
from spool_gap.selection.context import Context
from spool_gap.selection.joint_fit import synchronised_point
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.simulate import Simulation

from .candidates import follows


def synchronise(context: Context, state: SelectionState) -> SelectionState:
    """Synchronised runs from here on, where free ones do not show what the accepted hypothesis leaves."""
    if not follows(state):
        return state
    several, state = _several_ways(state, state.hypothesis)
    if not several:
        return state
    fitting, step = state.fitting, state.hypothesis
    point = synchronised_point(context, fitting, step)
    simulation = synchronised_simulation(fitting, context.whole, DAMPING_RATIO, fitting.settings.longest)
    simulation = simulation.counting_robustly()
    judging = Simulation(simulation.stretches, simulation.motions, simulation.damper).counting_robustly()
    state = state.refitted(step, step.at(point))
    state = replace(state, judging=judging, synchronised=True, remaining=None).over(fitting.over(simulation))
    step = state.fitting.polished(state.hypothesis)
    state = replace(state, fitting=state.fitting.weighed_by(step))
    return replace(state, accepted=state.fitting.polished(step))


def _several_ways(state: SelectionState, step: Hypothesis) -> tuple[bool, SelectionState]:
    """Return whether the motion can go several ways with ``step``, and ``state`` that knows it."""
    if any(EFFECTS[name].local_minima for name in step.effects):
        return True, state
    if not any(EFFECTS[name].localised for name in step.effects):
        return False, state
    closed, state = is_closed(state, step)
    return not closed, state
