"""Fits of records behind a logger's filter, made by a second hand: fine steps, then a filter of scipy's."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.signal import bessel, butter, sosfilt, sosfiltfilt
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95
from spool_estimator.identification.fit import Ended, fit, follow, likeliest_reading, unknowns_of
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_estimator.identification.least_squares import Work
from spool_estimator.identification.record import Record
from spool_sim.model import MODELS
from spool_sim.observation import CAUSAL, INSTANTS, LINEAR, MEAN, Observation
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
RATE, FINE, STEPS = 1000.0, 64, 4
TRUTH = {"spring_stiffness": 1700.0, "viscous_coefficient": 5.0, "coulomb_force": 0.45}


@compiled
def stepped(body: Array, h: float, m: float, k: float, c: float, f: float, out: Array) -> None:
    """Fill the relative acceleration, mean over each step of ``body``: midpoint rule, turns located."""
    z, v = 0.0, 0.0
    for i in range(out.size):
        before = v
        for j in range(STEPS):
            a = body[i] + (body[i + 1] - body[i]) * (j + 0.5) / STEPS
            left = h / STEPS
            for _ in range(3):
                push = -a - (k * (z + 0.5 * left * v) + c * v) / m
                if v == 0.0 and abs(push) <= f / m:
                    break
                side = math.copysign(1.0, push if v == 0.0 else v)
                middle = v + 0.5 * left * (push - side * f / m)
                push = -a - (k * (z + 0.25 * left * (v + middle)) + c * middle) / m - side * f / m
                if v != 0.0 and side * (v + left * push) < 0.0:
                    turn = -v / push
                    z += 0.5 * turn * v
                    v = 0.0
                    left -= turn
                    continue
                z += left * (v + 0.5 * left * push)
                v += left * push
                break
        out[i] = (v - before) / h


def record(
    kind: str,
    noise: float = 0.03,
    seconds: float = 12.0,
    body_filter: tuple[int, float] = (4, 0.38),
    family: Any = butter,
) -> Record:
    """Return a record; ``kind``: as of an observation. ``body_filter``: order and corner of that channel."""
    rate = RATE * FINE
    time = np.arange(round(seconds * rate) + 1) / rate
    generator = np.random.default_rng(5)
    body = np.zeros(time.size)
    for frequency in np.linspace(8.3, 91.7, 14):
        body += 2.6 * np.sin(2.0 * math.pi * (frequency * time + generator.random()))
    body *= np.minimum(1.0, time / 0.5) ** 2
    spool = np.empty(time.size - 1)
    stepped(body, 1.0 / rate, VALVE.moving_mass, *TRUTH.values(), spool)
    body = 0.5 * (body[1:] + body[:-1])

    def read(row: Array, order: int, corner: float) -> Array:
        sections = family(order, corner * RATE, fs=rate, output="sos")
        if kind == MEAN:
            row = np.convolve(row, np.ones(FINE) / FINE, mode="same")
        elif kind != INSTANTS:
            row = (sosfiltfilt if kind == LINEAR else sosfilt)(sections, row)
        return np.asarray(row[FINE // 2 :: FINE])

    channels = [read(body, *body_filter), read(spool + body, 4, 0.38)]
    return Record("made", 0, 1.0 / RATE, *(row + generator.normal(0.0, noise, row.size) for row in channels))


def fitted(kind: str) -> Fit:
    return fit([record(kind)], MODELS["coulomb"], VALVE, FitSettings())


@pytest.mark.parametrize("kind", [LINEAR, CAUSAL, MEAN, INSTANTS])
def test_a_fit_recovers_the_forces_behind_a_loggers_filter(kind: str) -> None:
    found = fitted(kind)
    assert found.observation.kind == kind
    for name, true in TRUTH.items():
        one = found.parameter(name)
        assert abs(one.value - true) < 1.3 * Z_95 * one.standard_deviation, one
        assert one.standard_deviation < 2e-3 * true
    assert found.agreement is not None
    power = float(np.mean(record(kind).spool ** 2))
    if kind != INSTANTS:  # there chance decides on which side of a jump a sample is
        # The noise of the spool's sensor and what the valve makes of the body's.
        assert 0.029 < found.agreement.nrmse * math.sqrt(power) < 0.036


@pytest.mark.parametrize("kind", [LINEAR, CAUSAL])
def test_the_corner_and_order_of_the_filter_are_found(kind: str) -> None:
    found = fitted(kind).observation
    assert found.corner == pytest.approx(0.38, abs=0.004)
    assert found.order == pytest.approx(4.0, abs=0.3)


def test_a_filter_of_bessel_is_found_and_bends_no_force() -> None:
    found = fit([record(CAUSAL, family=partial(bessel, norm="mag"))], MODELS["coulomb"], VALVE, FitSettings())
    for name, true in TRUTH.items():
        one = found.parameter(name)
        assert abs(one.value - true) < 1.3 * Z_95 * one.standard_deviation, one
    assert found.observation.kind == CAUSAL
    assert found.observation.shape < -0.5
    assert "Bessel" in found.observation.sentence(RATE)


def test_a_body_whose_channel_has_another_filter_bends_no_force() -> None:
    apart = record(CAUSAL, body_filter=(6, 0.3))
    found = fit([apart], MODELS["coulomb"], VALVE, FitSettings(fit_delay=True))
    for name, true in TRUTH.items():
        one = found.parameter(name)
        assert abs(one.value - true) < 1.3 * Z_95 * one.standard_deviation, one
    assert found.observation.order == 4
    assert found.observation.body_corner == pytest.approx(0.3, rel=0.2)
    assert "body" in found.observation.sentence(RATE)


def test_a_channel_of_the_body_that_is_filtered_alike_is_not_told_apart() -> None:
    assert fitted(CAUSAL).observation.body_corner is None


def test_of_two_readings_of_a_record_the_likelier_one_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set-ups of one logger show each other its low-pass: behind another one friction is wrong."""
    model, settings = MODELS["coulomb"], FitSettings()
    unknowns, values = unknowns_of(model, VALVE, settings), model.values_for(VALVE)

    def ended() -> Ended:
        return follow([record(CAUSAL)], model, VALVE, settings, unknowns, values, Work(math.inf))

    def force(one: Ended) -> float:
        names = [unknown.name for unknown in one.residuals.unknowns]
        return float(one.best.point[names.index("coulomb_force")])

    causal, linear = Observation(CAUSAL, 4.0, 0.36, 0.36), Observation(LINEAR, 4.0, 0.42)
    right = ended()
    monkeypatch.setattr("spool_estimator.identification.fit.observed", lambda *_: linear)
    wrong = ended()
    assert wrong.residuals.observation.kind == LINEAR
    found = likeliest_reading(wrong, [linear, causal])
    assert found.residuals.observation.kind == CAUSAL
    assert force(found) == pytest.approx(TRUTH["coulomb_force"], rel=2e-3)
    assert abs(force(wrong) - TRUTH["coulomb_force"]) > 4.0 * abs(force(found) - TRUTH["coulomb_force"])
    assert likeliest_reading(right, [linear, causal]) is right
