"""A file of a result simulates to what was reported, or is refused with the number and the limit."""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_gap.catalogue import EFFECTS
from spool_report.fit_tables import AGREEMENT, save_model
from spool_rigs.balance import ForceBalance
from spool_rigs.position import model_of
from spool_rigs.records import ForceRecord
from spool_rigs.result import quantities_of
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, substeps_for
from spool_sim.model import MODELS, Model, load_model
from spool_sim.terms import term
from spool_sim.valve import find_valve

SOFT = find_valve("4weh10_soft")
PERIOD = 1e-3
TIME = PERIOD * np.arange(400)
FORCES = sorted(name for name, entry in EFFECTS.items() if entry.terms)
LIMIT = re.compile(r"not written.*(\w+: \S+ .*is out of range, use|'spring' must stand)")
#: Decades of forces (N) and travels (m): from a pilot valve to beyond a press.
DECADES = st.floats(-1.0, 7.0), st.floats(-4.0, -1.0)


def simulated(model: Model, values: dict[str, float]) -> Array | None:
    """Return the displacement, m, under a drive of 1 m/s^2, shape (n,); None where it cannot be stepped."""
    given = {one.name: float(values.get(one.name, one.start)) for one in model.parameters}
    try:
        substeps = substeps_for(model.terms, given, PERIOD)
    except InputError:
        return None
    kernel = ComposedMotion(model.terms)
    drive = np.sin(2.0 * np.pi * 15.0 * np.arange(2 * TIME.size * substeps + 1) * PERIOD / (2 * substeps))
    run, _ = kernel.advance(
        MotionState(), drive, kernel.table(given, TIME.size), sample_period=PERIOD, substeps=substeps
    )
    return run.displacement


def judged(model: Model, reported: list[Quantity], folder: str) -> None:
    """Save ``model`` and compare the file with ``reported``, or see that the refusal is right."""
    path = Path(folder) / "model.yaml"
    outside = [
        one for one in model.parameters if not one.low <= model.values.get(one.name, one.start) <= one.high
    ]
    unreadable = bool(outside) or "spring" not in {entry.name for entry in model.terms}
    if unreadable:
        event("refused")
        with pytest.raises(InputError, match=LIMIT):
            save_model(path, model, "saved", model.values, reported, "a test")
        assert not path.exists()
        return
    event("written")
    save_model(path, model, "saved", model.values, reported, "a test")
    own = {one.name for one in model.parameters}
    wanted = {**model.values, **{one.name: one.value for one in reported if one.name in own}}
    written = load_model(path)
    runs = simulated(model, wanted), simulated(written, dict(written.values))
    if runs[0] is None or runs[1] is None:
        assert runs[0] is runs[1]
        return
    assert np.allclose(*runs, rtol=AGREEMENT, atol=AGREEMENT * float(np.std(runs[0])), equal_nan=True)


@settings(max_examples=60)
@given(
    name=st.sampled_from(FORCES),
    kind=st.sampled_from(["imposed", "driven"]),
    base=st.sampled_from([("damping", "stiffness")] * 4 + [("damping",)]),
    force=DECADES[0],
    travel=DECADES[1],
    seed=st.integers(0, 2**32 - 1),
)
def test_a_saved_force_model_is_the_reported_one(
    name: str, kind: str, base: tuple[str, ...], force: float, travel: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    place = 10.0**travel * np.sin(
        2.0 * np.pi * np.array([[3.1], [7.7]]) * TIME + rng.uniform(0, 6, (2, 1))
    ).sum(0)
    record = ForceRecord("rig", 0.0, PERIOD, place, 10.0**force * rng.standard_normal(TIME.size))
    driven = kind == "driven"
    columns = [*base, *(["mass"] if driven else []), "zero"]
    balance = ForceBalance([record], [record], columns, driven=driven)
    entry = EFFECTS[name]
    motion = balance.motions[id(record)]
    shapes = entry.shapes(replace(motion, peaks=(47.0,)))
    shape = shapes[rng.integers(len(shapes))]
    fit = balance.fit([(entry, shape)])
    # As a record with these effects would be fitted: all signs, sizes of the record.
    numbers = np.abs(fit.coefficients) * np.where(rng.random(fit.coefficients.size) < 0.1, -1.0, 1.0)
    fit = replace(fit, coefficients=numbers)
    chosen = ((entry, shape),)
    if balance.values(entry, shape, fit) is None and not entry.load_cell_zero:
        event("implausible")
        return
    start = MODELS["fluid"] if "stiffness" in base else Model("axis", MODELS["fluid"].terms)
    model = model_of(start, balance, chosen, fit)
    with tempfile.TemporaryDirectory() as folder:
        judged(model, list(quantities_of(balance, fit, chosen)), folder)


@settings(max_examples=60)
@given(
    name=st.sampled_from(sorted(MODELS)),
    decades=st.lists(st.floats(-8.0, 8.0), min_size=12, max_size=12),
    unit=st.sampled_from([1.0, 1e-3, 1e3, 9.80665, 0.0254, 4448.2216152605]),
)
def test_a_saved_fit_is_the_reported_one(name: str, decades: list[float], unit: float) -> None:
    model = MODELS[name]
    values = {
        one.name: unit * (one.start or 1.0) * (1.0 if abs(decade) < 6.0 else 10.0**decade)
        for one, decade in zip(model.parameters, decades, strict=False)
    }
    reported = [
        Quantity(name, "1", value, 0.1 * abs(value), Validity.VALID) for name, value in values.items()
    ]
    with tempfile.TemporaryDirectory() as folder:
        judged(Model(name, model.terms, values), reported, folder)


@pytest.mark.parametrize("name", [name for name, effect in EFFECTS.items() if effect.terms])
def test_a_saved_model_is_read_back_as_it_was(name: str, tmp_path: Path) -> None:
    """Small numbers too: YAML reads 1e-05 as text."""
    terms = (*MODELS["fluid"].terms, *(term(entry) for entry in EFFECTS[name].terms))
    values = {
        parameter.name: min(max(parameter.low, parameter.start_for(SOFT) / 3.0), parameter.high)
        for parameter in Model("fluid", terms).parameters
    }
    file = tmp_path / "found.yaml"
    fitted = [Quantity("spring_stiffness", "N/m", values["spring_stiffness"], 0.5, Validity.VALID)]
    save_model(file, Model("fluid", terms, values), "fluid_gap", values, fitted, "two\nlines")
    read = load_model(file)
    assert dict(read.values) == values
    assert [entry.name for entry in read.terms] == [entry.name for entry in terms]
    assert read.values_for(SOFT) == values
