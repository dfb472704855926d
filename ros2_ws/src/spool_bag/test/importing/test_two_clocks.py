"""Body and spool on two clocks: offset and drift are found, and the valve behind them is unchanged."""

from __future__ import annotations

from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline
from spool_bag.importing.bag_import import import_record
from spool_bag.importing.choices import choices
from spool_bag.importing.clock_offset import clock_offset
from spool_bag.importing.logger_record import read_record
from spool_bag.importing.two_clocks import Series, merged
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_estimator.identification.fit import fit
from spool_estimator.identification.record import records_from_blocks
from spool_sim.excitation import load_excitation
from spool_sim.model import load_model
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

OFFSET, DRIFT, SECONDS, FAST = 3.7, 80e-6, 44.0, 16_000.0
VALVE = find_valve("4weh10_soft")


@cache
def motion() -> tuple[CubicSpline, CubicSpline]:
    """Return body and spool as functions of true time, limited to what the loggers can hold."""
    simulator = Simulator(VALVE, load_excitation("sweep"), sample_rate=FAST, block_size=1600)
    blocks = list(islice(simulator.records(SECONDS), round(SECONDS * FAST) // 1600))
    time = np.arange(1600 * len(blocks)) / FAST
    rows = (
        np.concatenate([getattr(block, name) for block in blocks]).astype(float) for name in ("body", "spool")
    )
    filters = (signal.butter(8, 0.42 * rate, fs=FAST, output="sos") for rate in (1000.0, 2048.0))
    body, spool = (
        CubicSpline(time, signal.sosfiltfilt(one, row)) for one, row in zip(filters, rows, strict=True)
    )
    return body, spool


def two_files(folder: Path) -> tuple[Path, Path]:
    """Write the body at 1000 Hz, and the spool at 2048 Hz by a clock that is early and fast."""
    body, spool = motion()
    shown = np.arange(round((SECONDS - 4.0) * 2048.0)) / 2048.0 + OFFSET
    rows = {
        "body": (np.arange(round((SECONDS - 4.0) * 1000.0)) / 1000.0, body, 0.0, 0.0),
        "spool": (shown, spool, OFFSET, DRIFT),
    }
    paths = []
    for name, (clock, values, offset, drift) in rows.items():
        table = np.column_stack([clock, values((clock - offset) / (1.0 + drift) + 2.0)])
        paths.append(folder / f"{name}.csv")
        np.savetxt(paths[-1], table, ["%.7f", "%.5f"], ",", header=f"time [s],{name} [m/s^2]", comments="")
    return paths[0], paths[1]


@pytest.mark.slow
def test_offset_and_drift_are_found_and_the_stiffness_is_the_valves(tmp_path: Path) -> None:
    result = import_record(two_files(tmp_path), tmp_path / "bag")
    assert result.clocks is not None
    assert result.clocks.offset == pytest.approx(OFFSET, abs=1e-3)
    assert result.clocks.drift == pytest.approx(DRIFT, abs=2e-6)
    assert abs(result.clocks.offset - OFFSET) < 4.0 * result.clocks.offset_std + 2e-5
    reader = BagReader(tmp_path / "bag")
    found = fit(records_from_blocks(reader.blocks("valve_1"), "two"), load_model("coulomb"), VALVE)
    stiffness = next(one.value for one in found.parameters if one.name == "spring_stiffness")
    assert stiffness == pytest.approx(VALVE.spring_stiffness, rel=1e-3)
    told = (tmp_path / "bag" / "metadata.yaml").read_text("utf-8")
    assert "import_clock_offset_s" in told
    assert "import_clock_drift_ppm" in told


def test_two_clocks_are_refused_where_that_is_asked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="on two clocks, and --align none says to leave them so"):
        read_record(two_files(tmp_path), how=choices(align="none"))


@pytest.mark.parametrize(("body", "spool", "slower"), [(500.0, 2048.0, "body"), (2048.0, 500.0, "spool")])
def test_the_grid_of_the_slower_channel_is_told(body: float, spool: float, slower: str) -> None:
    series = (
        Series("x", np.arange(rate) / rate, np.zeros(int(rate)), 1.0 / rate, np.zeros(0, np.int64), None)
        for rate in (body, spool)
    )
    found = merged(*series, shared_clock=True)
    assert found.note.endswith(f"; grid of 500 Hz, that of the {slower}")


@cache
def linear() -> tuple[np.ndarray, np.ndarray]:
    """Return a body at 1000 Hz, and at 2000 Hz half a second later a spool on springs of 15 Hz."""
    noise = np.random.default_rng(1).normal(size=60 * 4000)
    body = signal.sosfiltfilt(signal.butter(4, (3.0, 60.0), "bandpass", fs=4000.0, output="sos"), noise)
    ratio = np.fft.rfftfreq(body.size, 1.0 / 4000.0) / 15.0
    response = (1.0 + 0.4j * ratio) / (1.0 - ratio**2 + 0.4j * ratio)
    spool = np.fft.irfft(np.fft.rfft(body) * response, body.size)
    return body[::4], spool[2000::2]


def test_a_linear_spool_has_no_error_of_its_own() -> None:
    """The response of a mass on springs is the model: offset and drift come out to microseconds."""
    body, spool = linear()
    found = clock_offset(body, 1e-3, spool, 1.0 / 2000.0, "x")
    assert found.offset == pytest.approx(-0.5, abs=2e-5)
    assert found.drift == pytest.approx(0.0, abs=2e-7)
    assert found.natural_frequency == pytest.approx(15.0, rel=1e-2)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_deviations_of_offset_and_drift_are_those_that_noise_makes(seed: int) -> None:
    generator = np.random.default_rng(seed)
    body, spool = (row + row.std() * generator.normal(size=row.size) for row in linear())
    found = clock_offset(body, 1e-3, spool, 1.0 / 2000.0, "x")
    assert abs(found.offset + 0.5) < 4.0 * found.offset_std < 2e-3
    assert abs(found.drift) < 4.0 * found.drift_std < 1e-4
    # Line through n even points: 2 sigma / sqrt(n) at its end, sqrt(12) sigma / (60 s sqrt(n)) of slope.
    assert found.offset_std == pytest.approx(2.0 / np.sqrt(12.0) * 60.0 * found.drift_std, rel=0.2)


def test_motion_that_repeats_itself_does_not_tell_the_offset() -> None:
    time = np.arange(60_000) / 1000.0
    wave = np.sin(2.0 * np.pi * 12.0 * time)
    with pytest.raises(InputError, match="repeats itself, so that the clocks could as well be"):
        clock_offset(wave, 1e-3, np.roll(wave, 40), 1e-3, "x")


def test_channels_of_different_runs_are_refused() -> None:
    first, second = (np.random.default_rng(seed).normal(size=60_000) for seed in (1, 2))
    with pytest.raises(InputError, match=r"too little in common|repeats itself"):
        clock_offset(first, 1e-3, second, 1e-3, "x")
