"""Settings of a fit, and its result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_core.uncertainty import Quantity
from spool_sim.observation import Observation

from spool_estimator.identification.determination import Determination

if TYPE_CHECKING:  # slow to load
    from spool_sim.model import Model

#: Nuisance parameters of the spool's measuring chain, by name.
SPOOL_GAIN, SPOOL_DELAY = "spool_gain", "spool_delay"
#: Numbers of the low-pass: corner over the sample rate, order, and the body's corner if that differs.
FILTER = ("filter_corner", "filter_order", "filter_corner_of_body", "filter_shape")
#: The parameter that scales all forces.
MASS = "mass"
#: Simulated steps of a fit: about a minute of computing. Fits of records that determine their parameters take
#: a tenth of it.
ALLOWED = 4e8

STOPPED_EARLY = (
    "the fit reached its limit of work and stopped early with the best result so far; fit a simpler model or "
    "a shorter part of the record"
)


def explains_nothing(what: str, error: float) -> tuple[str, ...]:
    """Return the warning that ``what`` leaves nearly all of the motion; empty where it does not."""
    if not error > LIMITS.explains_nothing:
        return ()
    return (
        f"{what} leaves {100.0 * error:.3g} % of the spool's acceleration: units of both channels, order and "
        "sign of the columns, valve file?",
    )


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How to fit.

    Attributes:
        held: parameters that are not fitted, with their values; the mass, and what else the valve's
            description gives but stiffness and viscous coefficient, is held without being named here.
        free: names of parameters that are fitted although they would be held.
        start: values to start from, by name; those of the record where not given.
        window: s, length of the stretches that are simulated in one piece.
        run_in: s at the beginning of each that do not count: the start is forgotten there.
        low_cut, high_cut: Hz, band in which model and record are compared.
        longest: s of data that are used at most, in windows spread evenly over the records.
        fit_gain: fit the relative gain error of the spool's sensor.
        fit_delay: fit the delay of the spool's sensor behind the body's, s.
        timing: standard deviation of the time between both channels, in samples; it enters the standard
            deviations. 0 where both are known to be sampled at one instant.
        starts: how many different starts are followed by simulation.
        noise_seconds: s of data on which the effect of the excitation's noise is simulated at most.
        check: judge what the records determine, and hold the rest at the values of model and valve.
        force_free: hold nothing that the records do not determine.
        allowed: simulated steps after which no further round of a descent begins.
    """

    held: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    window: float = 4.0
    run_in: float = 0.5
    low_cut: float = 3.0
    high_cut: float = 2000.0
    longest: float = 60.0
    fit_gain: bool = False
    fit_delay: bool = False
    timing: float = 0.01
    starts: int = 3
    noise_seconds: float = 15.0
    check: bool = False
    force_free: bool = False
    allowed: float = ALLOWED


@dataclass(frozen=True, slots=True)
class Agreement:
    """How the free run of a model agrees with records, weighing nothing.

    Attributes:
        nrmse: rms(model - measured) / rms(measured) of the spool acceleration, 1.
        objective: the paper's (33): squared errors over the squared uncertainty of the reading, summed, 1.
        frequencies: centres of the bands, Hz, shape (b,).
        amplitude_ratios: a_est / a_pom in each band, shape (b,); NaN where the record has no power.
        amplitude_ratio: its mean over 10 to 100 Hz; NaN where the record has no power there.
        residual_frequencies: Hz, shape (f,).
        residual_spectrum: power density of model - measured, (m/s^2)^2/Hz, shape (f,).
        seconds: of data compared.
        samples: how many.
    """

    nrmse: float
    objective: float
    frequencies: Array
    amplitude_ratios: Array
    amplitude_ratio: float
    residual_frequencies: Array
    residual_spectrum: Array
    seconds: float
    samples: int


@dataclass(frozen=True, slots=True)
class Fit:
    """A model fitted to records, or why that failed.

    Attributes:
        model: what was fitted.
        valve: id.
        reason: why there is no result, ``None`` where there is one.
        converged: the descent ended at a minimum; a result that is not converged is one to distrust.
        parameters: what was fitted, each with its standard deviation; value NaN and validity UNKNOWN where
            the records do not tell it (see ``not_observable``).
        not_observable: names of those.
        combinations: what the records tell of them instead, such as ``normal_load*mixed_root_coefficient``.
        held: parameters that were given, with their values.
        values: a full set to simulate with, held and free; of parameters that only act together it is one
            choice.
        sensor: gain error (1) and delay (s) of the spool's sensor, ``spool_gain`` and ``spool_delay``.
        observation: how both channels were read.
        correlation: of ``observable``, shape (p, p).
        observable: names of the rows of ``correlation``.
        at_bound: names of parameters that stopped at a bound.
        agreement: free run against the records that were fitted, ``None`` where there is no result.
        information_criterion: BIC of the residual with its spectrum, see :mod:`.residuals`; smaller is
            better.
        effective_samples: independent samples that the coloured residual is worth.
        determinations: judgement of each parameter, empty without ``FitSettings.check``.
        notes: what the fit changed of its settings, one line each.
        stopped_early: the fit reached its limit of work; it is the best that was found until then.
    """

    model: Model
    valve: str
    reason: str | None = None
    converged: bool = False
    parameters: tuple[Quantity, ...] = ()
    not_observable: tuple[str, ...] = ()
    combinations: tuple[Quantity, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    sensor: Mapping[str, float] = field(default_factory=dict)
    observation: Observation = field(default_factory=Observation)
    correlation: Array = field(default_factory=lambda: np.empty((0, 0)))
    observable: tuple[str, ...] = ()
    at_bound: tuple[str, ...] = ()
    agreement: Agreement | None = None
    information_criterion: float = math.nan
    effective_samples: float = math.nan
    determinations: tuple[Determination, ...] = ()
    notes: tuple[str, ...] = ()
    stopped_early: bool = False

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader should know, one line each."""
        notes = (*self.notes, STOPPED_EARLY) if self.stopped_early else self.notes
        if self.agreement is None:
            return notes
        return (*notes, *explains_nothing("the model", self.agreement.nrmse))

    def parameter(self, name: str) -> Quantity:
        """Return a fitted parameter or a combination by its name.

        Raises:
            KeyError: there is none of that name.
        """
        for quantity in (*self.parameters, *self.combinations):
            if quantity.name == name:
                return quantity
        raise KeyError(name)
