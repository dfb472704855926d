from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from spool_core.errors import InputError
from spool_sim.excitation import PRESETS, Recorded, from_mapping
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve

RATE = 2000.0
TIMES = np.arange(4000) / RATE


def sine(frequency: float) -> Recorded:
    return Recorded(samples=np.sin(2.0 * np.pi * frequency * TIMES + 0.3), sample_rate=RATE)


@settings(max_examples=40, deadline=None)
@given(frequency=st.floats(1.0, 800.0), seed=st.integers(0, 1000))
def test_between_samples_the_record_is_band_limited(frequency: float, seed: int) -> None:
    t = np.random.default_rng(seed).uniform(0.03, 1.95, 300)
    truth = np.sin(2.0 * np.pi * frequency * t + 0.3)
    np.testing.assert_allclose(sine(frequency).acceleration(t), truth, atol=2e-4)


@settings(max_examples=30, deadline=None)
@given(borders=st.lists(st.integers(1, 999), max_size=8))
def test_any_split_of_the_times_gives_the_same_bits(borders: list[int]) -> None:
    t = np.linspace(-0.1, 2.1, 1000)
    record = Recorded(samples=np.random.default_rng(1).standard_normal(4000), sample_rate=RATE)
    parts = [record.acceleration(piece) for piece in np.split(t, sorted(borders))]
    np.testing.assert_array_equal(np.concatenate(parts), record.acceleration(t))


def test_highest_frequency_is_that_of_the_content() -> None:
    assert 120.0 <= sine(120.0).highest_frequency < 123.0
    noise = Recorded(samples=np.random.default_rng(0).standard_normal(4000), sample_rate=RATE)
    assert 990.0 < noise.highest_frequency < 1000.0
    assert Recorded(samples=np.zeros(10), sample_rate=RATE).highest_frequency == 0.0


def test_simulation_of_a_recorded_sweep_is_that_of_the_sweep(valve: Valve) -> None:
    sweep = PRESETS["sweep"]
    samples = sweep.acceleration(np.arange(20_001) / RATE)
    recorded = Recorded(samples=samples, sample_rate=RATE)
    one = np.concatenate([block.spool for block in Simulator(valve, sweep).records(10.0)])
    other = np.concatenate([block.spool for block in Simulator(valve, recorded).records(10.0)])
    settled = slice(0, 19_900)
    error = np.sqrt(np.mean((one - other)[settled] ** 2))
    assert error < 1e-4 * one.std()


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        ([1.0], "at least two samples"),
        ([[1.0, 2.0]], "one row"),
        ([1.0, float("nan"), 2.0, float("inf")], r"sample 1 is not a number \(2 such"),
    ],
)
def test_unusable_records_are_refused(samples: list[float], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Recorded(samples=samples, sample_rate=RATE)


def test_samples_are_kept_from_changes() -> None:
    own: NDArray[np.float64] = np.ones(5)
    record = Recorded(samples=own, sample_rate=RATE)
    own[2] = 7.0
    assert record.samples[2] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        record.samples[2] = 3.0


def test_yaml_of_a_record_is_sent_to_the_command_that_reads_it() -> None:
    with pytest.raises(InputError, match=r"excitation\.yaml: kind: 'recorded' works .*spool simulate"):
        from_mapping({"kind": "recorded", "file": "bag"}, "excitation.yaml")
