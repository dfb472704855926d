"""Refit of the selected model: its numbers by the offline fit of all data, so that both agree.

A selection fits half of the data, whose other half judges it; its deviations count the noise of the
samples alone. Once the effects are named, all data may say how large they are, by the least squares of
:func:`spool_estimator.identification.fit.fit`, whose deviations count coloured residuals, jumps between
samples and noise of the excitation, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity
from spool_estimator.identification.fit import fit, free_run_agreement
from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, Fit, FitSettings
from spool_estimator.identification.record import Record
from spool_sim.model import Model

from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.point import DELAY, GAIN

Array = NDArray[np.float64]

#: Names of the channel's numbers in a fit.
NAMES = {GAIN: SPOOL_GAIN, DELAY: SPOOL_DELAY}
#: Free-run error over that of the selection's own numbers, at most: a fit of more data leaves a little more
#: in the half that the selection was fitted to; one that leaves more than that found another minimum.
AS_GOOD = 1.05
#: Relative difference of spring and drag within one minimum: ten times what fits of half of the data differ
#: by where forces jump between samples (0.5 %).
SAME_MINIMUM = 0.05
#: Standard deviations from which a number differs from zero (95 %, normal).
SIGNIFICANT = 1.96


def final_fit(records: Sequence[Record], model: Model, state: SelectionState) -> Fitted | None:
    """Return the numbers of the selected ``model``, fitted to all of ``records``.

    Returns:
        ``None`` where the fit ends in another minimum, as it may through chaotic motion, or does not
        determine what the selection does, as by the start from rest.
    """
    final, valve = state.hypothesis, state.fitting.valve
    if final.point.sensors:
        return None
    own = {name: value for name, value in final.free_values.items() if name not in NAMES}
    settings = FitSettings(
        start=own,
        free=tuple(own),
        fit_gain=GAIN in final.free_values,
        fit_delay=DELAY in final.free_values,
    )
    found = fit(records, model, valve, settings)
    if found.reason is not None or not found.converged or found.agreement is None:
        return None
    sensor = {NAMES[name]: value for name, value in final.free_values.items() if name in NAMES}
    values = {**model.values_for(valve), **own}
    try:
        before = free_run_agreement(records, model, valve, values, sensor=sensor)
    except InputError:
        return None
    if not found.agreement.nrmse <= AS_GOOD * before.nrmse:
        return None
    numbers = _taken(found, final)
    return numbers if numbers is not None and _near(numbers, final.fitted) else None


def _taken(found: Fit, final: Hypothesis) -> Fitted | None:
    """Return what was fitted of ``final`` with the numbers of ``found``, if it determines all of them."""
    own = final.fitted
    named = {name for effect in final.effects for name in EFFECTS[effect].fitted}
    quantities = {
        free.name: replace(found.parameter(NAMES.get(free.name, free.name)), name=free.name)
        for free in own.free
    }
    if not all(_determined(q, own, q.name in named) for q in quantities.values()):
        return None
    return replace(
        own,
        point=own.point.moved(list(quantities), [q.value for q in quantities.values()]),
        deviations={**own.deviations, **{name: q.standard_deviation for name, q in quantities.items()}},
        correlation=_correlation(found, own),
    )


def _correlation(found: Fit, own: Fitted) -> Array:
    """Return the correlation of the numbers of ``own`` in the fit of all data; theirs where that has none."""
    correlation = own.correlation.copy()
    known = {name: place for place, name in enumerate(found.observable)}
    places = [known.get(NAMES.get(free.name, free.name)) for free in own.free]
    for row, first in enumerate(places):
        for column, second in enumerate(places):
            if first is not None and second is not None:
                correlation[row, column] = found.correlation[first, second]
    return correlation


def _determined(found: Quantity, own: Fitted, named: bool) -> bool:
    """Whether ``found`` is a number and, of a ``named`` effect, not zero where that of ``own`` is not."""
    if not (math.isfinite(found.value) and math.isfinite(found.standard_deviation)):
        return False
    differs = named and abs(own.point.get(found.name)) > SIGNIFICANT * own.deviations[found.name]
    return not differs or abs(found.value) > SIGNIFICANT * found.standard_deviation


def _near(numbers: Fitted, own: Fitted) -> bool:
    """Whether spring and drag are those of the selection, so that both fits ended in one minimum."""
    return all(
        abs(numbers.point.get(name) / own.point.get(name) - 1.0) < SAME_MINIMUM
        for name in ("spring_stiffness", "viscous_coefficient")
        if name in own.deviations and own.point.get(name)
    )
