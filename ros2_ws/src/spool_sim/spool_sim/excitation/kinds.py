"""Excitations of every kind, from mappings, YAML files and presets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator
from spool_core.errors import InputError
from spool_core.text import did_you_mean

from spool_sim.files.validation import NotNegative, Positive, one_line, read_mapping

from .base import Array, Excitation, rise
from .broadband import MachineOrders, Multisine
from .presets import PRESETS
from .recorded import Recorded
from .sines import Standstill, SteadySine, SteppedSine, SweptSine

__all__ = [
    "Excitation",
    "MachineOrders",
    "Multisine",
    "Part",
    "Recorded",
    "Sequence",
    "Standstill",
    "SteadySine",
    "SteppedSine",
    "SweptSine",
    "from_mapping",
    "load_excitation",
]

SingleExcitation = Annotated[
    Standstill | SteadySine | SteppedSine | SweptSine | Multisine | MachineOrders, Field(discriminator="kind")
]


class Part(BaseModel):
    """Part of a sequence.

    Attributes:
        duration: s.
        excitation: what acts; its own time starts with the stretch.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    duration: Positive
    excitation: SingleExcitation


class Sequence(Excitation):
    """Sequence of excitations one after the other, cross-faded so that nothing jumps.

    Attributes:
        parts: the stretches; the last one goes on when all are over, unless ``repeat``.
        fade: s around each border in which one fades out and the next fades in.
        repeat: start over after the last part.
    """

    kind: Literal["sequence"] = "sequence"
    parts: Annotated[tuple[Part, ...], Field(min_length=1, max_length=1000)]
    fade: NotNegative = 0.2
    repeat: bool = False

    @model_validator(mode="after")
    def _fade_fits(self) -> Sequence:
        shortest = min(part.duration for part in self.parts)
        if self.fade > shortest:
            raise ValueError(f"fade is longer than the shortest part ({shortest:g} s)")
        if self.repeat and len(self.parts) < 2:
            raise ValueError("repeat needs two parts or more")
        return self

    @property
    def duration(self) -> float:
        """Length of all parts, s."""
        return sum(part.duration for part in self.parts)

    @property
    def highest_frequency(self) -> float:
        """Highest of the parts, Hz."""
        return max(part.excitation.highest_frequency for part in self.parts)

    def _steady(self, t: Array) -> Array:
        total = np.zeros(t.shape)
        start = 0.0
        for number, part in enumerate(self.parts):
            first, last = number == 0, number == len(self.parts) - 1
            local, run = t - start, np.zeros(t.shape)
            if self.repeat:
                run = np.floor((local + 0.5 * (self.duration - part.duration)) / self.duration)
                local = local - run * self.duration
            weight = np.ones(t.shape) if first else self._ramp(local)
            if first and self.repeat:
                weight = np.where(run == 0.0, 1.0, self._ramp(local))
            if self.repeat or not last:
                weight = weight * (1.0 - self._ramp(local - part.duration))
            # Nothing has been before the first run.
            active = (weight > 0.0) & (run >= 0.0)
            if active.any():
                total[active] += weight[active] * part.excitation.acceleration(local[active])
            start += part.duration
        return total

    def _ramp(self, t: Array) -> Array:
        """Return the weight of what begins at t = 0: from 0 to 1 within fade / 2 on both sides."""
        if self.fade == 0.0:
            return np.asarray(t >= 0.0, dtype=np.float64)
        return rise(t + 0.5 * self.fade, self.fade)


AnyExcitation = Annotated[
    Standstill | SteadySine | SteppedSine | SweptSine | Multisine | MachineOrders | Sequence,
    Field(discriminator="kind"),
]
_ADAPTER: TypeAdapter[Excitation] = TypeAdapter(AnyExcitation)
KINDS: tuple[str, ...] = (
    "standstill", "steady_sine", "stepped_sine", "swept_sine", "multisine", "machine_orders", "sequence",
)  # fmt: skip


def from_mapping(mapping: Mapping[str, Any], where: str = "excitation") -> Excitation:
    """Return the excitation that ``mapping`` describes: its ``kind`` and that kind's fields.

    Raises:
        InputError: unknown kind or key, missing key, value out of range; ``where`` and the key are named.
    """
    kind = mapping.get("kind")
    if kind == "recorded":
        raise InputError(
            f"{where}: kind: 'recorded' needs a reader of records: use ./spool simulate --excitation with it"
        )
    if kind not in KINDS:
        given = "key is missing" if kind is None else f"unknown kind {kind!r}"
        raise InputError(f"{where}: kind: {given}; use one of {', '.join(KINDS)}")
    try:
        return _ADAPTER.validate_python(dict(mapping))
    except ValidationError as error:
        raise one_line(error, where) from None


def load_excitation(name_or_path: str | Path) -> Excitation:
    """Return a preset by its name, or the excitation that a YAML file describes.

    Raises:
        InputError: neither a preset nor a readable file with a valid excitation.
    """
    preset = PRESETS.get(str(name_or_path))
    if preset is not None:
        return preset
    path = Path(name_or_path)
    if not path.exists():
        raise InputError(
            f"{path}: no such excitation; give one of {', '.join(PRESETS)} or a YAML file"
            f"{did_you_mean(str(path), PRESETS)}"
        )
    return from_mapping(read_mapping(path, "excitation"), str(path))
