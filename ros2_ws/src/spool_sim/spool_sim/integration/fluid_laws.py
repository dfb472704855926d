"""Laws of the model ``fluid``, as :mod:`spool_sim.integration.composition` writes them."""

# Which law uses which argument differs from model to model.
# ruff: noqa: ARG001

from __future__ import annotations

import math

from spool_core.kernels.compiled import inner
from spool_core.numbers import Array

from spool_sim.terms.drag_and_pushes import viscous as force_law_2
from spool_sim.terms.springs import spring as force_law_1

EVENTS = False
MASS = 0


@inner
def given(parameters: Array, row: int) -> tuple[float, ...]:
    """Return the parameters that hold in ``row``."""
    return (parameters[row, 0], parameters[row, 1], parameters[row, 2])


@inner
def start_memory(state: Array) -> tuple[float, ...]:
    """Return the forces that the terms remember, N."""
    return (state[3],)


@inner
def smooth(z: float, v: float, t: float, x: tuple[float, ...], q: tuple[float, ...]) -> float:
    """Return the sum of the forces that are continuous in the motion, N."""
    return force_law_1(z, q[1]) + force_law_2(v, q[2])


@inner
def sliding(z: float, speed: float, s: float, q: tuple[float, ...]) -> float:
    """Return the sum of dry friction while slipping, N."""
    return 0.0


@inner
def rest(z: float, q: tuple[float, ...]) -> tuple[float, float]:
    """Return what dry friction can take up at rest, N."""
    low, high = 0.0, 0.0
    return low, high


@inner
def remembered(x: tuple[float, ...], slip: float, s: float, q: tuple[float, ...]) -> tuple[float, ...]:
    """Return the forces that the terms remember after slipping on by ``slip`` m, N."""
    return (x[0],)


@inner
def next_level(z0: float, z1: float, q: tuple[float, ...]) -> float:
    """Return the first kink between z0 and z1, m, or not a number."""
    return math.nan
