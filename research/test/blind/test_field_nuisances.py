"""Nuisances of field cases do to a reading what their names say, at the size they tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_blind.field.nuisances import (
    MOST,
    NUISANCES,
    AcCoupling,
    AntiAlias,
    BiasDrift,
    Clipping,
    ColouredNoise,
    CrossAxis,
    ExtraMode,
    GainDrift,
    Jitter,
    LostSamples,
    MainsHum,
    Quantisation,
    Seen,
    Spikes,
    draw_nuisances,
    names_by,
)

RATE, SECONDS = 2000.0, 20.0
TIME = np.arange(round(RATE * SECONDS)) / RATE
REST = np.zeros(TIME.size)
NOISE = np.random.default_rng(1).standard_normal(TIME.size)
SEEN = Seen({"body": 5.0, "spool": 8.0}, {"body": 15.0, "spool": 30.0}, RATE, SECONDS, 8.0, 90.0)
SEEDS = st.integers(0, 10_000)
#: Examples of whole records: some in each run, more of those that are drawn at random.
FEW = settings(max_examples=20 if settings().derandomize else 100)


def drawn(name, seed):
    return NUISANCES[name].draw(np.random.default_rng(seed), SEEN)


@given(SEEDS)
def test_every_nuisance_is_drawn_with_a_channel_a_size_and_a_unit(seed):
    for name in NUISANCES:
        one = drawn(name, seed)
        assert one.id == name
        assert one.channel in ("body", "spool", "both")
        assert np.isfinite(one.size)
        assert one.size != 0.0
        assert one.unit


@given(SEEDS)
def test_a_record_carries_at_most_three_nuisances_none_of_which_looks_like_what_is_hidden(seed):
    names = names_by(np.random.default_rng(seed), ["spool_delay", "sensor_saturation"])
    assert len(set(names)) == len(names) <= MOST
    assert not {"anti_alias", "clipping"} & set(names)
    stages = [one.stage for one in draw_nuisances(np.random.default_rng(seed), names, SEEN)]
    assert stages == sorted(stages)


def test_two_thirds_of_the_records_carry_nuisances():
    share = np.mean([bool(names_by(np.random.default_rng(seed), [])) for seed in range(2000)])
    assert share == pytest.approx(2.0 / 3.0, abs=0.04)


@FEW
@given(SEEDS)
def test_hum_stands_at_the_mains_frequency_and_its_harmonics(seed):
    hum = drawn("hum", seed)
    channel = next(iter(hum.sizes))
    row = hum.on_reading(channel, REST, TIME)
    power = np.abs(np.fft.rfft(row * np.hanning(row.size))) ** 2
    lines = np.fft.rfftfreq(row.size, 1.0 / RATE)
    near = np.zeros(lines.size, dtype=bool)
    for order in range(1, len(hum.harmonics) + 1):
        near |= np.abs(lines - order * hum.frequency) < 0.5
    assert power[near].sum() > 0.999 * power.sum()
    assert row.std() == pytest.approx(
        hum.sizes[channel] * np.sqrt(0.5 * np.sum(np.square(hum.harmonics))), rel=0.01
    )
    assert min(abs(hum.frequency - 50.0), abs(hum.frequency - 60.0)) < 0.05


@FEW
@given(st.floats(0.1, 2.0))
def test_ac_coupling_halves_the_power_at_its_corner_and_passes_what_is_far_above(corner):
    coupling = AcCoupling({"spool": corner}, 0)
    for frequency, share in ((corner, np.sqrt(0.5)), (30.0 * corner, 1.0)):
        time = np.arange(round(40.0 / corner * 200.0)) / 200.0
        passed = coupling.on_reading("spool", np.sin(2.0 * np.pi * frequency * time), time)
        assert np.std(passed[passed.size // 2 :]) * np.sqrt(2.0) == pytest.approx(share, rel=0.02)
    assert np.abs(coupling.on_reading("spool", np.full(TIME.size, 3.0), TIME)).max() == 0.0


@settings(max_examples=8 if settings().derandomize else 20)
@given(SEEDS)
def test_an_anti_alias_filter_passes_the_motion_and_stops_what_would_fold_back(seed):
    filtered = drawn("anti_alias", seed)
    channel, corner = next(iter(filtered.sizes.items()))
    rate = 16_000.0
    time = np.arange(32_000) / rate
    low = np.sin(2.0 * np.pi * 40.0 * time)
    passed = filtered.on_motion(channel, low, rate)
    inner = slice(8000, 31_000)
    behind = 0.0 if filtered.equalised else filtered.delay
    assert passed[inner] == pytest.approx(np.sin(2.0 * np.pi * 40.0 * (time[inner] - behind)), abs=0.05)
    assert filtered.delay > 0.0
    stopped = filtered.on_motion(channel, np.sin(2.0 * np.pi * min(4.0 * corner, 7000.0) * time), rate)
    assert np.std(stopped[inner]) < 0.1


def test_an_elastic_mounting_amplifies_at_its_resonance_only():
    mode = ExtraMode({"spool": 200.0}, 0, share=1.0, damping=0.02)
    rate = 40_000.0
    time = np.arange(40_000) / rate
    for frequency, share in ((200.0, 1.0 / 0.04), (10.0, 1.0), (800.0, 1.0 / 15.0)):
        passed = mode.on_motion("spool", np.sin(2.0 * np.pi * frequency * time), rate)
        late = passed[time >= 0.6]
        assert np.sqrt(2.0) * late.std() == pytest.approx(share, rel=0.03)


@FEW
@given(SEEDS)
def test_quantised_readings_are_whole_steps_and_none_is_further_off_than_half_of_one(seed):
    rounding = drawn("quantisation", seed)
    assert isinstance(rounding, Quantisation)
    step = rounding.sizes["spool"]
    row = rounding.on_reading("spool", 8.0 * NOISE, TIME)
    assert np.abs(row / step - np.round(row / step)).max() < 1e-6
    assert np.abs(row - 8.0 * NOISE).max() <= 0.5001 * step
    assert rounding.like_noise("spool", row, RATE).std() == pytest.approx(step / np.sqrt(12.0), rel=0.02)


@FEW
@given(SEEDS)
def test_a_clipped_channel_ends_at_its_full_scale_and_the_other_is_as_it_was(seed):
    clipping = drawn("clipping", seed)
    assert isinstance(clipping, Clipping)
    for channel, limit in clipping.sizes.items():
        assert limit < SEEN.peak[channel]
        row = clipping.on_reading(channel, 2.0 * limit * np.sin(TIME), TIME)
        assert np.abs(row).max() == limit
        assert np.array_equal(clipping.on_reading(channel, 0.5 * limit * NOISE.clip(-1, 1), TIME),
                              0.5 * limit * NOISE.clip(-1, 1))  # fmt: skip
    assert ("sensor_saturation" in clipping.may_be_named) == ("spool" in clipping.sizes)


@FEW
@given(SEEDS)
def test_lost_samples_are_gaps_in_time_or_empty_cells_of_one_channel(seed):
    lost = drawn("missing_samples", seed)
    assert isinstance(lost, LostSamples)
    time, body, spool = lost.on_samples(TIME, NOISE, NOISE)
    assert (time[0], time[-1]) == (TIME[0], TIME[-1])
    assert np.all(np.diff(time) > 0.0)
    if lost.rows:
        gone = TIME.size - time.size
        assert np.isfinite(body).all()
        assert np.diff(time).max() > 1.5 / RATE
    else:
        gone = int(np.isnan(body).sum() + np.isnan(spool).sum())
        assert time.size == TIME.size
        assert np.isfinite(body).all() or np.isfinite(spool).all()
    assert 1 <= gone <= lost.size * TIME.size + len(lost.lengths)


@FEW
@given(SEEDS)
def test_jitter_scatters_the_instants_by_its_rms(seed):
    jitter = drawn("jitter", seed)
    assert isinstance(jitter, Jitter)
    scatter = jitter.instants(TIME) - TIME
    assert scatter.std() == pytest.approx(jitter.size, rel=0.03)
    assert jitter.size <= 3e-4


@FEW
@given(SEEDS)
def test_the_gain_drifts_by_what_is_told_over_the_record(seed):
    drift = drawn("gain_drift", seed)
    assert isinstance(drift, GainDrift)
    channel = next(iter(drift.sizes))
    row = drift.on_reading(channel, np.ones(TIME.size), TIME)
    assert row[0] == 1.0
    assert row[-1] == pytest.approx(1.0 + drift.size)


@FEW
@given(SEEDS)
def test_the_bias_drifts_by_what_is_told_over_the_record(seed):
    drift = drawn("bias_drift", seed)
    assert isinstance(drift, BiasDrift)
    for channel, size in drift.sizes.items():
        row = drift.on_reading(channel, REST, TIME)
        assert row[-1] - row[0] == pytest.approx(size)


@FEW
@given(SEEDS)
def test_spikes_are_few_and_high(seed):
    spikes = drawn("spikes", seed)
    assert isinstance(spikes, Spikes)
    channel = next(iter(spikes.sizes))
    row = spikes.on_reading(channel, REST, TIME)
    assert np.count_nonzero(row) <= 3 * (spikes.size * SECONDS + 6.0 * np.sqrt(spikes.size * SECONDS) + 6.0)
    if row.any():
        assert np.median(np.abs(row[row != 0.0])) > SEEN.rms[channel]


@pytest.mark.parametrize("name", ["coloured_noise", "cross_axis"])
@FEW
@given(seed=SEEDS)
def test_noise_has_the_rms_that_is_told_and_keeps_to_its_band(name, seed):
    noise = drawn(name, seed)
    assert isinstance(noise, (ColouredNoise, CrossAxis))
    channel = next(iter(noise.sizes))
    row = noise.disturbance(channel, REST, RATE)
    assert row.std() == pytest.approx(noise.sizes[channel], rel=1e-6)
    power = np.abs(np.fft.rfft(row)) ** 2
    lines = np.fft.rfftfreq(row.size, 1.0 / RATE)
    inside = (lines >= noise.low) & (lines <= noise.high)
    assert power[inside].sum() > 0.999 * power.sum()


def test_lateral_vibration_is_the_same_in_both_channels():
    across = CrossAxis({"body": 0.1, "spool": 0.3}, 5)
    body, spool = (across.disturbance(name, REST, RATE) for name in ("body", "spool"))
    assert spool == pytest.approx(3.0 * body)


def test_a_filter_in_one_channel_that_delays_it_may_be_named_a_delay():
    late = AntiAlias({"spool": 200.0}, 0, order=6, rate=1000.0)
    assert late.may_be_named == ("spool_delay",)
    both = AntiAlias({"body": 200.0, "spool": 200.0}, 0, order=6, rate=1000.0)
    assert both.may_be_named == ()
    assert MainsHum({"spool": 1.0}, 0).may_be_named == ()
