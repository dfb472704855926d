from __future__ import annotations

import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.terms import TERMS, Parameter, Term
from spool_sim.valve import Valve

FRICTION = [entry for entry in TERMS.values() if entry.dissipates]
ODD = [entry for entry in TERMS.values() if entry.odd and "memory_law" not in entry.laws]


@cache
def units() -> Any:
    import pint  # noqa: PLC0415 - slow to load

    return pint.UnitRegistry()


@cache
def exponents(unit: str) -> tuple[float, float, float]:
    """Return the exponents of kg, m and s in a unit that a parameter may have."""
    if unit.startswith("sqrt("):
        mass, length, time = exponents(unit[5:-1])
        return 0.5 * mass, 0.5 * length, 0.5 * time
    dimensions = units().parse_expression(unit).dimensionality if unit != "1" else {}
    assert set(dimensions) <= {"[mass]", "[length]", "[time]"}
    mass, length, time = (float(dimensions.get(name, 0)) for name in ("[mass]", "[length]", "[time]"))
    return mass, length, time


def value_of(draw: st.DrawFn, parameter: Parameter) -> float:
    low = max(parameter.low, -1e3 * max(abs(parameter.start), 1e-3))
    high = min(parameter.high, 1e3 * max(abs(parameter.start), 1e-3))
    return draw(st.floats(low, high, allow_nan=False))


@st.composite
def term_and_values(draw: st.DrawFn, entries: list[Term]) -> tuple[Term, dict[str, float]]:
    entry = draw(st.sampled_from(entries))
    parameters = list(entry.parameters)
    if entry.dissipates_with is not None:
        parameters += TERMS[entry.dissipates_with].parameters
    return entry, {parameter.name: value_of(draw, parameter) for parameter in parameters}


def at(entry: Term, values: dict[str, float], z: float, v: float, t: float) -> float:
    one = np.ones(1)
    return float(entry.force(z * one, v * one, 0.0 * one, values, t * one)[0])


def in_excess(entry: Term, values: dict[str, float]) -> dict[str, float]:
    """Let the static force be the larger one, as every law of mixed lubrication has it."""
    for low, high in (
        ("coulomb_force", "static_force"),
        ("hess_soom_minimum", "hess_soom_static"),
        ("pavelescu_minimum", "pavelescu_static"),
    ):
        if low in values and high in values:
            values[low], values[high] = sorted((values[low], values[high]))
    return values


@settings(max_examples=400, deadline=None)
@given(term_and_values(FRICTION), st.floats(-5e-3, 5e-3), st.floats(-2.0, 2.0), st.floats(0.0, 600.0))
def test_friction_opposes_the_motion_and_dissipates(
    case: tuple[Term, dict[str, float]], z: float, v: float, t: float
) -> None:
    entry, values = case
    if entry.name == "coulomb_hydrodynamic_friction":
        values["film_drag"] = values["viscous_coefficient"]
    force = at(entry, values, z, v, t)
    scale = abs(force)
    if entry.dissipates_with is not None:
        company = at(TERMS[entry.dissipates_with], values, z, v, t)
        scale += abs(company)
        force += company
    assert math.isfinite(force)
    assert force * v >= -1e-12 * scale * abs(v)


def moved(entry: Term) -> list[tuple[float, float]]:
    """Return velocity and force of a term with its start values, over motions drawn at random."""
    draw = np.random.default_rng(7)
    values = {one.name: one.start or min(1.0, one.high) for one in entry.parameters}
    return [
        (v, at(entry, values, draw.uniform(-5e-3, 5e-3), v, draw.uniform(0.0, 600.0)))
        for v in draw.uniform(-2.0, 2.0, 200).tolist()
    ]


MOVING = [entry for entry in TERMS.values() if not {"memory_law", "inertia_law"} & set(entry.laws)]


@pytest.mark.parametrize("entry", MOVING, ids=lambda entry: entry.name)
def test_a_force_that_always_opposes_the_motion_says_that_it_dissipates(entry: Term) -> None:
    works = [force * v for v, force in moved(entry)]
    opposes = min(works) >= 0.0 and max(works) > 0.0
    assert entry.dissipates or not opposes


