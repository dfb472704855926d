"""What a measuring chain does to a record is found with its size, and never named as mechanics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_estimator.identification.nuisances import frequencies_of_hum
from spool_estimator.identification.record import Record
from spool_gap.catalogue import RECORD_NUISANCES
from spool_gap.evidence.analyse import analyse
from spool_gap.result import GapResult
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

RATE, SECONDS, NOISE = 1000.0, 12.0, 0.03
VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
TIME = np.arange(round(RATE * SECONDS)) / RATE
Distortion = Callable[[Record], Record]


@pytest.fixture(scope="module", name="clean")
def _clean() -> Record:
    sweep = SweptSine(start_frequency=6.0, stop_frequency=45.0, duration=SECONDS, amplitude=8.0)
    sensor = Sensor(noise=0.0)
    simulator = Simulator(
        VALVE, sweep, model="fluid", sample_rate=RATE, block_size=500, body_sensor=sensor, spool_sensor=sensor
    )
    blocks = list(simulator.records(SECONDS))
    rows = [np.concatenate([getattr(block, name) for block in blocks]) for name in ("body", "spool")]
    generator = np.random.default_rng(2)
    body, spool = (row.astype(np.float64) + NOISE * generator.standard_normal(row.size) for row in rows)
    return Record("sweep", 0, 1.0 / RATE, body, spool)


def with_hum(record: Record) -> Record:
    hum = 0.3 * np.cos(2.0 * np.pi * 50.03 * TIME) + 0.1 * np.cos(2.0 * np.pi * 150.09 * TIME)
    return replace(record, spool=record.spool + hum)


def with_spikes(record: Record) -> Record:
    """One to three samples wide."""
    generator = np.random.default_rng(5)
    spool = record.spool.copy()
    for place in generator.integers(10, TIME.size - 10, 16):
        spool[place : place + generator.integers(1, 4)] += 12.0
    return replace(record, spool=spool)


def with_drift(record: Record) -> Record:
    return replace(record, body=record.body + 2.0 * TIME / SECONDS)


def with_ac_coupling(record: Record) -> Record:
    lines = np.fft.rfftfreq(2 * TIME.size, 1.0 / RATE)
    passed = np.where(lines > 0.0, 1j * lines / (1j * lines + 0.8), 0.0)
    row = np.fft.irfft(np.fft.rfft(np.concatenate([record.spool, record.spool[::-1]])) * passed)
    return replace(record, spool=row[: TIME.size])


def with_gain_drift(record: Record) -> Record:
    return replace(record, spool=record.spool * (1.0 + 0.004 * TIME))


def found_in(result: GapResult) -> Mapping[tuple[str, str], float]:
    return {(entry.id, entry.channel): entry.size for entry in result.nuisances}


@pytest.mark.parametrize(
    ("distort", "name", "channel", "size", "unit"),
    [
        (with_hum, "hum", "spool", 0.3, "m/s^2"),
        (with_spikes, "spikes", "spool", 16.0 / SECONDS, "1/s"),
        (with_drift, "bias_drift", "body", 2.0, "m/s^2"),
        (with_ac_coupling, "ac_coupling", "spool", 0.8, "Hz"),
        (with_gain_drift, "gain_drift", "spool", 0.004, "1/s"),
    ],
)
@pytest.mark.slow
def test_a_nuisance_is_told_with_its_size_and_nothing_is_missing(
    clean: Record, distort: Distortion, name: str, channel: str, size: float, unit: str
) -> None:
    result = analyse([distort(clean)], VALVE, MODELS["fluid"])
    assert result.verdict == "none"
    check_nuisance(result, name, channel, size, unit)


def check_nuisance(result: GapResult, name: str, channel: str, size: float, unit: str) -> None:
    (entry,) = [own for own in result.nuisances if own.id == name]
    assert (entry.channel, entry.unit) == (channel, unit)
    assert entry.size == pytest.approx(size, rel=0.15)
    assert entry.check


def test_nuisances_together_are_told_with_their_sizes_and_nothing_is_missing(clean: Record) -> None:
    result = analyse([with_drift(with_spikes(with_hum(clean)))], VALVE, MODELS["fluid"])
    assert result.verdict == "none"
    check_nuisance(result, "hum", "spool", 0.3, "m/s^2")
    check_nuisance(result, "spikes", "spool", 16.0 / SECONDS, "1/s")
    check_nuisance(result, "bias_drift", "body", 2.0, "m/s^2")


@pytest.mark.slow
def test_a_clean_record_has_no_nuisance(clean: Record) -> None:
    result = analyse([clean], VALVE, MODELS["fluid"])
    assert result.verdict == "none"
    assert not found_in(result)


@pytest.mark.slow
def test_loud_coloured_noise_is_noise(clean: Record) -> None:
    generator = np.random.default_rng(8)
    lines = np.maximum(np.fft.rfftfreq(TIME.size, 1.0 / RATE), 0.5)
    row = np.fft.irfft(np.fft.rfft(generator.standard_normal(TIME.size)) / np.sqrt(lines), TIME.size)
    noisy = replace(clean, spool=clean.spool + 0.3 * row / row.std())
    result = analyse([noisy], VALVE, MODELS["fluid"])
    assert result.verdict == "none"
    assert ("coloured_noise", "spool") in found_in(result)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), low=st.floats(4.0, 20.0), width=st.floats(10.0, 80.0))
def test_random_motion_has_no_hum_no_spikes_and_no_drift(seed: int, low: float, width: float) -> None:
    generator = np.random.default_rng(seed)
    lines = np.fft.rfftfreq(TIME.size, 1.0 / RATE)
    inside = (lines > low) & (lines < low + width)
    spectrum = np.where(
        inside, generator.normal(size=lines.size) + 1j * generator.normal(size=lines.size), 0.0
    )
    transfer = 1.0 / (1.0 - (lines / 15.0) ** 2 + 0.1j * lines / 15.0)
    rows = [np.fft.irfft(own, TIME.size) for own in (spectrum, spectrum * transfer)]
    scale = 5.0 / rows[0].std()
    body, spool = (scale * row + NOISE * generator.standard_normal(TIME.size) for row in rows)
    record = Record("random", 0, 1.0 / RATE, body, spool)
    for nuisance in RECORD_NUISANCES:
        assert not nuisance.clean([record], VALVE).found, nuisance.id


def test_every_harmonic_of_the_mains_is_hum_where_one_stands_out(clean: Record) -> None:
    mains = 50.03
    humming = replace(clean, spool=clean.spool + 0.3 * np.cos(3.0 * 2.0 * np.pi * mains * TIME))
    lines = frequencies_of_hum(humming, VALVE)
    assert lines == pytest.approx([mains * order for order in range(1, 9)], rel=1e-4)
    assert frequencies_of_hum(clean, VALVE) == ()


def test_motion_at_the_mains_frequency_is_no_hum(clean: Record) -> None:
    line = 2.0 * np.exp(2j * np.pi * 50.0 * TIME)
    natural = VALVE.natural_frequency
    follows = 1.0 / (1.0 - (50.0 / natural) ** 2 + 0.06j * 50.0 / natural)
    moved = replace(clean, body=clean.body + line.real, spool=clean.spool + (follows * line).real)
    hum = next(entry for entry in RECORD_NUISANCES if entry.id == "hum")
    assert not hum.clean([moved], VALVE).found


def test_spikes_of_short_stretches_are_judged_together(clean: Record) -> None:
    """Also that of the last sample, beyond which no other one shows it, and those that look like speed."""
    length, generator = clean.body.size // 6, np.random.default_rng(3)
    stretches, spikes = [], 0
    for number in range(6):
        one = clean.part(number * length, (number + 1) * length)
        spool = one.spool.copy()
        for place in (*generator.integers(10, length - 10, 3).tolist(), length - 1):
            spool[place : place + 2] += 150.0
            spikes += 1
        stretches.append(replace(one, spool=spool))
    found = next(one for one in RECORD_NUISANCES if one.id == "spikes").clean(stretches, VALVE)
    for number, one in enumerate(found.records):
        whole = clean.part(number * length, (number + 1) * length)
        assert np.abs(one.spool - whole.spool).max() < 3.0
    assert [own.id for own in found.found] == ["spikes"]
