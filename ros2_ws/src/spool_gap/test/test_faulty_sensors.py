"""Faults of sensors in records made by a second hand: its own fine steps, then a filter of scipy's."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95
from spool_estimator.identification.record import Record
from spool_gap.evidence.analyse import analyse
from spool_gap.likelihood.readings import readings_of
from spool_gap.result import GapResult
from spool_sim.model import MODELS
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
RATE, FINE, NOISE = 1000.0, 64, 0.03
STIFFNESS, DRAG, FRICTION = 1700.0, 5.0, 0.45
MEASURED = {"spring_stiffness": STIFFNESS, "viscous_coefficient": DRAG, "coulomb_force": FRICTION}


@compiled
def moved(body: Array, h: float, m: float, k: float, c: float, friction: float, cubic: float) -> Array:
    """Return the spool's acceleration, mean over each step of ``body``: midpoint rule, turns located."""
    found = np.empty(body.size - 1)
    z, v = 0.0, 0.0
    for i in range(found.size):
        before, left = v, h
        a = 0.5 * (body[i] + body[i + 1])
        for _ in range(4):
            at = z + 0.5 * left * v
            push = -a - (k * at + cubic * at**3 + c * v) / m
            if v == 0.0 and abs(push) <= friction / m:
                break
            side = math.copysign(1.0, push if v == 0.0 else v)
            middle = v + 0.5 * left * (push - side * friction / m)
            at = z + 0.25 * left * (v + middle)
            push = -a - (k * at + cubic * at**3 + c * middle) / m - side * friction / m
            if v != 0.0 and side * (v + left * push) < 0.0:
                turn = -v / push
                z += 0.5 * turn * v
                v, left = 0.0, left - turn
                continue
            z += left * (v + 0.5 * left * push)
            v += left * push
            break
        found[i] = a + (v - before) / h
    return found


@lru_cache
def record(friction: float = 0.0, cubic: float = 0.0, seconds: float = 16.0, sweeps: bool = False) -> Record:
    """Return a record behind good sensors and a logger's filter without phase."""
    rate = RATE * FINE
    time = np.arange(round(seconds * rate) + 1) / rate
    generator = np.random.default_rng(5)
    if sweeps:
        at = time % 4.0
        body = 9.0 * np.sin(2.0 * math.pi * (6.0 * at + 0.5 * 74.0 / 4.0 * at**2))
    else:
        lines = np.linspace(8.3, 91.7, 14)
        body = np.zeros(time.size)
        for line in lines:
            body += 2.6 * np.sin(2.0 * math.pi * (line * time + generator.random()))
    body = body * np.minimum(1.0, time / 0.5) ** 2
    spool = moved(body, 1.0 / rate, VALVE.moving_mass, STIFFNESS, DRAG, friction, cubic)
    sections = butter(4, 0.38 * RATE, fs=rate, output="sos")
    rows = (sosfiltfilt(sections, row)[FINE // 2 :: FINE] for row in (0.5 * (body[1:] + body[:-1]), spool))
    return Record("made", 0, 1.0 / RATE, *(row + generator.normal(0.0, NOISE, row.size) for row in rows))


def clipped(one: Record, share: float, channel: str = "spool") -> Record:
    """Return ``one`` with ``share`` of the samples of ``channel`` at the limits of its sensor."""
    row = getattr(one, channel)
    limit = float(np.quantile(np.abs(row), 1.0 - share))
    return replace(one, **{channel: row.clip(-limit, limit)})


def bent(one: Record, square: float, cube: float) -> Record:
    """Return ``one`` with a spool's sensor whose sensitivity changes by these shares at the reading's rms."""
    size = one.spool / one.spool.std()
    return replace(one, spool=one.spool * (1.0 + square * size + cube * size**2))


def shaken(one: Record, body: float, spool: float) -> Record:
    """Return ``one`` with lateral vibration in both channels, shares of the body's rms, in its band."""
    generator = np.random.default_rng(8)
    lines = np.fft.rfft(generator.standard_normal(one.body.size))
    frequency = np.fft.rfftfreq(one.body.size, one.sample_period)
    row = np.fft.irfft(lines * ((frequency > 4.0) & (frequency < 150.0)), one.body.size)
    row *= one.body.std() / row.std()
    return replace(one, body=one.body + body * row, spool=one.spool + spool * row)


def analysed(one: Record) -> GapResult:
    return analyse([one], VALVE, MODELS["fluid"])


def missed(result: GapResult) -> list[str]:
    """Return the true numbers that are outside their intervals by a third or more."""
    known = {one.name: one for one in result.parameters}
    return [
        str(known[name])
        for name, true in MEASURED.items()
        if name in known and not abs(known[name].value - true) < 1.3 * Z_95 * known[name].standard_deviation
    ]


@pytest.mark.slow
def test_a_clipping_channel_of_the_spool_keeps_the_name_and_the_numbers() -> None:
    """A third of the samples is at the limit: they show that the acceleration is at least that."""
    one = clipped(record(FRICTION), 0.3)
    result = analysed(one)
    assert result.verdict == "coulomb_friction+sensor_saturation"
    assert not missed(result)
    (limit,) = result.effects[1].parameters
    assert limit.value == pytest.approx(one.spool.max())


@pytest.mark.slow
def test_clipped_tops_of_the_body_are_restored_as_well_as_noise_lets_them_be_read() -> None:
    whole, one = record(FRICTION), clipped(record(FRICTION), 0.05, "body")
    found = readings_of(one)
    assert found.counted.all()
    assert np.std(found.body - readings_of(whole).body) < NOISE
    result = analysed(one)
    assert result.verdict == "coulomb_friction"
    assert ("clipping", "body") in [(own.id, own.channel) for own in result.nuisances]
    assert not missed(result)


def test_after_a_top_of_the_body_that_is_lost_nothing_counts() -> None:
    """Most of the time at the limit leaves nothing that a top could be restored from."""
    found = readings_of(clipped(record(FRICTION), 0.6, "body"))
    assert found.counted.mean() < 0.05


@pytest.mark.parametrize("friction", [0.0, pytest.param(FRICTION, marks=pytest.mark.slow)])
def test_a_bent_sensor_is_a_part_of_the_chain_with_its_numbers(friction: float) -> None:
    one = record(friction)
    result = analysed(bent(one, 0.0055, 0.001))
    assert result.verdict == ("coulomb_friction" if friction else "none")
    (fault,) = result.nuisances
    assert (fault.id, fault.channel, fault.unit) == ("nonlinearity", "spool", "1/g")
    assert fault.size == pytest.approx(0.0055 * 9.80665 / one.spool.std(), rel=0.03)
    assert not missed(result)


def test_noise_is_by_frequency_where_the_body_rests() -> None:
    """Vibration across the axis of the body's sensor is no motion: the spool does not follow it."""
    one = record(cubic=2e7, sweeps=True)
    level = (0.03 * one.body.std()) ** 2 / 146.0
    frequency, density = readings_of(shaken(one, 0.03, 0.0)).resting
    inside = density[(frequency > 12.0) & (frequency < 100.0)]
    assert np.all((inside > 0.3 * level) & (inside < 1.5 * level))
    quiet = readings_of(one)
    assert np.all(quiet.resting[1] < 2.0 * quiet.noise.body)
