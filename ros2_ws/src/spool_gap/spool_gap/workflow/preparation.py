"""Preparation of a selection: kernels, stretches with their windows, and where the fit of the base starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from spool_estimator.identification.record import Record
from spool_sim.model import Model
from spool_sim.terms import term
from spool_sim.valve import Valve

from spool_gap.checks.saturation import Saturation
from spool_gap.effect import Effect
from spool_gap.fitting.hypothesis import Fitting
from spool_gap.registry import EFFECTS
from spool_gap.result import GapSettings
from spool_gap.selection.context import Context, Progress
from spool_gap.selection.joint_fit import fitted_base
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import stretches_of, thinned
from spool_gap.simulation.shooting import pieces_of
from spool_gap.simulation.simulate import Simulation
from spool_gap.simulation.switchable import SwitchableMotion, known_terms
from spool_gap.stages.stops import contact_free, contacts_of


@dataclass(frozen=True, slots=True)
class Task:
    """Task of an analysis.

    Attributes:
        records, holdout: to fit, and to hold out; without the latter every other window is held out.
        saturation: of both, with clipped samples marked.
        base, valve, settings: as given.
        motions: kernels for the base with any effect.
        progress: takes what is done and the share of the work.
        deadline: by the monotonic clock, s, after which nothing further is looked for.
        chain_open: nuisances of the measuring chain are tried next to effects.
    """

    records: Sequence[Record]
    holdout: Sequence[Record]
    saturation: Saturation
    base: Model
    valve: Valve
    settings: GapSettings
    motions: Sequence[SwitchableMotion]
    progress: Progress
    deadline: float = math.inf
    chain_open: bool = True

    @property
    def start(self) -> Point:
        """The base with the numbers of the valve's description."""
        names = tuple(entry.name for entry in self.base.terms)
        return Point(names, {**given_by(self.valve), **self.base.values_for(self.valve)})


def motions_for(base: Model) -> list[SwitchableMotion]:
    """Return the kernels for ``base`` with any effect: one for forces without events, and one for all."""
    wanted = [entry.name for entry in base.terms]
    wanted += [name for entry in EFFECTS.values() for name in entry.terms]
    known = known_terms(wanted)
    smooth = [name for name in known if set(term(name).laws) <= {"force_law"}]
    return [SwitchableMotion(smooth), SwitchableMotion(known)]


def given_by(valve: Valve) -> dict[str, float]:
    """Return the numbers of all effects that the description of ``valve`` gives, as the spool's weight."""
    parameters = [p for entry in EFFECTS.values() for name in entry.terms for p in term(name).parameters]
    return {p.name: p.start_for(valve) for p in parameters if p.valve_attribute is not None}


def first_look(task: Task) -> tuple[Point, bool]:
    """Return the base's numbers by a rough fit, and whether it was fitted free of contacts with a stop.

    Its damping says how long a window takes to forget its start.
    """
    damping = 0.5 * task.valve.likely_viscous_coefficient
    context, state = prepared(task, task.start, damping, task.settings.longest // 2)
    free = contact_free(context, state, contacts_of(context, state, task.start.values["mass"]))
    context, state = free or (context, state)
    _, step = fitted_base(state.fitting, context.regressed, task.start, rounds=6)
    return step.point, free is not None


def prepared(task: Task, start: Point, damping: float, longest: int) -> tuple[Context, SelectionState]:
    """Return what a selection begins with.

    Args:
        task: with the records.
        start: of the base; the motion is conditioned with its gain and delay.
        damping: N s/m, by which windows forget their start.
        longest: samples to fit, and again to hold out, at most.
    """
    count = len(task.records)
    repaired = task.saturation.repaired[:count], task.saturation.repaired[count:]
    gain, delay = start.gain, start.delay
    whole = stretches_of(
        *repaired, task.base, task.valve,
        damping=damping, gain=gain, delay=delay, clipped=task.saturation.kept,
    )  # fmt: skip
    simulation = Simulation(pieces_of(whole, longest, gain, delay), task.motions)
    context = Context(
        start, whole, thinned(whole, 3 * longest), task.progress, task.settings.left_out, task.deadline
    )
    fitting = Fitting(simulation, task.base, task.valve, task.settings)
    return context, SelectionState(
        fitting,
        Simulation(thinned(whole, longest), task.motions),
        tried_effects(task.base, chain=task.chain_open),
    )


def tried_effects(base: Model, *, chain: bool = False) -> tuple[Effect, ...]:
    """Return the effects that may be missing in ``base``, by two accelerometers; with ``chain`` nuisances."""
    base_terms = {entry.name for entry in base.terms}
    return tuple(
        entry
        for entry in EFFECTS.values()
        # Friction that differs by direction shows only at the start from rest.
        if "accelerations" in entry.kinds and entry.searched and (chain or not entry.nuisance)
        if not base_terms & set(entry.terms)
    )