@pytest.mark.parametrize("entry", MOVING, ids=lambda entry: entry.name)
def test_the_law_as_text_names_what_the_force_depends_on(entry: Term) -> None:
    """z and its derivative z', and the time t; friction at rest is no force of the motion."""
    values = {one.name: one.start or min(1.0, one.high) for one in entry.parameters}
    draw = np.random.default_rng(7)
    changes = {"z": False, "z'": False, "t": False}
    for z, v, t, other in draw.uniform((-5e-3, -2.0, 0.0, 0.1), (5e-3, 2.0, 600.0, 2.0), (200, 4)).tolist():
        before = at(entry, values, z, v, t)
        changes["z"] |= at(entry, values, -other * z, v, t) != before
        changes["z'"] |= at(entry, values, z, -other * v, t) != before
        changes["t"] |= at(entry, values, z, v, other * t) != before
    text = entry.law.partition(":")[0]
    named = {
        "z": re.search(r"\bz\b(?!')", text) is not None,
        "z'": "'" in text,
        "t": re.search(r"(?<![\^\w])t\b", text) is not None,
    }
    assert named == changes


@settings(max_examples=300, deadline=None)
@given(term_and_values(ODD), st.floats(-5e-3, 5e-3), st.floats(-2.0, 2.0), st.floats(0.0, 600.0))
def test_laws_are_odd_where_they_should_be(
    case: tuple[Term, dict[str, float]], z: float, v: float, t: float
) -> None:
    entry, values = case
    if entry.name == "inertia":
        return
    force = at(entry, values, z, v, t)
    assert at(entry, values, -z, -v, t) == pytest.approx(-force, rel=1e-9, abs=1e-300)


@settings(max_examples=200, deadline=None)
@given(
    term_and_values([entry for entry in TERMS.values() if "sliding_law" in entry.laws]), st.floats(0.0, 2.0)
)
def test_friction_at_rest_can_take_up_what_it_takes_to_slip(
    case: tuple[Term, dict[str, float]], speed: float
) -> None:
    entry, values = case
    values = in_excess(entry, values)
    low, high = entry.at_rest(0.0, values)
    assert low <= 0.0 <= high
    slipping = entry.uncompiled("sliding_law")
    assert slipping is not None
    given_values = [values[parameter.name] for parameter in entry.parameters]
    assert slipping(0.0, 0.0, 1.0, *given_values) <= high * (1.0 + 1e-12)
    assert slipping(0.0, 0.0, -1.0, *given_values) <= -low * (1.0 + 1e-12)
    if entry.name != "mixed_friction":  # whose drag part rises with speed
        assert slipping(0.0, speed, 1.0, *given_values) <= high * (1.0 + 1e-12) + 1e-300


@settings(max_examples=300, deadline=None)
@given(
    term_and_values(list(TERMS.values())),
    st.floats(-5e-3, 5e-3, allow_subnormal=False),
    st.floats(-2.0, 2.0, allow_subnormal=False),
    st.floats(0.0, 5.0, allow_subnormal=False),
    st.tuples(*[st.sampled_from((0.25, 0.5, 2.0, 8.0))] * 3),
)
def test_every_law_gives_newtons_whatever_the_units_of_length_time_and_mass(
    case: tuple[Term, dict[str, float]], z: float, v: float, t: float, units: tuple[float, float, float]
) -> None:
    entry, values = case
    kilogram, metre, second = units

    def scaled(value: float, unit: str) -> float:
        mass, length, time = exponents(unit)
        return float(value * kilogram**mass * metre**length * second**time)

    other = {p.name: scaled(values[p.name], p.unit) for p in entry.parameters}
    ones = np.ones(2)
    steps = np.array([0.0, 1.0])
    force = entry.force(z * steps, v * ones, v * ones, values, t * ones)[-1]
    again = entry.force(
        scaled(z, "m") * steps,
        scaled(v, "m/s") * ones,
        scaled(v, "m") / second**2 * ones,
        other,
        t * second * ones,
    )[-1]
    assert again == pytest.approx(scaled(force, "N"), rel=1e-6, abs=1e-9 * abs(scaled(force, "N")) + 1e-250)


