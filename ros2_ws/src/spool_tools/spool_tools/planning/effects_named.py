"""Effects that a planned record would name: simulated at known shares, judged by the gap workflow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_gap.effect import Effect
from spool_gap.registry import EFFECTS
from spool_gap.registry import effect as find_effect
from spool_gap.workflow.analyse import analyse
from spool_sim.model import FLUID, Model, load_model
from spool_sim.terms import term

from .planned import Plan, travel

#: Shares of the spool's acceleration (rms) that an effect changes, from plain to just above the least share
#: that a verdict takes into account (0.0025, GapSettings.least_share).
SHARES = (0.2, 0.05, 0.0125)
#: What is tried where no effect is named: friction in two forms, drag, spring, stop.
USUAL = ("coulomb_friction", "stribeck_friction", "quadratic_damping", "cubic_stiffness", "end_stop")
#: Powers of 10 over a term's start values between which an amplitude is looked for, and halvings of it.
RANGE, HALVINGS = 5.0, 24


@dataclass(frozen=True, slots=True)
class Named:
    """What the gap workflow says of an effect that changes ``share`` of the spool's acceleration."""

    effect: str
    share: float
    parameters: Mapping[str, float]
    verdict: str
    confidence: float

    @property
    def right(self) -> bool:
        """Whether the verdict names the effect, and nothing else."""
        return self.verdict == self.effect


def named_effects(
    plan: Plan, effects: Sequence[str], tell: Callable[[str, float], None] = lambda _what, _share: None
) -> Iterator[Named]:
    """Yield for each effect what is said of it, at falling shares until it is not named any more.

    Raises:
        InputError: no such effect, or one that two accelerometers cannot be simulated with.
    """
    base = load_model("fluid")
    plain = plan.record(base, {}, noisy=False)
    for number, name in enumerate(effects):
        model, effect = _model(name), find_effect(name)
        for step, share in enumerate(SHARES):
            tell(name, (number + step / len(SHARES)) / len(effects))
            values = _values_for_share(plan, effect, model, plain, share)
            if values is None:
                continue
            result = analyse([plan.record(model, values)], plan.valve, base)
            one = Named(name, share, values, result.verdict, result.confidence)
            yield one
            if not one.right:
                break


def _model(name: str) -> Model:
    """Return the fluid model with the effect ``name``.

    Raises:
        InputError: no such effect, or one of the sensors, which is no force.
    """
    effect = find_effect(name)
    if not effect.terms or not effect.fitted:
        known = [one for one, entry in EFFECTS.items() if entry.terms and entry.fitted]
        raise InputError(f"--effect {name}: it is no force; use one of {', '.join(known)}")
    return Model(f"fluid_{name}", tuple(term(one) for one in dict.fromkeys((*FLUID, *effect.terms))))


def _values_for_share(
    plan: Plan, effect: Effect, model: Model, plain: Record, share: float
) -> dict[str, float] | None:
    """Return the effect's parameters where it changes ``share`` of the motion; ``None`` where none does."""
    starts = {name: model.parameter(name).start_for(plan.valve) for name in effect.fitted}
    reach = travel(plain)

    def values(power: float) -> dict[str, float]:
        if effect.id == "end_stop":
            # A stop is as large as its place: nearer stops change more.
            return {**starts, "stop_gap": reach * (1.0 - 1.0 / (1.0 + 10.0**-power))}
        scale = 10.0**power
        changed = {}
        for name, start in starts.items():
            limit = model.parameter(name)
            wanted = (start or 1.0) * scale if name in effect.amplitudes else start
            changed[name] = min(max(wanted, limit.low), limit.high)
        return changed

    def changes(power: float) -> float:
        record = plan.record(model, values(power), noisy=False)
        change = np.sqrt(np.mean((record.spool - plain.spool) ** 2) / np.mean(plain.spool**2))
        return float(change) if math.isfinite(change) else math.inf

    low, high = -RANGE, RANGE
    if changes(high) < share or changes(low) > share:
        return None
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if changes(middle) < share else (low, middle)
    return values(high)
