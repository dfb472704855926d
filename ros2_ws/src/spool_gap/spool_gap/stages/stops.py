"""Stops: all else is named from contact-free segments, then the contact is added and fitted over everything.

Contact-free segments give the base and whatever acts between the stops, the hits themselves give the contact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.result import RankedHypothesis
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import bic_penalty, evidence_of
from spool_gap.selection.sense import refusal, trifling
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.contact_free import contact_free_segments, without_hits
from spool_gap.simulation.contacts import Contacts, find_contacts
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch, thinned
from spool_gap.simulation.shooting import Piece, pieces_of
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

from .small_effects import find_small_effect
from .stop_fit import STOP, with_stop
from .two_directions import TWO, split
from .whole_windows import TRIFLE, dropped

#: Samples over those of other fits over which the contact is fitted.
MORE = 2
#: Error of a displacement over the scatter of the clearance from hit to hit.
WANDER = 0.5


def contacts_of(context: Context, state: SelectionState, mass: float) -> Contacts | None:
    """Return the hits in the whole windows; ``None`` where there are none, or the base has stops."""
    if all(entry.id != STOP for entry in state.catalogue):
        return None
    return find_contacts(context.whole, mass)


def contact_free(
    context: Context, state: SelectionState, contacts: Contacts | None, gain: float = 0.0, delay: float = 0.0
) -> tuple[Context, SelectionState] | None:
    """Return context and state over contact-free segments; ``None`` without hits, or with too few of them.

    Args:
        context, state: over everything, at the beginning.
        contacts: in the stretches, if there are any.
        gain, delay: of the spool's channel, with which those were conditioned, relative, s.
    """
    stretches = contact_free_segments(without_hits(context.whole, contacts), contacts) if contacts else []
    if not stretches:
        return None
    longest, motions = state.fitting.settings.longest, state.fitting.simulation.motions
    pieces = pieces_of(stretches, longest, gain, delay)
    if not all(any(flag == trains for s in pieces for flag in s.training) for trains in (True, False)):
        return None
    # The starts of pieces between hits are too uncertain for small effects.
    left_out = context.left_out | {find_small_effect.__name__}
    return (
        replace(context, whole=pieces, regressed=thinned(pieces, 3 * longest), left_out=left_out),
        SelectionState(
            state.fitting.over(Simulation(pieces, motions)),
            Simulation(pieces, motions),
            tuple(entry for entry in state.catalogue if entry.id != STOP),
        ),
    )


def select_with_stop(
    context: Context, state: SelectionState, select: Callable[[Context, SelectionState], SelectionState]
) -> SelectionState | None:
    """Return ``state`` with a stop among what was selected; ``None`` where hits are not what is missing.

    Args:
        context: its start has the gain and delay with which the stretches were conditioned.
        state: over everything, at the beginning.
        select: names all else.
    """
    start = context.start
    contacts = contacts_of(context, state, start.values["mass"])
    free = contact_free(context, state, contacts, start.gain, start.delay)
    if contacts is None or free is None:
        return None
    segments = _without_trifles(select(*free))
    contacts = _looked_at_again(context, contacts, segments.hypothesis.point)
    context.progress("fitting the stop", 0.7)
    stretches = _wandering(context, contacts, state.fitting.settings.longest)
    fitting = state.fitting.over(Simulation(stretches, state.fitting.simulation.motions))
    fitting, step = with_stop(fitting, contacts, segments.hypothesis)
    without = fitting.measured(segments.hypothesis)
    fitting = fitting.weighed_by(step)
    without, step = fitting.scored(without), fitting.scored(step)
    row = _row(fitting, without, step)
    if row.reason:
        return None
    ranking = [
        replace(entry, nrmse_after=fitting.nrmse(fitting.measured(segments.tried[entry.key])))
        for entry in segments.ranking
        if entry.key in segments.tried
    ]
    steps = [fitting.measured(entry) for entry in segments.steps if TWO not in entry.effects]
    state = replace(
        state,
        fitting=fitting,
        accepted=step,
        steps=(*steps, step),
        ranking=(*ranking, replace(row, accepted=True)),
        tried={(STOP, without.effects): step},
        overruled=segments.overruled,
        trace=segments.trace,
    )
    return split(state, 0.0)


def _without_trifles(segments: SelectionState) -> SelectionState:
    """Return ``segments`` with friction of one force, and without what means nothing on a machine."""
    if TWO in segments.hypothesis.effects:  # its start from rest is judged with the stop
        segments = replace(segments, accepted=segments.steps[-2])
    step = segments.hypothesis
    trifles = [name for name in step.effects if name in EFFECTS and trifling(segments.fitting, step, name)]
    if not trifles:
        return segments
    less = dropped(segments, trifles, TRIFLE)
    return replace(less, steps=(*segments.steps, less.hypothesis))


def _looked_at_again(context: Context, contacts: Contacts, point: Point) -> Contacts:
    """Return the hits as a gain or delay of the spool's channel shows them that was found free of them."""
    start = context.start
    more, later = (1.0 + point.gain) / (1.0 + start.gain) - 1.0, point.delay - start.delay
    if abs(more) > THRESHOLDS.stop_gain or abs(later) > THRESHOLDS.stop_delay:
        mass = start.values["mass"]
        return find_contacts(context.whole, mass, gain=more, delay=later) or contacts
    return contacts


def _wandering(context: Context, contacts: Contacts, longest: int) -> Sequence[Stretch]:
    """Return more pieces than others are fitted over, whose displacement wanders as hits scatter."""
    whole, start = without_hits(context.whole, contacts), context.start
    wander = WANDER * contacts.laws[0].spread
    return [
        replace(
            stretch,
            windows=tuple(
                replace(window, wander=(wander, 4.0 * math.pi * stretch.low_cut * wander))
                for window in stretch.windows
                if isinstance(window, Piece)
            ),
        )
        for stretch in pieces_of(whole, MORE * longest, start.gain, start.delay)
    ]


def _row(fitting: Fitting, without: Hypothesis, step: Hypothesis) -> RankedHypothesis:
    evidence = max(evidence_of(fitting, without, step), _by_power(fitting, without, step))
    reason = refusal(fitting, without, step, evidence, 0.0)
    return RankedHypothesis(
        STOP, without.effects, fitting.nrmse(step), evidence, step.free_values, reason=reason
    )


def _by_power(fitting: Fitting, without: Hypothesis, step: Hypothesis) -> float:
    """Return the evidence for ``step`` by the power that both leave in windows that are bad with either.

    0 where ``step`` leaves too much of the power: few windows with hits, each counted by a logarithm, weigh
    less than one that is grazed too early.
    """
    if fitting.nrmse(step) ** 2 >= THRESHOLDS.stop_halves * fitting.nrmse(without) ** 2:
        return 0.0
    simulation, held = fitting.simulation, fitting.simulation.held_out
    edges, most = simulation.parts(held)
    before, after = (
        np.add.reduceat(simulation.weigh(entry.held, held)[0] ** 2, edges[:-1]) for entry in (without, step)
    )
    bad = np.maximum(before, after) > most
    numbers = len(step.fitted.free) - len(without.fitted.free)
    gain = math.log(float(before[bad].sum()) / float(after[bad].sum())) if bad.any() else 0.0
    return float(np.diff(edges)[bad].sum()) * gain - bic_penalty(fitting) * numbers
