"""Wording of results: sentences and hints that records of all kinds share."""

from __future__ import annotations

from collections.abc import Sequence

from spool_core.uncertainty import PLUS_MINUS, Quantity, percent, with_interval

from spool_gap.registry import EFFECTS
from spool_gap.result import Remainder

UNEXPLAINED = "unexplained"
#: What to look at.
CHECK_CLIPPING = "measuring range against the largest acceleration, amplifier setting"
CHECK_COLOURED = (
    "noise in the band of the motion that is louder than above it: cable and connector, 1/f noise of a MEMS "
    "sensor, vibration across its axis, which one axis cannot tell from noise"
)
#: What a remainder may be that is predictable from each of these.
LOOKS_LIKE = {
    "position": "a spring, a magnet or a stop that the catalogue does not describe",
    "speed": "friction or drag of another law",
    "position and speed": "flow forces, or friction that depends on the place",
    "the way since the last reversal": "hysteresis, as of friction before it slides",
    "time": "something that changes over the record: oil that warms, a sensor that drifts",
    "nothing": "noise that is louder than what the record shows above its excitation, or motion that "
    "parts from the model's at chance",
}


def nothing_missing(base: str, after: float, floor: float, of_what: str) -> str:
    """Return the sentence where nothing is missing in the model ``base``.

    Args:
        base: name of the model.
        after: error that it leaves on held-out data.
        floor: error that noise alone leaves.
        of_what: that is compared: "the spool's acceleration" or "the force".
    """
    return f"Nothing is missing: '{base}' leaves {percent(after)} of {of_what}, noise alone {percent(floor)}."


def named(
    effects: Sequence[tuple[str, Sequence[Quantity]]],
    before: float,
    after: float,
    floor: float,
    of_what: str,
) -> str:
    """Return the sentence where ``effects`` are missing, each with its numbers; the rest as above."""
    parts = []
    for name, numbers in effects:
        entry = EFFECTS[name]
        sizes = [
            f"{one.name} {with_interval(one.value, one.standard_deviation, one.unit)}" for one in numbers
        ]
        told = f"{', '.join(sizes)}; {PLUS_MINUS}"
        parts.append(f"{name.replace('_', ' ')} ({told}): {entry.on_the_machine}; check {entry.to_check}")
    return (
        f"The model lacks {'; and '.join(parts)}. With it the error falls from {percent(before)} to "
        f"{percent(after)} of {of_what} (noise alone: {percent(floor)})."
    )


def unnamed(
    base: str,
    candidates: Sequence[str],
    follows: str,
    before: float,
    after: float,
    floor: float,
    of_what: str,
) -> str:
    """Return the sentence where what is missing has no name.

    Args:
        base: name of the model.
        candidates: effects that come nearest.
        follows: what the remainder is a function of, or "nothing".
        before, after: error on held-out data of ``base`` and of the best model.
        floor: error that noise alone leaves.
        of_what: that is compared.
    """
    near = f"; nearest come {', '.join(candidates)}" if candidates else ""
    if follows != "nothing":
        near += f". What is left follows {follows}"
    return (
        f"Something is missing that has no name here: '{base}' leaves {percent(before)} of {of_what}, "
        f"the best of the catalogue {percent(after)}, noise would leave {percent(floor)}{near}."
    )


def still_missing(left: Remainder) -> str:
    """Return the sentence on the remainder beside names."""
    follows = "nothing predicts it" if left.function_of == "nothing" else f"it follows {left.function_of}"
    return (
        f"Something else is left, {left.over_noise_floor:.3g} times the noise's power and "
        f"{percent(left.share)} of the gap's; {follows}: {left.looks_like}."
    )
