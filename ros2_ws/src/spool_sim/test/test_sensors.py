from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_sim.observation import CAUSAL, Observation
from spool_sim.sensors import Sensor, SensorChannel, load_sensors

SINE = 8.0 * np.sin(0.3 * np.arange(400))


def in_pieces(channel: Any, signal: Array, borders: list[int]) -> Array:
    cuts = sorted({0, *borders, signal.size})
    take = channel.read if isinstance(channel, SensorChannel) else channel.apply
    return np.concatenate([take(signal[a:b]) for a, b in pairwise(cuts)])


SENSORS = st.builds(
    Sensor,
    delay_samples=st.one_of(st.floats(0.0, 60.0), st.integers(0, 60).map(float)),
    gain_error=st.floats(-0.5, 0.5),
    bias=st.floats(-2.0, 2.0),
    noise=st.floats(0.0, 1.0),
    resolution=st.one_of(st.just(0.0), st.floats(0.01, 1.0)),
    full_scale=st.one_of(st.none(), st.floats(1.0, 12.0)),
)


@settings(max_examples=100, deadline=None)
@given(sensor=SENSORS, borders=st.lists(st.integers(1, 399), max_size=20), seed=st.integers(0, 1000))
def test_readings_do_not_depend_on_how_reads_are_split(sensor: Sensor, borders: list[int], seed: int) -> None:
    whole = SensorChannel(sensor, seed).read(SINE)
    np.testing.assert_array_equal(in_pieces(SensorChannel(sensor, seed), SINE, borders), whole)


@settings(max_examples=60, deadline=None)
@given(sensor=SENSORS, at=st.integers(0, 399))
def test_no_reading_knows_the_future(sensor: Sensor, at: int) -> None:
    changed = SINE.copy()
    changed[at:] += 50.0
    one, other = SensorChannel(sensor, 1).read(SINE), SensorChannel(sensor, 1).read(changed)
    np.testing.assert_array_equal(one[:at], other[:at])


def test_reading_is_clipped_at_full_scale_after_all_else() -> None:
    sensor = Sensor(gain_error=0.5, bias=1.0, noise=0.5, full_scale=5.0)
    reading = SensorChannel(sensor, 0).read(SINE)
    assert reading.max() == 5.0
    assert reading.min() == -5.0
    free = SensorChannel(sensor.model_copy(update={"full_scale": None}), 0).read(SINE)
    inside = np.abs(free) < 5.0
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(reading[inside], free[inside])


def test_digitised_reading_never_lies_beyond_full_scale_though_its_step_divides_it_unevenly() -> None:
    reading = SensorChannel(Sensor(resolution=0.3, full_scale=5.0), 0).read(SINE)
    assert (reading.min(), reading.max()) == (-5.0, 5.0)
    inside = reading[np.abs(reading) < 5.0]
    np.testing.assert_array_equal(inside, np.rint(inside / 0.3) * 0.3)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("delay_samples", -1.0),
        ("delay_samples", 1e6),
        ("gain_error", -1.0),
        ("noise", -0.1),
        ("resolution", -0.1),
        ("full_scale", 0.0),
        ("bias", float("nan")),
        ("colour", 1.0),
        ("filter", 6.0),
    ],
)
def test_wrong_sensor_file_is_refused_in_one_line(tmp_path: Path, key: str, value: float) -> None:
    path = tmp_path / "sensors.yaml"
    number = ".nan" if np.isnan(value) else f"{value:g}"
    path.write_text(f"spool: {{{key}: {number}}}\n", "utf-8")
    with pytest.raises(InputError, match=rf"sensors\.yaml: spool\.{key}: ") as caught:
        load_sensors(path)
    assert "\n" not in str(caught.value)


def test_sensor_file_gives_both_sensors(tmp_path: Path) -> None:
    path = tmp_path / "sensors.yaml"
    path.write_text(
        "body: {noise: 0.1, filter: 'causal,4,0.36'}\nspool: {delay_samples: 2.5, full_scale: 40}\n", "utf-8"
    )
    sensors = load_sensors(path)
    assert sensors.body == Sensor(noise=0.1, filter=Observation(CAUSAL, 4.0, 0.36))
    assert sensors.spool == Sensor(delay_samples=2.5, full_scale=40.0)


@pytest.mark.parametrize(
    "text",
    ["sharp", "linear,6", "linear,six,0.4", "causal,2.5,0.3", "linear,6,0.7", "mean,1,0.4", "linear,6,nan"],
)
def test_a_filter_that_none_has_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(InputError, match=r"^filter: .* like linear,6,0\.42; causal also a shape"):
        Observation.of(text)


@pytest.mark.parametrize("text", ["instants", "mean", "linear,6,0.42", "causal,4,0.36", "linear,3.5,0.4"])
def test_a_filter_is_written_as_it_is_read(text: str) -> None:
    assert str(Observation.of(text)) == text
