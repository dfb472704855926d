"""Noise of the body's sensor drives the model; what it does to a fit is known beforehand and taken off."""

from __future__ import annotations

import numpy as np
import pytest
from spool_estimator.identification.equation_error import NoiseEffect, noise_density
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import FitSettings
from spool_estimator.identification.record import Record, records_from_blocks
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
#: Far above resonance drag has little effect, so that noise of the drive shows.
DRIVE = SweptSine(start_frequency=8.0, stop_frequency=110.0, duration=10.0, amplitude=8.0, soft_start=0.2)


def noisy(seed: int, noise: float) -> Record:
    simulator = Simulator(
        VALVE,
        DRIVE,
        model="coulomb",
        coulomb_force=0.3,
        seed=seed,
        body_sensor=Sensor(noise=noise),
        spool_sensor=Sensor(noise=0.01),
    )
    return records_from_blocks(simulator.records(10.0), f"seed {seed}")[0]


def test_strong_noise_of_the_drive_leaves_no_bias() -> None:
    errors, deviations = [], []
    for seed in range(6):
        found = fit([noisy(seed, 0.6)], MODELS["coulomb"], VALVE, FitSettings(timing=0.0))
        quantities = {quantity.name: quantity for quantity in found.parameters}
        truth = {
            "spring_stiffness": VALVE.spring_stiffness,
            "viscous_coefficient": VALVE.viscous_coefficient,
            "coulomb_force": 0.3,
        }
        errors.append([quantities[name].value - value for name, value in truth.items()])
        deviations.append([quantities[name].standard_deviation for name in truth])
    mean = np.mean(errors, axis=0)
    chance = np.sqrt(np.mean(np.square(deviations), axis=0) / len(errors))
    print("mean errors over what chance allows:", mean / chance)
    assert np.all(np.abs(mean) < 2.5 * chance)


def test_the_noise_is_measured_above_the_excitation() -> None:
    density = noise_density(noisy(1, 0.6), 110.0)
    assert density == pytest.approx(0.6**2 / 1000.0, rel=0.1)
    assert noise_density(noisy(1, 0.6), 700.0) == 0.0


def test_a_bias_too_large_to_believe_is_not_taken_off_but_counts() -> None:
    effect = NoiseEffect(np.array([0.1, 10.0]), np.diag([1.0, 4.0]), np.zeros(2))
    point, covariance = effect.taken_off(np.array([5.0, 5.0]), np.eye(2))
    np.testing.assert_allclose(point, [4.9, 5.0])
    np.testing.assert_allclose(np.diag(covariance), [1.0 + 0.05**2, 4.0 + 100.0])
