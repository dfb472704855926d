"""Which records are refused for a unit or a sign, and which valves only behave unlike their description."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from spool_core.numbers import GRAVITY
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import noise_of
from spool_estimator.record_judgement import expected_transfer, like_no_valve, transfer, unit_or_exchange
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
from spool_sim.model import MODELS
from spool_sim.valve import Valve, find_valve

VALVE = find_valve("4weh10_soft")
#: Hz: from a third of the natural frequency to five times it.
FREQUENCY = np.linspace(5.0, 75.0, 141)
DRAGS = st.floats(0.15, 1.5)


def real(spring: float = 1.0, drag: float = 1.0) -> NDArray[np.complex128]:
    """Return the transfer of a valve whose spring and drag differ from the description."""
    other: Valve = VALVE.model_copy(
        update={
            "spring_stiffness": spring * VALVE.spring_stiffness,
            "dynamic_viscosity": drag * VALVE.dynamic_viscosity,
        }
    )
    return np.asarray(expected_transfer(FREQUENCY, other), dtype=np.complex128)


@settings(deadline=None, max_examples=40)
@given(spring=st.floats(0.5, 40.0), drag=DRAGS)
def test_another_spring_or_drag_is_no_wrong_unit(spring: float, drag: float) -> None:
    """Preload and dry friction hold the spool as a spring of many times the stiffness does."""
    assert unit_or_exchange(real(spring, drag), FREQUENCY, VALVE) == ""
    assert not like_no_valve(real(spring, drag), FREQUENCY, VALVE)


@settings(deadline=None, max_examples=40)
@given(spring=st.floats(0.0, 0.3), drag=st.floats(0.5, 2.0))
def test_a_spool_that_floats_in_the_play_of_its_springs_is_no_wrong_unit(spring: float, drag: float) -> None:
    """Nothing but the drag takes it along."""
    assert unit_or_exchange(real(spring, drag), FREQUENCY, VALVE) == ""


@settings(deadline=None, max_examples=40)
@given(spring=st.floats(0.7, 4.0), drag=DRAGS, place=st.floats(0.1, 0.9))
def test_nor_is_one_that_floats_at_the_frequencies_at_which_it_hardly_moves(
    spring: float, drag: float, place: float
) -> None:
    """Where it swings it reaches its springs."""
    swings = np.quantile(FREQUENCY, place) > FREQUENCY
    bent = np.where(swings, real(spring, drag), real(1e-3, drag))
    assert "9.81" not in unit_or_exchange(bent, FREQUENCY, VALVE)


@settings(deadline=None, max_examples=40)
@given(spring=st.floats(0.9, 1.1), drag=DRAGS, scatter=st.floats(0.0, 0.15), seed=st.integers(0, 9))
def test_a_channel_in_g_is_refused_for_any_drag(
    spring: float, drag: float, scatter: float, seed: int
) -> None:
    bent = real(spring, drag) * np.exp(scatter * np.random.default_rng(seed).standard_normal(FREQUENCY.size))
    assert "is body in g" in unit_or_exchange(GRAVITY * bent, FREQUENCY, VALVE)
    assert "is spool in g" in unit_or_exchange(bent / GRAVITY, FREQUENCY, VALVE)


@settings(deadline=None, max_examples=40)
@given(drag=DRAGS)
def test_a_sensor_turned_round_is_refused_for_any_drag(drag: float) -> None:
    assert "turned round" in unit_or_exchange(-real(1.0, drag), FREQUENCY, VALVE)


@settings(deadline=None, max_examples=40)
@given(drag=DRAGS, corner=st.floats(15.0, 60.0))
def test_a_channel_that_lags_is_not_turned_round(drag: float, corner: float) -> None:
    """Behind a low-pass of second order, far above its corner, every sine looks turned."""
    lagging = real(drag=drag) / (1.0 + 1j * FREQUENCY / corner) ** 2
    assert "opposite" not in unit_or_exchange(lagging, FREQUENCY, VALVE)


@pytest.mark.parametrize("drag", [0.3, 1.0])
def test_exchanged_channels_are_refused(drag: float) -> None:
    assert "exchanged" in unit_or_exchange(1.0 / real(1.0, drag), FREQUENCY, VALVE)


def test_what_is_no_valve_at_all_is_said_to_be_none() -> None:
    assert like_no_valve(np.full(FREQUENCY.size, 30.0 + 0.0j), FREQUENCY, VALVE)


@pytest.mark.parametrize(
    ("friction", "rms", "unit"), [(0.5, 6.0, 1.0), (0.5, 3.0, 1.0), (1.0, 6.0, 1.0), (0.5, 6.0, GRAVITY)]
)
def test_friction_that_carries_the_spool_above_its_resonance_is_no_wrong_unit(
    friction: float, rms: float, unit: float
) -> None:
    """From 100 to 300 Hz the springs hardly act; a body that is in g all the same is found."""
    rate, count, substeps = 2000.0, 20_000, 8
    size = 2 * count * substeps
    generator = np.random.default_rng(3)
    frequency = np.fft.rfftfreq(size, 1.0 / (2.0 * substeps * rate))
    lines = np.where((frequency >= 100.0) & (frequency <= 300.0), 1.0, 0.0)
    drive = np.fft.irfft(lines * np.exp(2j * np.pi * generator.uniform(size=frequency.size)), size)
    drive = np.append(drive, drive[0]) * rms / float(np.std(drive))
    values = {"mass": 0.18, "spring_stiffness": 1632.0, "viscous_coefficient": 4.0, "coulomb_force": friction}
    kernel = ComposedMotion(MODELS["coulomb"].terms)
    run, _ = kernel.advance(
        MotionState(), drive, kernel.table(values, count), sample_period=1.0 / rate, substeps=substeps
    )
    noise = 0.02 * generator.standard_normal((2, count))
    body, spool = drive[: -1 : 2 * substeps] + noise[0], run.acceleration + noise[1]
    record = Record("run", 0.0, 1.0 / rate, body / unit, spool)
    ratio, coherent, driven = transfer(record, noise_of(record.body, record.spool, rate))
    assert ("is body in g" in unit_or_exchange(ratio, driven, VALVE, coherent)) == (unit > 1.0)
