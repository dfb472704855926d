"""Sentence of the verdict: what is missing, how big, what it means, what to check."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from spool_core.uncertainty import PLUS_MINUS, Quantity, percent, with_interval

from spool_gap.fitting.descent import Fitted
from spool_gap.registry import EFFECTS
from spool_gap.result import Remainder
from spool_gap.selection.state import SelectionState
from spool_gap.thresholds import THRESHOLDS

from .residual import FinalResidual

#: Why a hypothesis of the ranking is not part of the verdict: see ``refused_for_growth``.
GROWS = "the error on held-out data rises with it"


def missing_nothing(state: SelectionState, noise_floor: float) -> str:
    """Return the sentence where nothing is missing."""
    _, after = _errors(state)
    return (
        f"Nothing is missing: '{state.fitting.base.name}' leaves {percent(after)} of the spool's "
        f"acceleration, noise alone {percent(noise_floor)}."
    )


def unnamed(state: SelectionState, residue: FinalResidual, candidates: tuple[str, ...]) -> str:
    """Return the sentence where what is missing has no name."""
    before, after = _errors(state)
    base, rest = state.fitting.base.name, residue.remainder
    near = f"; nearest come {', '.join(candidates)}" if candidates else ""
    if rest.share > THRESHOLDS.predictable:
        near += f". What is left follows {rest.follows}: {100.0 * rest.share:.0f} % of it is predictable"
    return (
        f"Something is missing that has no name here: '{base}' leaves {percent(before)} of "
        f"the spool's acceleration, the best of the catalogue {percent(after)}, "
        f"noise would leave {percent(residue.floor.nrmse)}{near}."
    )


def named(
    state: SelectionState,
    numbers: Fitted,
    effects: tuple[str, ...],
    extra: Mapping[str, Quantity],
    noise_floor: float,
) -> str:
    """Return the sentence where ``effects`` are missing, with ``extra`` numbers of the channels."""
    before, after = _errors(state)
    parts = []
    for name in effects:
        entry = EFFECTS[name]
        known = [own for own in entry.fitted if own in extra or own in numbers.deviations]
        sizes = [_number(numbers, parameter, extra) for parameter in known]
        told = f"{', '.join(sizes)}; {PLUS_MINUS}"
        parts.append(f"{name.replace('_', ' ')} ({told}): {entry.on_the_machine}; check {entry.to_check}")
    return (
        f"The model lacks {'; and '.join(parts)}. With it the error falls from {percent(before)} to "
        f"{percent(after)} of the spool's acceleration (noise alone: {percent(noise_floor)})."
    )


def still_missing(left: Remainder) -> str:
    """Return the sentence on what is left where something is named."""
    follows = "nothing predicts it" if left.function_of == "nothing" else f"it follows {left.function_of}"
    return (
        f"Something else is left, {left.over_noise_floor:.3g} times the noise's power and "
        f"{percent(left.share)} of the gap's; {follows}: {left.looks_like}."
    )


def refused_for_growth(names: Sequence[str], before: float, after: float) -> str:
    """Return the sentence on effects ``names`` with which the held-out error grows."""
    told = " and ".join(name.replace("_", " ") for name in names)
    return (
        f"Refused: {told}; on held-out data the error rises with it, from {percent(before, 3)} to "
        f"{percent(after, 3)}."
    )


def _number(numbers: Fitted, parameter: str, extra: Mapping[str, Quantity]) -> str:
    known = extra.get(parameter)
    if known is not None:
        return f"{parameter} {with_interval(known.value, known.standard_deviation, known.unit)}"
    point, spread = numbers.point, numbers.deviations.get(parameter, math.nan)
    return f"{parameter} {with_interval(point.get(parameter), spread, point.unit(parameter))}"


def _errors(state: SelectionState) -> tuple[float, float]:
    """Return the held-out error of the base and of what was accepted."""
    return state.fitting.nrmse(state.steps[0]), state.fitting.nrmse(state.hypothesis)
