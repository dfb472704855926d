"""One friction force for each direction, where the start from rest shows that."""

from __future__ import annotations

import math
from dataclasses import replace

from spool_gap.result import Hypothesis
from spool_gap.simulation.start_from_rest import Asymmetry, asymmetry

from .hypothesis import Fitting, Step

ONE, TWO = "coulomb_friction", "asymmetric_friction"
#: Evidence that two forces need over one; standard deviations by which their ratio must differ from 0.
EVIDENCE, SIGNIFICANT = 25.0, 2.0
#: Ratio of half their difference to their mean from which they are two: less is within errors of the others.
LEAST = 0.1


def by_direction(fitting: Fitting, step: Step) -> tuple[Step, Hypothesis] | None:
    """Return ``step`` with two forces of friction, and its row of the ranking.

    ``None`` where the start does not show that, or the friction is another one.
    """
    if ONE not in step.effects:
        return None
    for stretch in fitting.stretches:
        found = asymmetry(fitting.simulation, stretch, step.fitted.point, fitting.base, fitting.valve)
        if found is None or found.evidence < EVIDENCE:
            continue
        if abs(found.ratio) < max(LEAST, SIGNIFICANT * found.deviation):
            continue
        better = fitting.measured(_with_two_forces(fitting, step, found))
        values = {name: better.fitted.point.values[name] for name in ("forward_force", "backward_force")}
        beside = step.effects[: step.effects.index(ONE)]
        return better, Hypothesis(TWO, beside, fitting.nrmse(better), found.evidence, values, True)
    return None


def _with_two_forces(fitting: Fitting, step: Step, found: Asymmetry) -> Step:
    effects = tuple(TWO if name == ONE else name for name in step.effects)
    old = step.fitted
    mean, spread = old.point.values["coulomb_force"], old.deviations["coulomb_force"]
    forces = {"forward_force": (1.0 + found.ratio) * mean, "backward_force": (1.0 - found.ratio) * mean}
    deviation = math.hypot(spread, mean * found.deviation)
    free = tuple(f for f in old.free if f.name != "coulomb_force")
    free += tuple(replace(f, name=name) for name in forces for f in old.free if f.name == "coulomb_force")
    values = {**old.point.values, **forces}
    fitted = replace(
        old,
        point=replace(old.point, active=fitting.terms_of(effects), values=values),
        free=free,
        deviations={**old.deviations, **dict.fromkeys(forces, deviation)},
    )
    return replace(step, effects=effects, fitted=fitted, train=[], held=[])
