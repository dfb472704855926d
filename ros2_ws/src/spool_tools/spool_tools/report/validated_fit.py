"""Validated fit: a model fitted to data and validated on what was held out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from spool_core.errors import InputError
from spool_estimator.identification.agreement import free_run_agreement
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import Agreement, Fit, FitSettings
from spool_sim.model import Model

from spool_tools.input.fit_data import FitData

#: How many times a descent that has not converged goes on.
ROUNDS = 2


@dataclass(frozen=True, slots=True)
class ValidatedFit:
    """Fit, and how it does on data that it has not seen, ``None`` where there are none."""

    data: FitData
    fit: Fit
    held_out: Agreement | None

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.fit.model.name

    @property
    def training_error(self) -> float:
        """Nrmse on the fitted data, NaN without a result."""
        return math.nan if self.fit.agreement is None else self.fit.agreement.nrmse

    @property
    def held_out_error(self) -> float:
        """Nrmse on held-out data, NaN without any."""
        return math.nan if self.held_out is None else self.held_out.nrmse


def fit_and_validate(data: FitData, model: Model, settings: FitSettings) -> ValidatedFit:
    """Return ``model`` fitted to the data and its agreement with what was held out.

    Raises:
        InputError: the settings do not fit the model.
    """
    found = _converged(data, model, settings)
    if found.agreement is None or not data.held_out:
        return ValidatedFit(data, found, None)
    try:
        held_out = free_run_agreement(
            data.held_out, model, data.valve, found.values, sensor=found.sensor, run_in=settings.run_in,
            low_cut=settings.low_cut, compensate_oil=settings.compensate_oil,
        )  # fmt: skip
    except InputError:  # every held-out stretch is shorter than what settling takes
        return ValidatedFit(data, found, None)
    return ValidatedFit(data, found, held_out)


def _converged(data: FitData, model: Model, settings: FitSettings) -> Fit:
    """Return a fit that goes on from where it stopped until it converges, ``ROUNDS`` times at most."""
    found = fit(data.fitted, model, data.valve, settings)
    for _ in range(ROUNDS):
        if found.converged or found.reason is not None:
            break
        # Bounds are of the model: what is fitted lies within them.
        reached = {name: value for name, value in found.values.items() if name not in found.held}
        further = fit(data.fitted, model, data.valve, replace(settings, start=reached, starts=1))
        if further.agreement is None:
            break
        found = further
    return found


def natural_frequency(found: Fit) -> float:
    """Return the undamped natural frequency, Hz, NaN where the stiffness is not known."""
    mass, stiffness = found.values.get("mass", math.nan), found.values.get("spring_stiffness", math.nan)
    if found.reason is not None or "spring_stiffness" in found.not_observable:
        return math.nan
    return math.sqrt(stiffness / mass) / (2.0 * math.pi)


def damping_ratio(found: Fit) -> float:
    """Return the share of critical damping of the viscous drag alone, NaN where it is not known."""
    drag = found.values.get("viscous_coefficient", math.nan)
    frequency = natural_frequency(found)
    if "viscous_coefficient" in found.not_observable or not frequency > 0.0:
        return math.nan
    return drag / (4.0 * math.pi * frequency * found.values["mass"])
