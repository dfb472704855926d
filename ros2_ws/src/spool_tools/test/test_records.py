from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_report.records.record_loading import (
    Recording,
    Selection,
    check,
    divided,
    load_data,
    load_recording,
    load_recordings,
)
from spool_report.requests import Part
from spool_sim.valve import find_valve
from spool_tools.cli import main

BAGS = Path(__file__).resolve().parents[4] / "bags"
MakeBag = Callable[[Path, Mapping[str, Any]], Path]


def record(samples: int, period: float = 1e-3, noise: float = 1.0) -> Record:
    generator = np.random.default_rng(samples)
    rows = noise * generator.standard_normal((2, samples))
    return Record("made", 0, period, rows[0], rows[1])


# Bags and CSV files.


def test_a_bag_and_the_csv_made_of_it_hold_the_same_record(tmp_path: Path) -> None:
    assert main(["export", str(BAGS / "practice_03"), "--out", str(tmp_path / "record.csv")]) == 0
    (of_bag,) = load_recording(BAGS / "practice_03").stretches
    (of_csv,) = load_recording(tmp_path / "record.csv").stretches
    assert of_csv.sample_period == pytest.approx(of_bag.sample_period, rel=1e-9)
    np.testing.assert_allclose(of_csv.body, of_bag.body, atol=1e-6)
    np.testing.assert_allclose(of_csv.spool, of_bag.spool, atol=1e-6)


def test_a_bag_takes_no_units(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a bag states its units and rate"):
        load_recording(BAGS / "practice_03", Part(unit=["body=g"]).selection())


def test_a_lost_block_divides_a_record_and_time_goes_on(
    make_bag: MakeBag, recorded: Any, tmp_path: Path
) -> None:
    bag = make_bag(tmp_path / "bag", {"valve_1": recorded(seconds=2.0, lost=(50,))})
    first, second = load_recording(bag).stretches
    assert first.body.size == 50 * 40
    assert second.body.size == 49 * 40
    assert second.first_sample == 51 * 40


def test_a_gap_in_a_csv_divides_it_and_own_names_are_mapped(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(0, 100), np.arange(150, 250)]) * 1e-3
    rows = "\n".join(f"{t:.4f},{t},{2 * t}" for t in time.tolist())
    (tmp_path / "own.csv").write_text(f"t,ch1,ch2\n{rows}\n", "utf-8")
    chosen = Part(columns="time_s=t,body_m_s2=ch1,spool_m_s2=ch2").selection()
    first, second = load_recording(tmp_path / "own.csv", chosen).stretches
    assert (first.body.size, second.body.size) == (100, 100)
    assert second.first_sample == 150
    np.testing.assert_allclose(second.spool, 2.0 * second.body)


def test_oil_temperature_comes_along_and_its_holes_are_filled(tmp_path: Path) -> None:
    rows = "\n".join(f"{0.001 * n:.3f},1.0,2.0,{20 + n if n % 4 == 0 else ''}" for n in range(9))
    (tmp_path / "warm.csv").write_text(f"time_s,body_m_s2,spool_m_s2,oil_temperature_C\n{rows}\n", "utf-8")
    (stretch,) = load_recording(tmp_path / "warm.csv").stretches
    assert stretch.oil_temperature is not None
    np.testing.assert_allclose(stretch.oil_temperature, 20.0 + np.arange(9))


# Which valve.


def test_of_several_valves_one_must_be_named(make_bag: MakeBag, recorded: Any, tmp_path: Path) -> None:
    held = {"left": recorded(seconds=1.0), "right": recorded("4weh10_stiff", seconds=1.5)}
    bag = make_bag(tmp_path / "bag", held)
    with pytest.raises(InputError, match="it holds left, right: choose one with --name"):
        load_recordings([bag], None)
    with pytest.raises(InputError, match="no valve 'middle': the bag has left, right"):
        load_recordings([bag], None, Selection("middle"))
    (one,), valve = load_recordings([bag], None, Selection("right"))
    assert valve == find_valve("4weh10_stiff")
    assert one.duration == pytest.approx(1.5)
    # Its name says as much as a description where the bag holds one.
    (same,), described = load_recordings([bag], "right")
    assert described == valve
    assert same.duration == one.duration
    # A description given by hand counts.
    assert load_recordings([bag], "4weh10_soft", Selection("right"))[1] == find_valve("4weh10_soft")


