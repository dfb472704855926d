"""Records whose channels lie are refused by fits, or used with a warning, and `check` names the cause."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spool_core.block import joined
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_estimator.identification.fit import fit
from spool_report.records.record_loading import load_data, load_recording
from spool_report.requests import Selection
from spool_report.runs.record_quality import quality_of
from spool_sim.excitation import from_mapping
from spool_sim.model import load_model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

MACHINE = {
    "kind": "machine_orders", "speed_profile": [[0.0, 700.0], [12.0, 1300.0]],
    "orders": [[1.0, 8.0], [2.0, 2.0]], "broadband_rms": 1.5,
}  # fmt: skip
SENSOR = Sensor(noise=0.03)


@pytest.fixture(scope="module", name="pair")
def _pair() -> tuple[Array, Array]:
    """Body and spool of a sound valve."""
    simulator = Simulator(
        find_valve("4weh10_soft"), from_mapping(MACHINE), coulomb_force=0.1, sample_rate=1000.0,
        body_sensor=SENSOR, spool_sensor=SENSOR,
    )  # fmt: skip
    run = joined(list(simulator.records(12.0)))
    return run.body.astype(np.float64), run.spool.astype(np.float64)


def written(folder: Path, body: Array, spool: Array) -> Path:
    path = folder / "record.csv"
    rows = np.c_[np.arange(body.size) * 1e-3, body, spool]
    np.savetxt(
        path, rows, fmt="%.3f", delimiter=",", header="time_s,body_m_s2,spool_m_s2", comments=""
    )  # fmt: skip
    return path


@pytest.mark.parametrize(
    ("spoiled", "text"),
    [
        (lambda _, spool: 7.0 * spool, "sensitivity: spool reads "),
        (lambda _, spool: np.repeat(spool[::2], 2), "repeats: spool repeats its samples"),
        (lambda body, _: body, "same_channel: both channels read the same numbers"),
        (lambda _, spool: np.concatenate([spool[:6000], spool[5997:-3]]), "clock_step: from "),
    ],
    ids=["sensitivity", "repeats", "same channel", "clock step"],
)
def test_a_fit_refuses_in_one_line_what_check_names(
    tmp_path: Path, pair: tuple[Array, Array], spoiled: Callable[[Array, Array], Array], text: str
) -> None:
    path = written(tmp_path, pair[0], spoiled(*pair))
    with pytest.raises(InputError) as refused:
        load_data([path], "4weh10_soft", Selection())
    assert str(refused.value).startswith(f"{path}: {text}")
    assert "\n" not in str(refused.value)
    doubts = quality_of(load_recording(path).stretches, "record").doubts
    assert doubts[0].startswith(text)


def test_impossible_samples_are_counted_left_out_and_the_rest_is_used(
    tmp_path: Path, pair: tuple[Array, Array]
) -> None:
    body, spool = pair
    spoiled = spool.copy()
    spoiled[[0, 5000, 9000]] = -9999.0
    path = written(tmp_path, body, spoiled)
    data = load_data([path], "4weh10_soft", Selection())
    assert any("outliers: 3 impossible samples are left out" in doubt for doubt in data.doubts)
    whole = np.concatenate([one.spool for one in load_recording(path).stretches])
    assert np.abs(whole - spool).max() < 1.5


def test_a_sound_record_has_no_doubt_about_its_channels(tmp_path: Path, pair: tuple[Array, Array]) -> None:
    path = written(tmp_path, *pair)
    assert load_data([path], "4weh10_soft", Selection()).doubts == ()


def test_a_sensor_that_is_turned_round_is_doubted(tmp_path: Path, pair: tuple[Array, Array]) -> None:
    body, spool = pair
    doubts = load_data([written(tmp_path, body, -spool)], "4weh10_soft", Selection()).doubts
    assert any("opposite signs: one sensor is turned round" in doubt for doubt in doubts)


def test_a_fit_that_explains_nothing_says_so(tmp_path: Path, pair: tuple[Array, Array]) -> None:
    data = load_data([written(tmp_path, *reversed(pair))], "4weh10_soft", Selection())
    found = fit(data.fitted, load_model("coulomb"), data.valve)
    (warning,) = found.warnings
    assert "of the spool's acceleration: units of both channels, order and sign of the columns" in warning