@pytest.mark.parametrize("entry", TERMS.values(), ids=TERMS.keys())
def test_every_term_tells_about_itself_and_refuses_what_is_out_of_range(entry: Term, valve: Valve) -> None:
    for text in (entry.name, entry.law, entry.source, entry.meaning, entry.check):
        assert text.strip()
    for parameter in entry.parameters:
        assert parameter.meaning
        assert parameter.low <= parameter.start <= parameter.high
        assert exponents(parameter.unit)
        assert parameter.low <= parameter.start_for(valve) <= parameter.high
        names = ["inertia", "spring", *({entry.name} - {"inertia", "spring"})]
        for value in (parameter.low - max(1.0, abs(parameter.low)), 2.0 * parameter.high + 1.0):
            with pytest.raises(InputError) as refused:
                model_from_mapping({"name": "mine", "terms": names, "parameters": {parameter.name: value}})
            assert parameter.name in str(refused.value)
            assert f"{value:g} {parameter.unit} is out of range" in str(refused.value)
            assert f"{parameter.low:g} to {parameter.high:g}" in str(refused.value)


def test_a_law_that_takes_what_it_cannot_get_is_refused_by_name() -> None:
    def pull(z: float, magnet_pul: float) -> float:
        return magnet_pul * z

    texts = dict.fromkeys(("law", "source", "meaning", "check"), "for the test")
    own = (Parameter("magnet_pull", "N/m", 0.0, 10.0, 1.0, "pull"),)
    with pytest.raises(
        TypeError, match=r"magnet.force_law: takes magnet_pul, known are z, v, t, magnet_pull"
    ):
        Term(name="magnet", parameters=own, force_law=pull, **texts)


def test_a_class_derived_from_term_is_refused_with_what_to_write() -> None:
    with pytest.raises(TypeError, match=r"Magnet derives from Term: declare Term\(name=\.\.\., "):
        type("Magnet", (Term,), {})


def test_the_paper_s_models_are_compositions_by_name(valve: Valve) -> None:
    assert {"fluid", "microwedge", "mixed", "coulomb_hydrodynamic", "coulomb", "stribeck"} <= set(MODELS)
    values = MODELS["coulomb_hydrodynamic"].values_for(valve)
    assert values["normal_load"] == pytest.approx(valve.spool_mass * 9.80665)
    assert values["film_drag"] == valve.viscous_coefficient


def test_two_terms_with_one_parameter_of_their_own_each_are_refused() -> None:
    terms = ["inertia", "spring", "coulomb_friction", "stribeck_friction"]
    with pytest.raises(InputError, match="both have a coulomb_force"):
        model_from_mapping({"name": "both", "terms": terms})


@settings(deadline=None)
@given(
    st.sampled_from([(one, name) for one in TERMS.values() for name in one.becomes]),
    st.floats(-3e-3, 3e-3),
    st.floats(-0.5, 0.5),
    st.floats(0.0, 5.0),
)
def test_a_term_that_contains_another_can_be_it(
    pair: tuple[Term, str], z: float, v: float, friction: float
) -> None:
    term, name = pair
    values = {one.name: one.start for one in term.parameters} | {"coulomb_force": friction}
    values |= term.becomes[name](values)
    expected = at(TERMS[name], values, z, v, 0.0) if name else 0.0
    assert at(term, values, z, v, 0.0) == pytest.approx(expected, abs=1e-12)
    low, high = term.at_rest(z, values)
    assert (low, high) == pytest.approx(TERMS[name].at_rest(z, values) if name else (0.0, 0.0), abs=1e-12)


def test_a_model_contains_those_whose_terms_it_has_or_can_be(valve: Valve) -> None:
    known = {name: MODELS[name] for name in ("fluid", "coulomb", "stribeck", "coulomb_hydrodynamic", "mixed")}
    contains = {
        name: {
            other for other in known if one.values_as(known[other], {"coulomb_force": 0.3}, valve) is not None
        }
        for name, one in known.items()
    }
    assert contains == {
        "fluid": set(),
        "coulomb": {"fluid"},
        "stribeck": {"fluid", "coulomb"},
        "coulomb_hydrodynamic": {"fluid", "coulomb"},
        "mixed": {"fluid"},
    }
