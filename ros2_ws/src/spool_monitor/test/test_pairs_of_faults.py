"""Pairs of faults in both orders: the second is raised while the first stands, or a table says why not."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pytest
from spool_core.block import Block, Samples
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.detectors.unknowable import SCALE, SENSITIVITY, TABLE, unknowable
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_sim.excitation import from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
COULOMB = 0.1
#: s until the healthy valve is learned, and in which a fault is found: a look at the pair comes every minute.
LEARNED, FOUND = 40.0, 70.0
#: s in which a fault that is repaired ends (twice a look at the pair, and its delay), and between two looks.
ENDS, STEP = 130.0, 5.0
#: Blocks a second of the simulator.
RATE = 50


def machine(frequency: float, first: float = 5.0) -> Any:
    return from_mapping(
        {
            "kind": "machine_orders",
            "speed_profile": [[0.0, 60.0 * frequency], [1e4, 60.0 * frequency]],
            "orders": [[1.0, first], [2.0, 1.75]],
            "broadband_rms": 1.5,
            "broadband_low": 6.0,
            "broadband_high": 120.0,
            "broadband_lines": 40,
        }
    )


@dataclass
class Plant:
    """A valve with its sensors, source, estimator and monitor, and what is wrong with each of them.

    Attributes:
        wrong: what the rows of a block suffer, by the fault; in the order from sensor to converter.
        sends: what the source makes of a block, by the fault.
    """

    simulator: Simulator
    estimator: Estimator
    monitor: Monitor
    generator: np.random.Generator
    wrong: dict[str, Rows] = field(default_factory=dict)
    sends: dict[str, Sends] = field(default_factory=dict)
    silent: set[str] = field(default_factory=set)
    second: bool = False
    held: Samples = field(default_factory=lambda: np.zeros(6, np.float32))
    blocks: int = 0
    quiet: dict[str, float] = field(default_factory=lambda: {"block": 0.0, "estimate": 0.0})

    def run(self, seconds: float) -> list[Event]:
        """Go on; return what began or ended."""
        events: list[Event] = []
        for _ in range(round(seconds * RATE)):
            block = self.simulator.next_block()
            self.blocks += 1
            if self.blocks % RATE == 0:
                self.estimator.update_temperature(block.stamp, 40.0)
            rows = (block.body, block.spool)
            for fault in sorted(self.wrong, key=CHAIN.index):
                rows = self.wrong[fault](self, *rows)
            sent = [replace(block, body=rows[0], spool=rows[1], source=VALVE.id)]
            for change in self.sends.values():
                sent = [one for each in sent for one in change(self, each)]
            for name in self.quiet:
                self.quiet[name] += 1.0 / RATE
            for one in () if "block" in self.silent else sent:
                events += self._take(one)
            events += self.monitor.idle(self.quiet["block"], self.quiet["estimate"])
        return events

    def _take(self, block: Block) -> list[Event]:
        self.quiet["block"] = 0.0
        verdict = self.monitor.gate.judge(block)
        estimates = self.estimator.update(block, verdict)
        events = self.monitor.update(block, verdict)
        for estimate in () if "estimate" in self.silent else estimates:
            self.quiet["estimate"] = 0.0
            events += self.monitor.update_estimate(estimate)
            if self.second:
                events += self.monitor.update_estimate(replace(estimate, source="4weh10_stiff"))
        return events

    @property
    def active(self) -> set[str]:
        """Names of the conditions that are raised."""
        return {one.name for one in self.monitor.conditions if one.active is not None}


Rows = Callable[[Plant, Samples, Samples], tuple[Samples, Samples]]
Sends = Callable[[Plant, Block], Iterable[Block]]
Act = Callable[[Plant], None]


def one(channel: str, change: Callable[[Plant, Samples], Samples]) -> Rows:
    """Return what changes one channel alone."""

    def changed(plant: Plant, body: Samples, spool: Samples) -> tuple[Samples, Samples]:
        if channel == "body":
            return change(plant, body), spool
        return body, change(plant, spool)

    return changed


def late(plant: Plant, body: Samples, spool: Samples) -> tuple[Samples, Samples]:
    held, plant.held = plant.held, spool[-6:].copy()
    return body, np.concatenate([held, spool])[: spool.size]


def wrapped(span: float, _: Plant, row: Samples) -> Samples:
    count = span / 32768
    whole = (np.round(row / count).astype(np.int64) + 32768) % 65536 - 32768
    return (whole * count).astype(np.float32)


def stuck(plant: Plant, body: Samples, _: Samples) -> tuple[Samples, Samples]:
    return body, (body + plant.generator.normal(0.0, 0.07, body.size)).astype(np.float32)


def spiked(_: Plant, row: Samples) -> Samples:
    spoiled = row.copy()
    spoiled[row.size // 2] = -9999.0
    return spoiled


#: What the rows suffer, from the valve to the converter.
WRONG: dict[str, Rows] = {
    "stuck_spool": stuck,
    "sensor_fault/sensor_swapped": lambda _, body, spool: (spool, body),
    "sensor_fault/sensor_scale": one("spool", lambda _, row: np.float32(0.65) * row),
    "data_fault/data_clock_step": late,
    "sensor_fault/sensor_offset/body": one("body", lambda _, row: row + np.float32(1.5)),
    "sensor_fault/sensor_offset/spool": one("spool", lambda _, row: row - np.float32(1.5)),
    "sensor_fault/sensor_clipping/body": one("body", lambda _, row: np.clip(row, -5.0, 5.0)),
    "sensor_fault/sensor_clipping/spool": one("spool", lambda _, row: np.clip(row, -3.0, 3.0)),
    "sensor_fault/sensor_wrap_around/body": one("body", partial(wrapped, 4.0)),
    "sensor_fault/sensor_wrap_around/spool": one("spool", partial(wrapped, 2.5)),
    "data_fault/data_repeats/body": one("body", lambda _, row: np.repeat(row[::2], 2)),
    "data_fault/data_repeats/spool": one("spool", lambda _, row: np.repeat(row[::2], 2)),
    "data_fault/outliers/body": one("body", spiked),
    "data_fault/outliers/spool": one("spool", spiked),
    "sensor_fault/sensor_dead/body": one("body", lambda _, row: np.full_like(row, 1.25)),
    "sensor_fault/sensor_dead/spool": one("spool", lambda _, row: np.full_like(row, 1.25)),
    "sensor_fault/sensor_same_channel": lambda _, body, __: (body, body.copy()),
}
CHAIN = list(WRONG)


def now_and_then(change: Sends, phase: int = 0) -> Sends:
    """Return what happens to one block in 12 s, ``phase`` blocks behind the others."""
    return lambda plant, block: change(plant, block) if plant.blocks % (12 * RATE) == phase else [block]


SENDS: dict[str, Sends] = {
    "data_fault/lost": now_and_then(lambda _, __: [], 6 * RATE),
    "data_fault/malformed/samples": now_and_then(lambda _, one: [replace(one, body=one.body * np.nan), one]),
    "data_fault/malformed/lengths": now_and_then(lambda _, one: [replace(one, body=one.body[:-1]), one]),
    "data_fault/malformed/no_time": now_and_then(lambda _, one: [replace(one, stamp=0), one]),
    "data_fault/malformed/period": now_and_then(lambda _, one: [replace(one, sample_period=-1.0), one]),
    "data_fault/rate": lambda _, block: [replace(block, sample_period=1.05 * block.sample_period)],
    "data_fault/source/foreign": now_and_then(lambda _, one: [one, replace(one, source="valve_2")]),
    "data_fault/source/second": lambda _, one: [one, replace(one, sequence=one.sequence + 10**6)],
}


def drifts(quantity: str, target: float) -> Act:
    return lambda plant: plant.simulator.set_drift(quantity, target, 2.0)


def shakes(frequency: float, first: float) -> Act:
    return lambda plant: setattr(plant.simulator, "excitation", machine(frequency, first))


#: How each fault begins and ends, by the name of its condition.
FAULTS: dict[str, tuple[Act, Act]] = {
    "friction_drift/viscous_coefficient": (
        drifts("viscous_coefficient", 0.65 * VALVE.viscous_coefficient),
        drifts("viscous_coefficient", VALVE.viscous_coefficient),
    ),
    "friction_drift/coulomb_force": (drifts("coulomb_force", 0.25), drifts("coulomb_force", COULOMB)),
    "spring_change": (
        drifts("spring_stiffness", 0.82 * VALVE.spring_stiffness),
        drifts("spring_stiffness", VALVE.spring_stiffness),
    ),
    "resonance": (shakes(VALVE.natural_frequency, 12.0), shakes(24.0, 5.0)),
    "stale/acceleration": (lambda plant: plant.silent.add("block"), lambda plant: plant.silent.clear()),
    "stale/estimate": (lambda plant: plant.silent.add("estimate"), lambda plant: plant.silent.clear()),
    "data_fault/estimate": (
        lambda plant: setattr(plant, "second", True),
        lambda plant: setattr(plant, "second", False),
    ),
}
for _where, _faults in (("wrong", WRONG), ("sends", SENDS)):
    for _name, _change in _faults.items():
        FAULTS[_name] = (
            lambda plant, where=_where, name=_name, change=_change: getattr(plant, where).update(
                {name: change}
            ),
            lambda plant, where=_where, name=_name: getattr(plant, where).pop(name),
        )


@lru_cache
def healthy() -> Plant:
    """Return the plant of which everything is learned; nobody may change it."""
    noisy = Sensor(noise=0.05)
    simulator = Simulator(
        VALVE, machine(24.0), coulomb_force=COULOMB, seed=7, start_stamp=10**18, body_sensor=noisy,
        spool_sensor=noisy,
    )  # fmt: skip
    estimator = Estimator(settings_for(VALVE))
    monitor = Monitor(MonitorSettings(natural_frequency=VALVE.natural_frequency), gate=estimator.gate)
    plant = Plant(simulator, estimator, monitor, np.random.default_rng(1))
    assert plant.run(LEARNED) == []
    return plant


def copied(plant: Plant) -> Plant:
    """Return a copy that goes its own way; the compiled motion has no state."""
    motion = plant.simulator._motion
    return copy.deepcopy(plant, {id(motion): motion})


def raised(plant: Plant, fault: str, seconds: float) -> bool:
    """Go on until ``fault`` is raised, for ``seconds`` at most; two detectors see a wrong sensitivity."""
    same = {fault} | ({SENSITIVITY} if fault == SCALE else set())
    for _ in range(round(seconds / STEP)):
        plant.run(STEP)
        if plant.active & same:
            return True
    return False


@lru_cache(maxsize=2)
def faulty(fault: str) -> Plant:
    """Return the plant in which ``fault`` is raised; nobody may change it."""
    plant = copied(healthy())
    FAULTS[fault][0](plant)
    assert raised(plant, fault, FOUND)
    return plant


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_raised_under_its_own_name_and_ends_by_itself_or_once_acknowledged(fault: str) -> None:
    plant = copied(faulty(fault))
    FAULTS[fault][1](plant)
    plant.run(ENDS)
    staying = [one for one in plant.monitor.conditions if one.stays and one.active is not None]
    assert plant.active == {one.name for one in staying}
    for one in staying:
        one.acknowledged = True
        plant.run(30.0)
    assert plant.active == set()


@pytest.mark.slow
@pytest.mark.parametrize("first", FAULTS)
def test_a_second_fault_is_raised_while_the_first_stands_or_the_table_says_why_not(first: str) -> None:
    missing, ended = [], []
    for second in FAULTS:
        if second == first or unknowable(second, by=first):
            continue
        plant = copied(faulty(first))
        FAULTS[second][0](plant)
        if not raised(plant, second, FOUND):
            missing.append(second)
        if first not in plant.active and not unknowable(first, by=second):
            ended.append(second)
    assert (missing, ended) == ([], [])


FRICTION = ("friction_drift/viscous_coefficient", "friction_drift/coulomb_force")


@pytest.mark.parametrize(("first", "second"), [FRICTION, FRICTION[::-1]])
def test_wear_and_contamination_are_raised_while_the_other_stands_and_end_by_themselves(
    first: str, second: str
) -> None:
    plant = copied(faulty(first))
    FAULTS[second][0](plant)
    assert raised(plant, second, FOUND)
    assert plant.active == {first, second}
    FAULTS[first][1](plant)
    plant.run(30.0)
    assert plant.active == {second}
    FAULTS[second][1](plant)
    plant.run(30.0)
    assert plant.active == set()


def test_lost_blocks_are_raised_while_malformed_ones_stand() -> None:
    plant = copied(faulty("data_fault/malformed/samples"))
    FAULTS["data_fault/lost"][0](plant)
    assert raised(plant, "data_fault/lost", FOUND)
    assert plant.active == {"data_fault/malformed/samples", "data_fault/lost"}


@pytest.mark.parametrize("first", ["body", "spool"])
def test_a_channel_that_clips_hides_no_other_that_does(first: str) -> None:
    names = [
        f"sensor_fault/sensor_clipping/{one}" for one in (first, {"body": "spool", "spool": "body"}[first])
    ]
    plant = copied(faulty(names[0]))
    FAULTS[names[1]][0](plant)
    assert raised(plant, names[1], FOUND)
    assert set(names) <= plant.active


def test_a_spring_that_becomes_stiffer_ends_the_alarm_of_a_softer_one() -> None:
    plant = copied(faulty("spring_change"))
    plant.simulator.set_drift("spring_stiffness", 1.15 * VALVE.spring_stiffness, 2.0)
    events = [one for one in plant.run(30.0) if one.kind == "spring_change"]
    assert [(one.cause, one.state) for one in events] == [
        ("softer", EventState.CLEARED), ("stiffer", EventState.RAISED),
    ]  # fmt: skip


def test_what_is_not_judged_is_said_beside_the_fault_that_keeps_it() -> None:
    summary = faulty("sensor_fault/sensor_dead/spool").monitor.health.summary
    assert summary.startswith("Dead sensor (spool)")
    judged = "sticking, resonance, drag, dry friction, stiffness not judged"
    assert f"{judged}: the spool accelerometer repeats one value" in summary


def test_a_silence_is_one_alarm_though_a_late_block_comes_before_the_gap_shows() -> None:
    plant = copied(healthy())
    late = [replace(plant.simulator.next_block(), source=VALVE.id) for _ in range(2)]
    events = plant._take(late[0])
    for _ in range(3 * RATE):
        plant.simulator.next_block()
        plant.quiet = {name: seconds + 1.0 / RATE for name, seconds in plant.quiet.items()}
        events += plant.monitor.idle(plant.quiet["block"], plant.quiet["estimate"])
    events += plant._take(late[1])
    events += plant.run(1.0)
    told = [(one.source, one.state) for one in events if one.kind == "stale"]
    assert told == [("acceleration", EventState.RAISED), ("acceleration", EventState.CLEARED)]


def test_the_table_names_conditions_that_exist_and_no_fault_hides_itself() -> None:
    names = {one.name for one in Monitor().conditions} | {"model_gap"}
    for row in TABLE:
        for entry in (*row.by, *row.what):
            assert any(f"{name}/".startswith(f"{entry}/") for name in names), entry
    assert not any(unknowable(name, by=name) for name in names)
