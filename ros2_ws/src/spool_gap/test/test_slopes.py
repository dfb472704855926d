"""Predictions that come with their slopes are those of the stepping kernel, and so are their changes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_gap.catalogue import EFFECTS
from spool_gap.likelihood.kernel import Point, SwitchableMotion, motions_for, steps_a_sample
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import Correction, half_step_times
from spool_sim.model import MODELS
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
FLUID = MODELS["fluid"]
BASE = tuple(entry.name for entry in FLUID.terms)
RATE, SAMPLES = 2000.0, 8000
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=90.0, duration=4.0, amplitude=12.0)
FREE_RUN = Correction(0.0, 0.0, 1e9)
#: Values at which each effect moves the valve well within the sweep; what is not named starts as declared.
#: A preload of 2 N would make the motion so sensitive that differences of two steps do not agree themselves.
VALUES = {
    "stop_gap": 1e-3,
    "stop_stiffness": 2e4,
    "backlash": 2e-4,
    "preload_force": 0.5,
    "preload_travel": 1e-4,
    "cubic_stiffness": 1e8,
}
TERMS = tuple(
    dict.fromkeys(
        name for one in EFFECTS.values() for name in one.terms if "memory_law" not in term(name).laws
    )
)


def run(
    motion: SwitchableMotion, active: tuple[str, ...], values: Mapping[str, float], step: float, finer: int
) -> tuple[list[str], Array, Array, Array, Array]:
    """Return the numbers of a pass, its errors less finer ones, velocity, slopes and differences."""
    names = list(dict.fromkeys(p.name for name in active for p in term(name).parameters if p.name != "mass"))
    names = [name for name in names if values[name] != 0.0]
    substeps = finer // 4
    moved = [[{**values, name: values[name] * (1.0 + side * step)} for name in names] for side in (1, -1)]
    row = motion.row(active, values)
    none = np.full(len(names), -1)
    heard, measured = np.ones(SAMPLES), np.zeros(SAMPLES)
    given_ = {"correction": FREE_RUN, "sample_period": 1.0 / RATE, "means": False}
    errors, _, velocity, slopes = motion.predict_with_slopes(
        SWEEP.acceleration(half_step_times(0, SAMPLES, RATE, substeps)), measured, heard,
        np.array([row, *(motion.row(active, one) for one in moved[0])]),
        forced=(np.zeros((1, 2 * SAMPLES * substeps + 1)), none), shifted=(np.zeros((1, SAMPLES)), none),
        substeps=substeps, **given_,
    )  # fmt: skip
    sets = np.array([row, *(motion.row(active, one) for side in moved for one in side)])
    rows = np.zeros(len(sets), dtype=np.int64)
    found, _, _ = motion.predict_batch(
        SWEEP.acceleration(half_step_times(0, SAMPLES, RATE, finer))[np.newaxis], measured[np.newaxis], heard,
        sets, rows=(rows, rows), substeps=finer, **given_,
    )  # fmt: skip
    count = len(names)
    differences = 0.5 * (found[1 : count + 1] - found[count + 1 :])
    return names, errors - found[0], velocity, slopes, differences


def kept(velocity: Array, rows: Array) -> Array:
    """Return which samples lie away from reversals, where no force jumps, and hold no outlier of ``rows``."""
    slow = 0.06 * np.quantile(np.abs(velocity), 0.8)
    away = np.convolve(np.abs(velocity) < slow, np.ones(3), mode="same") < 0.5
    return np.asarray(away & (np.abs(rows) <= np.quantile(np.abs(rows[away]), 0.99)))


def judge(active: tuple[str, ...], values: Mapping[str, float]) -> dict[str, float]:
    """Check the prediction; return the share of each slope by differences that the slope of the pass is."""
    motion = next(one for one in motions_for(FLUID) if one.has(active))
    substeps = steps_a_sample(Point(active, values), 1.0 / RATE, 100.0)
    names, off, velocity, slopes, differences = run(motion, active, values, 1e-4, 4 * substeps)
    away = kept(velocity, np.zeros(SAMPLES))
    signal = float(SWEEP.acceleration(half_step_times(0, SAMPLES, RATE, 1)).std())
    assert float(np.sqrt(np.mean(off[away] ** 2))) < 1e-3 * signal
    shares = {}
    for name, slope, difference in zip(names, slopes, differences, strict=True):
        inside = kept(velocity, difference)
        power = float(difference[inside] @ difference[inside])
        if power > 0.0:
            shares[name] = float(difference[inside] @ slope[inside]) / power
    return shares


@pytest.mark.parametrize("extra", TERMS)
def test_slopes_of_each_law_are_those_of_the_stepping_kernel(extra: str) -> None:
    active = (*BASE, extra)
    values = {p.name: p.start for name in active for p in term(name).parameters}
    values |= {**FLUID.values_for(VALVE), **{name: v for name, v in VALUES.items() if name in values}}
    shares = judge(active, values)
    print(extra, {name: round(share, 4) for name, share in shares.items()})
    assert {"spring_stiffness", "viscous_coefficient"} <= shares.keys()
    assert all(abs(share - 1.0) < 0.02 for share in shares.values())


def test_slopes_of_drawn_structures_are_those_of_the_stepping_kernel(structures: int) -> None:
    random, off = np.random.default_rng(5), []
    for _ in range(structures):
        active = (*BASE, *random.choice(TERMS, int(random.integers(1, 3)), replace=False).tolist())
        values = {p.name: p.start for name in active for p in term(name).parameters}
        values |= {**FLUID.values_for(VALVE), **{name: v for name, v in VALUES.items() if name in values}}
        values |= {name: v * float(random.uniform(0.7, 1.4)) for name, v in values.items() if name != "mass"}
        off += [abs(share - 1.0) for share in judge(active, values).values()]
    print(f"{len(off)} slopes of {structures} structures: median {np.median(off):.1e}, worst {max(off):.1e}")
    assert np.median(off) < 0.005
    assert np.mean(np.array(off) < 0.01) > 0.9


@pytest.fixture(name="structures", params=[6, pytest.param(200, marks=pytest.mark.slow)])
def _structures(request: pytest.FixtureRequest) -> int:
    return int(request.param)
