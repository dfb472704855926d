"""Which effects are worth simulating: what the regression says of each, beside what is already accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from spool_gap.effect import Effect
from spool_gap.fitting.hypothesis import Step
from spool_gap.registry import EFFECTS
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.simulate import Simulation

from .regression import Balance, Screened
from .spectral_lines import lines_beside_the_drive
from .unexplained import screen_left_over

#: Fall of the weighed sum of squares by the regression from which an effect is simulated, and by the answer
#: of the base to it beside other effects, or where the regression finds less than ``CLEAR``.
SCREENED, LEFT, LEFT_ALONE = 25.0, 25.0, 5.0
CLEAR = 300.0
#: The same over all windows.
LEFT_SMALL = 15.0
#: Hypotheses that are simulated in each step.
SIMULATED = 7
#: Share of the best one's fall that another one needs, and where the two are easily confused.
NEAR, CONFUSED = 0.25, 0.05
#: Laws of dry friction: of these a machine has one.
FRICTIONS = frozenset(name for name in EFFECTS if name.endswith("_friction"))


def balance_of(stretches: Sequence[Stretch], values: Mapping[str, float]) -> Balance:
    """Return the regression over ``stretches`` whose noise is shaped by the base's numbers ``values``."""
    return Balance(stretches, values["mass"], values["spring_stiffness"], values["viscous_coefficient"])


def candidates(
    simulation: Simulation, stretches: Sequence[Stretch], catalogue: Sequence[Effect], step: Step
) -> list[Screened]:
    """Return what may be added to ``step``: by the regression, and by what its free run leaves."""
    values = step.fitted.point.values
    balance = balance_of(stretches, values)
    contained = {name for entry in step.effects for name in (entry, *EFFECTS[entry].replaces)}
    effects = [entry for entry in catalogue if entry.id not in contained]
    peaks = lines_beside_the_drive(stretches, values)
    rough = _screened(balance, effects, step, peaks)
    found: list[Screened] = []
    if rough:
        balance.prepare([*step.trials.values(), rough[0].trial])
        balance.reweigh()
        found = promising(_screened(balance, effects, step, peaks))
    if not step.effects and found and found[0].gain > CLEAR:
        return found
    known = {entry.effect.id for entry in found}
    # In place of its friction a law comes by the regression alone.
    others = [entry for entry in effects if not (entry.id in FRICTIONS and FRICTIONS & set(step.effects))]
    left = screen_left_over(
        simulation, step, others, balance.joined(peaks), LEFT if step.effects else LEFT_ALONE
    )
    return found + [entry for entry in left if entry.effect.id not in known]


def overlooked(
    stretches: Sequence[Stretch], catalogue: Sequence[Effect], step: Step, known: Sequence[Screened]
) -> list[Screened]:
    """Return what the regression sees beside ``known``, of which none helps, if runs may part with it."""
    values = step.fitted.point.values
    balance = balance_of(stretches, values)
    peaks = lines_beside_the_drive(stretches, values)
    names = {*step.effects, *(entry.effect.id for entry in known)}
    effects = [entry for entry in catalogue if entry.id not in names and (entry.valleys or entry.rare)]
    balance.prepare([*step.trials.values(), *(entry.trial for entry in known[:1])])
    balance.reweigh()
    return [entry for entry in _screened(balance, effects, step, peaks) if entry.gain > SCREENED]


def small_candidates(
    simulation: Simulation, stretches: Sequence[Stretch], catalogue: Sequence[Effect], step: Step
) -> list[Screened]:
    """Return what explains most of what the free run of ``step``, without effects, leaves."""
    values = step.fitted.point.values
    motion = balance_of(stretches, values).joined(lines_beside_the_drive(stretches, values))
    return screen_left_over(simulation, step, catalogue, motion, LEFT_SMALL)


def _screened(
    balance: Balance, effects: Sequence[Effect], step: Step, peaks: tuple[float, ...]
) -> list[Screened]:
    """Return what the regression says about ``effects`` beside ``step``, or in place of its friction."""
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
    """Return what is worth simulating: near the best by the regression, or confused with it."""
    if not screened or screened[0].gain < SCREENED:
        return []
    best = screened[0]
    found = []
    for entry in screened:
        near = entry.effect.id in best.effect.confused_with or best.effect.id in entry.effect.confused_with
        if entry.gain >= max(SCREENED, (CONFUSED if near else NEAR) * best.gain):
            found.append(entry)
    return found[:SIMULATED]
