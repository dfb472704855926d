"""Workflow of a gap analysis: fit the base, locate the gap, name what is missing, add it, look again."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

from spool_estimator.identification.record import Record
from spool_sim.model import Model
from spool_sim.valve import Valve

from spool_gap.checks import conditions
from spool_gap.checks.saturation import Saturation, find_saturation
from spool_gap.checks.stuck import as_stuck, dithered, is_stuck
from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.profile import profiles_of
from spool_gap.report.assembly import assembled, model_of
from spool_gap.report.outcome import judge_outcome
from spool_gap.result import GapResult, GapSettings
from spool_gap.selection.context import Progress
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import parts_of
from spool_gap.stages.acceptance import refuse_growth
from spool_gap.stages.selection import judge, select
from spool_gap.stages.stops import select_with_stop
from spool_gap.thresholds import THRESHOLDS

from .final_fit import final_fit
from .measuring_chain import MOST_CORRECTIONS, Chain, cleaned, nuisances_of
from .preparation import Task, first_look, motions_for, prepared

#: Samples that are looked at before windows are chosen.
LONGEST_LOOKED_AT = 600_000
#: Samples that are simulated of a stuck spool: its picture needs no more.
STUCK_LONGEST = 6_000
#: s of searching for each second of data, and at least: two minutes a minute; judging what was found comes on
#: top of that, a quarter of it where it takes longest.
PER_SECOND, AT_LEAST = 1.5, 45.0


def analyse(
    records: Sequence[Record],
    valve: Valve,
    base: Model,
    *,
    holdout: Sequence[Record] = (),
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Return what ``base`` lacks in ``records``, judged on data that no fit has seen.

    Args:
        records: two accelerations each, of one valve.
        valve: gives the mass, which two accelerometers cannot see, and what is expected.
        base: any composition of force terms.
        holdout: records to judge on; without them every other window of ``records`` is held out.
        settings: tolerances and amounts.
        progress: takes what is done and the share of the work.

    Raises:
        InputError: the records cannot be analysed; what is wrong is named.
    """
    begun = time.monotonic()
    tell = progress or (lambda _what, _share: None)
    tell("checking the record", 0.0)
    usable, warnings = conditions.usable(records)
    usable = _parts(usable)
    held = _parts(conditions.usable(holdout)[0]) if holdout else []
    chosen = settings or GapSettings()
    stuck = is_stuck(usable, valve)
    if stuck:
        # Nothing is searched where nothing can be found; the base alone shows what was recorded.
        usable, held = list(dithered(usable)), list(dithered(held))
        left_out = frozenset({"find_small_effect"})
        chosen = replace(chosen, most_effects=0, longest=STUCK_LONGEST, left_out=left_out)
    saturation = find_saturation([*usable, *held])
    warnings += saturation.warnings
    chain = Chain(tuple(usable), tuple(held), (), MOST_CORRECTIONS)
    if not stuck:
        tell("looking at the measuring chain", 0.02)
        chain = cleaned(usable, held, valve, clipped=saturation.limits)
        saturation = find_saturation([*chain.records, *chain.holdout])
    odd, trusted = _judged(chain.records, valve)
    warnings += odd
    while True:
        tell("preparing", 0.05)
        task = Task(
            chain.records, chain.holdout, saturation, base, valve, chosen,
            motions_for(base), tell, begun + _allowed(usable, chosen), chain.open,
        )  # fmt: skip
        state, corrects = _selected(task)
        if not corrects:
            break
        chain = chain.corrected(state.hypothesis)
        saturation = find_saturation([*chain.records, *chain.holdout])
    state, refused = refuse_growth(state)
    tell("fitting all data", 0.85)
    numbers = _numbers(chain.records, base, state, saturation)
    tell("measuring what is left", 0.95)
    outcome = judge_outcome(state, numbers, saturation, trusted=trusted, corrected=len(chain.found))
    left = state.fitting.nrmse(state.hypothesis)
    if left > THRESHOLDS.explains_nothing:
        warnings.append(
            f"even the best model leaves {100.0 * left:.3g} % of the spool's acceleration: units of both "
            "channels, order and sign of the columns, valve file?"
        )
    gave_up = list(dict.fromkeys(change.stage.replace("_", " ") for change in state.trace if change.gave_up))
    if gave_up:
        warnings.append(
            f"out of time after {time.monotonic() - begun:.0f} s: gave up {', '.join(gave_up)}; this is the "
            "best so far, --thorough goes on"
        )
    outcome = replace(
        outcome,
        sentence=" ".join([outcome.sentence, *refused]),
        warnings=(*warnings, *refused, *outcome.warnings),
    )
    result = assembled(records, base, state, numbers, outcome, time.monotonic() - begun)
    result = replace(result, nuisances=(*chain.found, *result.nuisances))
    if chosen.profiles:
        tell("profiling the numbers", 0.97)
        named = {quantity.name for effect in result.effects for quantity in effect.parameters}
        own = profiles_of(state.fitting, state.hypothesis, numbers, sorted(named))
        result = replace(result, profiles=own, elapsed=time.monotonic() - begun)
    return as_stuck(result) if stuck else result


