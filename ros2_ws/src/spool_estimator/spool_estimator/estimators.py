"""Estimators by name."""

from __future__ import annotations

from collections.abc import Callable

from spool_core.errors import InputError

from .equation_estimator import EquationEstimator
from .estimator import Estimator
from .stream_estimator import EstimatorSettings, StreamEstimator

#: By name: the model run in parallel with the machine; equation error with exponential forgetting.
ESTIMATORS: dict[str, Callable[[EstimatorSettings], StreamEstimator]] = {
    "prediction": Estimator,
    "equation": EquationEstimator,
}


def make_estimator(name: str, settings: EstimatorSettings) -> StreamEstimator:
    """Return a fresh estimator by its name.

    Raises:
        InputError: there is none of that name.
    """
    if name not in ESTIMATORS:
        raise InputError(f"estimator {name}: there is no such method; there are {', '.join(ESTIMATORS)}")
    return ESTIMATORS[name](settings)
