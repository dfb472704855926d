"""The second simulator against closed forms."""

from itertools import pairwise

import numpy as np
import pytest
from spool_blind.simulator import Plant, move, respond

BASE = {"mass": 0.18, "stiffness": 1632.0, "damping": 4.0}
H = 20e-6


def times(duration):
    return (np.arange(round(duration / H)) + 0.5) * H


def pulse(t, height=30.0, length=0.02):
    return np.where(t < length, height * np.sin(np.pi * t / length), 0.0)


def peaks(motion):
    z = motion.displacement
    inner = np.flatnonzero((np.diff(np.sign(np.diff(z))) != 0.0) & (motion.time[1:-1] > 0.05)) + 1
    return z[inner]


def test_transmissibility_is_that_of_mass_spring_and_drag():
    t = times(8.0)
    body = 10.0 * np.sin(2.0 * np.pi * (8.0 * t + 4.0 * t * t)) * np.clip(t / 0.3, 0.0, 1.0)
    found = move(Plant(BASE), t, H, body).spool
    expected = respond(BASE, body, 1.0 / H)
    assert np.abs(found - expected).max() < 2e-4 * np.abs(expected).max()


def test_free_decay_with_dry_friction_loses_the_same_height_each_half_turn():
    t = times(3.0)
    plant = Plant({"mass": 0.18, "stiffness": 1632.0, "coulomb_force": 0.2})
    motion = move(plant, t, H, pulse(t))
    heights = np.abs(peaks(motion))
    moving = heights[heights > 3.0 * 0.2 / 1632.0]
    assert moving.size > 4
    losses = [before - after for before, after in pairwise(moving)]
    assert losses == pytest.approx([2.0 * 0.2 / 1632.0] * len(losses), rel=2e-3)
    rest = motion.displacement[-1000:]
    assert np.ptp(rest) == 0.0
    assert abs(rest[0]) <= 0.2 / 1632.0


def test_viscous_decay_has_the_logarithmic_decrement():
    t = times(1.5)
    plant = Plant({"mass": 0.18, "stiffness": 1632.0, "damping": 2.0})
    found = np.abs(peaks(move(plant, t, H, pulse(t))))[:10]
    ratio = 2.0 / (2.0 * np.sqrt(1632.0 * 0.18))
    expected = np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2))
    assert found[1:] / found[:-1] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    "friction",
    [
        {"coulomb_force": 0.5},
        {"coulomb_force": 0.2, "static_force": 0.5, "stribeck_velocity": 0.03, "stribeck_exponent": 1.0},
        {"contact_power": 0.005, "contact_velocity": 0.01, "root_drag": 0.5},
        {"coulomb_force": 0.6, "asymmetry": 0.1},
    ],
)
def test_sticks_while_the_inertia_is_below_the_friction(friction):
    t = times(0.5)
    body = 0.99 * 0.5 / 0.18 * np.sin(2.0 * np.pi * 12.0 * t)
    motion = move(Plant({**BASE, **friction}), t, H, body)
    assert not motion.displacement.any()
    assert np.array_equal(motion.spool, body)


def test_dahl_friction_gives_its_stiffness_before_it_slides():
    t = times(1.0)
    body = 0.02 * np.sin(2.0 * np.pi * 5.0 * t)
    plant = Plant({**BASE, "coulomb_force": 0.5, "bristle_stiffness": 5e4})
    z = move(plant, t, H, body).displacement
    expected = 0.18 * 0.02 / (1632.0 + 5e4)
    assert np.abs(z[z.size // 2 :]).max() == pytest.approx(expected, rel=0.05)


def test_stops_hold_and_lose_energy():
    t = times(1.0)
    free = move(Plant(BASE), t, H, pulse(t, 60.0))
    gap = 0.5 * np.abs(free.displacement).max()
    stops = {"stop_gap": gap, "stop_stiffness": 1e6, "stop_damping": 100.0}
    held = move(Plant({**BASE, **stops}), t, H, pulse(t, 60.0))
    assert np.abs(held.displacement).max() < 1.1 * gap
    assert np.abs(held.displacement[t > 0.5]).max() < np.abs(free.displacement[t > 0.5]).max()


@pytest.mark.parametrize(
    ("numbers", "share"),
    [
        # Duffing: w^2 = k/m + 3/4 k3/m A^2; preload by its describing function.
        ({"cubic": 5e7}, lambda a: 1.0 + 0.75 * 5e7 * a**2 / 1632.0),
        ({"preload_force": 0.3, "preload_travel": 1e-6}, lambda a: 1.0 + 4.0 * 0.3 / (np.pi * a * 1632.0)),
    ],
)
def test_frequency_of_free_oscillation_follows_the_spring(numbers, share):
    t = times(1.0)
    plant = Plant({"mass": 0.18, "stiffness": 1632.0, **numbers})
    motion = move(plant, t, H, pulse(t))
    z, after = motion.displacement, t > 0.05
    crossings = t[1:][after[1:] & (z[1:] >= 0.0) & (z[:-1] < 0.0)]
    frequency = (crossings.size - 1) / (crossings[-1] - crossings[0])
    expected = np.sqrt(1632.0 / 0.18 * share(np.abs(z[after]).max())) / (2.0 * np.pi)
    assert frequency == pytest.approx(expected, rel=0.01)


def test_a_quarter_of_the_step_gives_the_same_motion():
    stribeck = {
        "coulomb_force": 0.3,
        "static_force": 0.5,
        "stribeck_velocity": 0.03,
        "stribeck_exponent": 2.0,
    }
    numbers = {**BASE, **stribeck, "cubic": 3e7}
    found = []
    for halvings in (0, 2):
        h = H / 2**halvings
        t = (np.arange(round(4.0 / h)) + 0.5) * h
        motion = move(Plant(numbers), t, h, 8.0 * np.sin(2.0 * np.pi * (8.0 * t + 4.0 * t * t)))
        found.append(np.interp(np.arange(2000, 3900) / 1000.0, t, motion.displacement))
    assert np.std(found[0] - found[1]) < 1e-3 * np.std(found[1])