def _allowed(records: Sequence[Record], settings: GapSettings) -> float:
    """Return the time that a search may take, s."""
    seconds = sum(record.duration for record in records)
    return math.inf if settings.thorough else max(AT_LEAST, PER_SECOND * seconds)


def _selected(task: Task) -> tuple[SelectionState, bool]:
    """Return what was selected, and whether it is as far as a nuisance that is to be taken out first."""
    point, has_stops = first_look(task)
    state = _with_stop(task, point) if has_stops else None
    if state is not None:
        return state, task.chain_open and bool(nuisances_of(state.hypothesis))
    context, state = prepared(task, point, point.get("viscous_coefficient"), task.settings.longest)
    state = select(context, state)
    if task.chain_open and nuisances_of(state.hypothesis) and not context.late:
        return state, True
    return judge(context, state), False


def _numbers(records: Sequence[Record], base: Model, state: SelectionState, saturation: Saturation) -> Fitted:
    """Return the numbers of what was selected: of a fit of all data where that ends in the same minimum."""
    own = state.hypothesis
    # Clipped samples are left out by a selection, which the fit of all data does not do.
    if saturation.limits:
        return own.fitted
    found = final_fit(records, model_of(base, own.effects, own.point), state)
    if found is None:
        return own.fitted
    again = state.fitting.measured(replace(own, fitted=found))
    # The numbers of all data must not make the held-out error larger than the base's.
    grows = bool(own.effects) and state.fitting.nrmse(again) > state.fitting.nrmse(state.steps[0])
    return own.fitted if grows else found


def _judged(records: Sequence[Record], valve: Valve) -> tuple[list[str], bool]:
    """Return what is odd about ``records``, and whether both channels are of one valve."""
    warnings: list[str] = []
    trusted = True
    saturation = find_saturation(records[:3])
    for record in saturation.repaired:
        found, good = conditions.judge(record, valve)
        # Flat tops spoil the coherence of channels that belong together, and are told themselves.
        found = found if good or not saturation.limits else []
        warnings += [line for line in found if line not in warnings]
        trusted = trusted and (good or bool(saturation.limits))
    return warnings, trusted


def _parts(records: Sequence[Record]) -> list[Record]:
    return parts_of(records, LONGEST_LOOKED_AT)


def _with_stop(task: Task, point: Point) -> SelectionState | None:
    """Return what was selected with a stop, if hits are what is missing and that explains the motion.

    Through many hits a free run is judged over the pieces that it is fitted over.
    """
    context, state = prepared(task, point, point.get("viscous_coefficient"), task.settings.longest)
    found = select_with_stop(context, state, select)
    if found is None or found.fitting.nrmse(found.hypothesis) > THRESHOLDS.explains_nothing:
        return None
    return found
