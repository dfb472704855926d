"""Runs: the free runs of one or two models beside what was measured, window by window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_estimator.identification.free_run import FreeRun, Window
from spool_estimator.identification.record import Record
from spool_sim.model import Model
from spool_sim.valve.description import Valve

Array = NDArray[np.float64]

#: s of data that are simulated at most, of a window, and Hz of the conditioning, as in the pictures of fits.
LONGEST, WINDOW, LOW_CUT = 60.0, 8.0, 3.0


@dataclass(frozen=True, slots=True)
class Numbers:
    """A model with its numbers, as one of the sides of a comparison.

    Attributes:
        name: how the reader knows it, e.g. ``base model``.
        model: the composition.
        values: a full set of its parameters.
        gain: relative gain error of the spool's channel, 1.
        delay: of the spool's channel behind the body's, s.
    """

    name: str
    model: Model
    values: Mapping[str, float] = field(default_factory=dict)
    gain: float = 0.0
    delay: float = 0.0

    @property
    def natural_frequency(self) -> float:
        """Of mass and spring, Hz; NaN without both."""
        mass, stiffness = self.values.get("mass", np.nan), self.values.get("spring_stiffness", np.nan)
        return float(np.sqrt(stiffness / mass) / (2.0 * np.pi)) if mass > 0.0 and stiffness > 0.0 else np.nan


@dataclass(frozen=True, slots=True)
class Runs:
    """Rows of samples without gaps, ``period`` s apart.

    Attributes:
        period: s.
        body: acceleration of the body, m/s^2.
        measured: of the spool, m/s^2.
        simulated: by the name of the numbers, m/s^2.
    """

    period: float
    body: tuple[Array, ...]
    measured: tuple[Array, ...]
    simulated: Mapping[str, tuple[Array, ...]]

    def residuals(self, name: str) -> tuple[Array, ...]:
        """Return measured - model of each window, m/s^2."""
        pairs = zip(self.measured, self.simulated[name], strict=True)
        return tuple(measured - simulated for measured, simulated in pairs)


def of_one_rate(records: Sequence[Record]) -> tuple[Record, ...]:
    """Return those of ``records`` that share the sample period of most of the data.

    Raises:
        InputError: there is none.
    """
    if not records:
        raise InputError("there is no stretch of the record without gaps")
    seconds: dict[float, float] = {}
    for entry in records:
        seconds[entry.sample_period] = seconds.get(entry.sample_period, 0.0) + entry.duration
    period = max(seconds, key=lambda one: seconds[one])
    return tuple(entry for entry in records if entry.sample_period == period)


def runs_of(records: Sequence[Record], valve: Valve, sides: Sequence[Numbers]) -> Runs:
    """Return the free runs of ``sides`` over ``records``, driven by the measured body alone.

    Raises:
        InputError: no record is long enough, or a model broke down.
    """
    rows = of_one_rate(records)
    simulated: dict[str, tuple[Array, ...]] = {}
    body: tuple[Array, ...] = ()
    measured: tuple[Array, ...] = ()
    for side in sides:
        run = FreeRun(rows, side.model, valve, window=WINDOW, low_cut=LOW_CUT, longest=LONGEST)
        run.choose_substeps(side.values)
        found = run.responses(run.sets(side.values), np.array([side.gain]), np.array([side.delay]))
        joined = _continued(run.windows)
        simulated[side.name] = tuple(
            np.concatenate([found[place].acceleration[0] for place in group]) for group in joined
        )
        if not all(np.isfinite(row).all() for row in simulated[side.name]):
            raise InputError(f"the free run of the {side.name} diverges")
        pieces = [(run.windows[group[0]], run.windows[group[-1]]) for group in joined]
        body, measured = (
            tuple(getattr(rows[first.record], name)[first.start : last.stop] for first, last in pieces)
            for name in ("body", "spool")
        )
    return Runs(rows[0].sample_period, body, measured, simulated)


def _continued(windows: Sequence[Window]) -> list[list[int]]:
    """Return the numbers of ``windows`` in groups that follow one another without a gap.

    A sweep passes each frequency once: averages over pieces must not leave out where two windows meet.
    """
    groups: list[list[int]] = []
    for place, window in enumerate(windows):
        before = windows[place - 1] if place else None
        if before is not None and before.record == window.record and before.stop == window.start:
            groups[-1].append(place)
        else:
            groups.append([place])
    return groups
