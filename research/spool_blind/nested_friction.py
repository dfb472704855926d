"""Nested friction laws: how far one is from the Coulomb friction that it contains, the base refitted.

Where friction is small, its other laws are Coulomb friction to any record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .case import BlindCase, sample_times
from .condition import DELAY_TOLERANCE, GAIN_TOLERANCE
from .effects import EFFECTS
from .visibility import noncentrality

Array = NDArray[np.float64]

#: Steps for slopes and room, in units of ``_SIZES``, and runs of the fit.
STEP, ROOM, RUNS = 0.05, 200.0, 8
#: Sizes of stiffness and damping (relative), gain, delay (of their tolerances), force (of inertia).
_SIZES = np.array([0.002, 0.02, 0.05, 0.05, 0.02])


def contains_coulomb_friction(case: BlindCase) -> bool:
    """Return whether what is hidden is one law of friction that contains Coulomb friction."""
    return case.hidden in EFFECTS and EFFECTS[case.hidden].richer


def over_coulomb_friction(case: BlindCase) -> float:
    """Return the noncentrality of a test between ``case`` and Coulomb friction; base, gain, delay refitted.

    Raises:
        ValueError: what is hidden does not contain Coulomb friction.
    """
    if not contains_coulomb_friction(case):
        richer = ", ".join(name for name, kind in EFFECTS.items() if kind.richer)
        raise ValueError(f"{case.hidden} does not contain Coulomb friction; these do: {richer}")
    condition = case.condition
    force = condition.scale().force
    target = _reading(case, case.plant, case.channels.gain, case.channels.delay)
    known = condition.base.numbers

    def remainder(x: Array) -> Array:
        stiffness, damping, gain, delay, friction = (x - 1.0) * _SIZES
        numbers = {
            **known,
            "stiffness": known["stiffness"] * (1.0 + stiffness),
            "damping": known["damping"] * (1.0 + damping),
            "coulomb_force": friction * force,
        }
        gain = case.channels.gain + gain * GAIN_TOLERANCE
        return _reading(case, numbers, gain, case.channels.delay + delay * DELAY_TOLERANCE) - target

    within = 1.0 / _SIZES[2:4]
    found = least_squares(
        remainder,
        np.ones(5),
        bounds=(
            [1.0 - ROOM, 1.0 - 1.0 / _SIZES[1], *(1.0 - within), 1.0],
            [1.0 + ROOM, 1.0 + ROOM, *(1.0 + within), 1.0 + ROOM],
        ),
        diff_step=STEP,
        max_nfev=RUNS,
    )
    return noncentrality(remainder(found.x), known, condition.sample_rate, case.channels.noise)


def _reading(case: BlindCase, numbers: Mapping[str, float], gain: float, delay: float) -> Array:
    """Return the spool's channel without noise, m/s^2, shape (n,)."""
    condition = case.condition
    plant = replace(condition.base, numbers=numbers)
    channels = replace(case.channels, noise=0.0, gain=gain, delay=delay)
    return channels.read(condition.move(plant), sample_times(condition), np.random.default_rng(0))[1]
