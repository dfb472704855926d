"""A valve file against a record: a wrong one is reported, a right one is not, no guess without data."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from spool_estimator.identification.channel_pair import ChannelPair
from spool_estimator.identification.record import Record
from spool_estimator.plausibility import check_records
from spool_sim.excitation import Multisine, Standstill
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

SOFT, STIFF = (find_valve(name) for name in ("4weh10_soft", "4weh10_stiff"))
SHAKEN = Multisine(low_frequency=10.0, high_frequency=100.0, rms=7.0)


def simulated(valve: Valve, seconds: float = 20.0, excitation: Any = SHAKEN, **changes: Any) -> Record:
    plain = Sensor(noise=0.05)
    simulator = Simulator(
        valve, excitation, sample_rate=2000.0, block_size=40, seed=3, start_stamp=1, body_sensor=plain,
        spool_sensor=plain, **{"model": "coulomb", **changes},
    )  # fmt: skip
    blocks = list(simulator.records(seconds))
    rows = (np.concatenate([getattr(block, row) for block in blocks]) for row in ("body", "spool"))
    return Record("made", 1, 1.0 / 2000.0, *(row.astype(np.float64) for row in rows))


@pytest.mark.parametrize(("valve", "other"), [(SOFT, STIFF), (STIFF, SOFT)], ids=["soft", "stiff"])
def test_the_other_valves_file_is_told_from_the_record(valve: Valve, other: Valve) -> None:
    record = simulated(valve)
    assert check_records(valve, [record]) == []
    (doubt,) = check_records(other, [record])
    assert f"says {other.natural_frequency:.3g} Hz" in doubt
    low, high = (float(end) for end in re.findall(r"95 %: ([\d.]+) to ([\d.]+) Hz", doubt)[0])
    assert low < valve.natural_frequency < high
    assert high - low < 0.1 * valve.natural_frequency


@pytest.mark.parametrize("share", [0.9, 1.1], ids="{:+.0%}".format)
def test_a_spring_within_its_tolerance_is_no_contradiction(share: float) -> None:
    filed = SOFT.model_copy(update={"spring_stiffness": share * SOFT.spring_stiffness})
    assert check_records(filed, [simulated(SOFT)]) == []


@pytest.mark.parametrize("force", [2.0, 5.0, 20.0], ids="{:g} N".format)
def test_a_spool_that_sticks_does_not_contradict_its_file(force: float) -> None:
    """Its body gives it 1.3 N rms: from 5 N on it hardly ever slips, and then nothing can be told."""
    assert check_records(SOFT, [simulated(SOFT, coulomb_force=force)]) == []


@pytest.mark.parametrize(
    "excitation",
    [Standstill(), Multisine(low_frequency=80.0, high_frequency=100.0, rms=7.0)],
    ids=["standstill", "far above the resonance"],
)
def test_a_record_that_does_not_show_the_resonance_contradicts_nothing(excitation: Any) -> None:
    for filed in (SOFT, STIFF):
        assert (
            check_records(filed, [simulated(STIFF if filed is STIFF else SOFT, excitation=excitation)]) == []
        )


def test_a_viscosity_in_other_units_is_told_from_the_damping() -> None:
    """61.2 mPa s written as 6.12 Pa s."""
    filed = SOFT.model_copy(update={"dynamic_viscosity": 100.0 * SOFT.dynamic_viscosity})
    (doubt,) = check_records(filed, [simulated(SOFT)])
    assert "dynamic_viscosity" in doubt
    # How thin the oil may become is not known from a temperature that its law does not reach.
    beyond = filed.model_copy(update={"oil_temperature": 200.0})
    assert check_records(beyond, [simulated(SOFT)]) == []


def test_hot_oil_and_a_worn_sleeve_are_no_contradiction() -> None:
    hot = SOFT.model_copy(update={"dynamic_viscosity": SOFT.dynamic_viscosity_at(80.0) / 2.0})
    assert check_records(SOFT, [simulated(hot)]) == []


def test_too_short_a_record_tells_nothing() -> None:
    assert check_records(SOFT, [simulated(STIFF, seconds=3.0)]) == []


@pytest.mark.parametrize("force", [0.0, 0.3], ids="{:g} N".format)
@pytest.mark.parametrize("valve", [SOFT, STIFF], ids=["soft", "stiff"])
def test_seconds_show_frequency_and_damping_of_the_valve_apart_from_dry_friction(
    valve: Valve, force: float
) -> None:
    record = simulated(valve, coulomb_force=force)
    swings = ChannelPair(record.body, record.spool, record.sample_period).swings(60, 0.5)
    assert len(swings) >= 15
    assert np.mean([one.frequency for one in swings]) == pytest.approx(valve.natural_frequency, rel=0.01)
    assert np.mean([one.ratio for one in swings]) == pytest.approx(valve.damping_ratio, rel=0.05)


def test_a_wrong_file_is_told_where_a_channel_clips_and_where_the_machine_starts_late() -> None:
    record = simulated(STIFF, seconds=12.0)
    top = 0.6 * float(np.abs(record.spool).max())
    still = 0.02 * np.random.default_rng(1).standard_normal((2, 140_000))
    clipped = replace(record, spool=np.clip(record.spool, -top, top))
    late = replace(
        record, body=np.r_[still[0], record.body], spool=np.r_[still[1], record.spool]
    )  # 70 s of standstill
    for shown in (clipped, late):
        (doubt,) = check_records(SOFT, [shown])
        assert "another valve's file" in doubt
        assert check_records(STIFF, [shown]) == []