def test_a_valve_that_nothing_describes_is_asked_for() -> None:
    with pytest.raises(InputError, match="does not describe its valve: name a valve file with --valve"):
        load_recordings([BAGS / "practice_03"], None)
    with pytest.raises(InputError, match="no such valve file; give one of 4weh10_soft"):
        load_recordings([BAGS / "practice_03"], "4weh10_sft")


def test_bags_of_different_valves_are_not_mixed(make_bag: MakeBag, recorded: Any, tmp_path: Path) -> None:
    soft = make_bag(tmp_path / "soft", {"valve_1": recorded(seconds=1.0)})
    stiff = make_bag(tmp_path / "stiff", {"valve_1": recorded("4weh10_stiff", seconds=1.0)})
    with pytest.raises(InputError, match="describe different valves: choose one with --valve"):
        load_recordings([soft, stiff], None)
    assert len(load_recordings([soft, stiff], "4weh10_soft")[0]) == 2


# Which time.


@settings(max_examples=20)
@given(start=st.floats(0.0, 0.9), stop=st.floats(1.0, 45.0))
def test_start_and_stop_are_counted_from_the_first_sample(start: float, stop: float) -> None:
    (whole,) = load_recording(BAGS / "practice_04").stretches
    (some,) = load_recording(BAGS / "practice_04", Selection(start=start, stop=stop)).stretches
    first = some.first_sample
    assert start <= first * some.sample_period + 1e-9 < start + some.sample_period + 2e-9
    expected = min(stop, whole.duration) - start
    assert some.duration == pytest.approx(expected, abs=2.0 * some.sample_period)
    np.testing.assert_array_equal(some.spool, whole.spool[first : first + some.spool.size])


def test_no_time_left_is_said() -> None:
    with pytest.raises(InputError, match=r"practice_04: no sample from --start 50 s on: it is 40\.0 s long"):
        load_recording(BAGS / "practice_04", Selection(start=50.0))
    with pytest.raises(InputError, match="use 0 <= start < stop"):
        Selection(start=2.0, stop=1.0)


# What is fitted and what is held out.


@given(samples=st.lists(st.integers(100, 60_000), min_size=1, max_size=4, unique=True))
def test_every_sample_is_fitted_or_held_out_once(samples: list[int]) -> None:
    records = [record(count) for count in samples]
    fitted, held = divided(records)
    assert sum(one.body.size for one in (*fitted, *held)) == sum(samples)
    for whole in records:
        parts = [one for one in (*fitted, *held) if np.isin(one.body[0], whole.body)]
        parts.sort(key=lambda one: one.start)
        np.testing.assert_array_equal(np.concatenate([one.body for one in parts]), whole.body)


def test_a_quarter_is_held_out_of_what_is_long_enough() -> None:
    fitted, held = divided([record(40_000)])
    assert sum(one.duration for one in held) == pytest.approx(10.0)
    assert len(fitted) == 3
    assert not divided([record(9_000)])[1]


def test_records_named_to_be_held_out_leave_the_others_whole() -> None:
    data = load_data([BAGS / "practice_03"], "4weh10_soft", Selection(stop=20.0), [BAGS / "practice_01"])
    assert data.seconds == pytest.approx(20.0)
    assert sum(one.duration for one in data.held_out) == pytest.approx(40.0, abs=0.1)


# What cannot be used.


def test_noise_is_no_motion_and_a_shaken_body_is() -> None:
    noise = Recording(Path("still"), (record(20_000, noise=0.05),), None)
    with pytest.raises(InputError, match="still: no excitation: body has"):
        check(noise)
    still = record(20_000, noise=0.05)
    shaken = still.body + 0.05 * np.sin(2.0 * np.pi * 30.0 * 1e-3 * np.arange(20_000))
    check(Recording(Path("shaken"), (Record("shaken", 0, 1e-3, shaken, still.spool),), None))


def test_too_short_a_record_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"too short for an estimate.* stretch without gaps 1 s: record 20 s"
    ):
        check(Recording(Path("short"), (record(1000), record(500)), None))
