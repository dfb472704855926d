"""Foreign faults: which cases have them, and what each does to a reading."""

from __future__ import annotations

import numpy as np
import pytest
from spool_blind.field.case import WINDOWS, make_field, window_of
from spool_blind.field.foreign import DEVELOPMENT, FOREIGN, KINDS, REPORT, foreign_names
from spool_blind.field.hiding import field_hidden_by
from spool_blind.field.nuisances import NUISANCES, Array, FieldNuisance, Seen

RATE, SECONDS = 2000.0, 20.0
TIME: Array = np.arange(round(RATE * SECONDS)) / RATE
SEEN = Seen({"body": 5.0, "spool": 8.0}, {"body": 15.0, "spool": 30.0}, RATE, SECONDS, 8.0, 90.0)


def drawn(name: str, seed: int = 1) -> FieldNuisance:
    return KINDS[name].draw(np.random.default_rng(seed), SEEN)


def test_no_kind_of_the_report_is_one_that_choices_may_be_made_on() -> None:
    assert not set(FOREIGN[DEVELOPMENT]) & set(FOREIGN[REPORT])
    assert not set(KINDS) & set(NUISANCES)
    assert {window_of(seed) for seed in REPORT} == {"report"}
    assert not any(seed in seeds for seed in DEVELOPMENT for seeds in WINDOWS.values())


@pytest.mark.parametrize("seeds", FOREIGN)
def test_every_kind_meets_nothing_hidden_single_effects_pairs_and_laws(seeds: range) -> None:
    met: dict[str, set[int]] = {}
    for seed in seeds:
        (name,) = foreign_names(seed) or ("",)
        met.setdefault(name, set()).add(seed % 12)
    assert len(met) == len(FOREIGN[seeds])
    assert all(len(places) > 6 for places in met.values())
    assert any(field_hidden_by(seed) == "none" for seed in seeds)


def test_other_seeds_have_no_foreign_fault() -> None:
    assert foreign_names(410_100) is None
    assert foreign_names(320_000) is None


@pytest.mark.parametrize("name", KINDS)
def test_every_fault_is_drawn_with_a_channel_a_size_and_a_unit(name: str) -> None:
    for seed in range(20):
        one = drawn(name, seed)
        assert one.id == name
        assert np.isfinite(one.size)
        assert one.size != 0.0
        assert one.unit


@pytest.mark.parametrize("name", ["pink_noise", "low_passed_noise", "lateral_vibration", "machine_mode"])
def test_a_disturbance_has_the_size_that_was_drawn(name: str) -> None:
    one = drawn(name)
    for channel, size in one.sizes.items():
        assert one.disturbance(channel, np.zeros(TIME.size), RATE).std() == pytest.approx(abs(size))


@pytest.mark.parametrize(("name", "alike"), [("lateral_vibration", True), ("pink_noise", False)])
def test_both_sensors_read_the_same_vibration_and_each_its_own_noise(name: str, alike: bool) -> None:
    body, spool = (drawn(name).disturbance(one, np.zeros(TIME.size), RATE) for one in ("body", "spool"))
    assert bool(abs(np.corrcoef(body, spool)[0, 1]) > 0.999) is alike


def test_a_bent_sensor_makes_a_second_harmonic_of_its_share() -> None:
    one = drawn("bent_sensor")
    seen = one.on_reading("spool", 8.0 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 20.0 * TIME), TIME)
    lines = np.abs(np.fft.rfft(seen)) * 2.0 / TIME.size
    # Of (sqrt(2) sin)^2 the wave of twice the frequency has an amplitude of 1.
    assert lines[round(40.0 * SECONDS)] == pytest.approx(8.0 * abs(one.size), rel=1e-6)


def test_both_corners_of_an_ac_coupling_differ_by_a_factor_of_two_at_least() -> None:
    for seed in range(20):
        low, high = sorted(drawn("different_corners", seed).sizes.values())
        assert 2.0 <= high / low <= 4.0


def test_readings_in_coarse_steps_are_whole_steps() -> None:
    one = drawn("coarse_steps")
    steps = one.on_reading("spool", 8.0 * np.sin(TIME), TIME) / one.size
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", FOREIGN)
def test_a_case_of_this_family_has_its_fault_and_no_other(seeds: range) -> None:
    case = make_field(seeds[1])
    assert tuple(fault.id for fault in case.nuisances) == foreign_names(case.seed)
    assert case.window == window_of(case.seed)
