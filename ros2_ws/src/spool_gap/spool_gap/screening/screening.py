"""Screening of effects that are worth simulating, jointly with what is already accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from spool_gap.effect import Effect, Motion
from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import EFFECTS, FRICTIONS
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

from .regression import Balance, Screened
from .residual import foremost, screened_by_residual
from .spectral_lines import lines_beside_excitation

#: Forces that are simulated in each step, and effects of the measuring chain besides.
SIMULATED, OF_THE_CHAIN = 7, 2


def balance_of(stretches: Sequence[Stretch], values: Mapping[str, float]) -> Balance:
    """Return the regression over ``stretches`` whose noise is shaped by the base's numbers ``values``."""
    return Balance(stretches, values["mass"], values["spring_stiffness"], values["viscous_coefficient"])


def regression_candidates(
    stretches: Sequence[Stretch], catalogue: Sequence[Effect], step: Hypothesis
) -> list[Screened]:
    """Return what the regression says may be added to ``step``."""
    values = step.point.values
    balance = balance_of(stretches, values)
    effects = _addable(catalogue, step)
    peaks = lines_beside_excitation(stretches, values)
    rough = _screened(balance, effects, step, peaks)
    if not rough:
        return []
    balance.prepare([*step.trials.values(), rough[0].trial])
    balance.reweigh()
    return promising(_screened(balance, effects, step, peaks))


def residual_candidates(
    simulation: Simulation,
    stretches: Sequence[Stretch],
    catalogue: Sequence[Effect],
    step: Hypothesis,
    known: Sequence[Screened],
) -> list[Screened]:
    """Return what may be added to ``step`` and to ``known``, by what its free run leaves."""
    if not step.effects and known and known[0].gain > THRESHOLDS.screened_clearly:
        return []
    # In place of its friction a law comes by the regression alone.
    one_law = FRICTIONS & set(step.effects)
    others = [entry for entry in _addable(catalogue, step) if not (entry.id in FRICTIONS and one_law)]
    least = THRESHOLDS.screened_residual if step.effects else THRESHOLDS.screened_residual_alone
    names = {entry.effect.id for entry in known}
    found = screened_by_residual(simulation, step, others, _motion(stretches, step), least)
    return [entry for entry in found if entry.effect.id not in names]


def _addable(catalogue: Sequence[Effect], step: Hypothesis) -> list[Effect]:
    """Return the effects that ``step`` neither has nor contains."""
    contained = {name for entry in step.effects for name in (entry, *EFFECTS[entry].replaces)}
    return [entry for entry in catalogue if entry.id not in contained]


def _motion(stretches: Sequence[Stretch], step: Hypothesis) -> Motion:
    values = step.point.values
    return balance_of(stretches, values).joined(lines_beside_excitation(stretches, values))


def small_candidates(
    simulation: Simulation, stretches: Sequence[Stretch], catalogue: Sequence[Effect], step: Hypothesis
) -> list[Screened]:
    """Return what explains most of what the free run of ``step``, without effects, leaves."""
    motion = _motion(stretches, step)
    return screened_by_residual(simulation, step, catalogue, motion, THRESHOLDS.screened_small)


def _screened(
    balance: Balance, effects: Sequence[Effect], step: Hypothesis, peaks: tuple[float, ...]
) -> list[Screened]:
    """Return what the regression says about ``effects`` jointly with ``step``, or in place of its law."""
    own = [name for name in step.trials if name in FRICTIONS]
    others = [entry for entry in effects if not (own and entry.id in FRICTIONS)]
    balance.prepare([*step.trials.values()])
    found = balance.screen(others, peaks)
    if own:
        present = balance.squares
        balance.prepare([trial for name, trial in step.trials.items() if name not in own])
        gone = balance.squares - present
        instead = balance.screen([entry for entry in effects if entry.id in FRICTIONS], peaks)
        found += [replace(entry, gain=entry.gain - gone) for entry in instead]
    return sorted(found, key=lambda entry: -entry.gain)


def promising(screened: Sequence[Screened]) -> list[Screened]:
    """Return what is worth simulating: near the best by the regression, or confusable with it."""
    if not screened or screened[0].gain < THRESHOLDS.screened:
        return []
    best = screened[0]
    found = []
    for entry in screened:
        near = (
            entry.effect.id in best.effect.confusable_with or best.effect.id in entry.effect.confusable_with
        )
        share = THRESHOLDS.screened_confusable if near else THRESHOLDS.screened_near
        if entry.gain >= max(THRESHOLDS.screened, share * best.gain):
            found.append(entry)
    return foremost(found, SIMULATED, OF_THE_CHAIN)
