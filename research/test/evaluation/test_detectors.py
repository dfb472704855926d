"""What holds for every detector there is, found by its file."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from spool_core.block import Block
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import DETECTORS, Judgement, Moment, MonitorSettings
from spool_monitor.event import EventState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_monitor.window import Line
from spool_operation.faults import Channel, Hurt, OperationFault
from spool_operation.world import draw_day
from spool_sim.simulator import DEFAULT_START_STAMP

DAY = draw_day(7)


def stream(
    seconds: float, rests: tuple[tuple[float, float], ...] = ()
) -> Iterator[Block | tuple[int, float]]:
    """Yield the blocks of a healthy valve and, once a second, (stamp in ns, oil temperature in deg C)."""
    shaft = DAY.holds[0].shaft
    machine = DAY.shaking.machine(((0.0, shaft), (1e4, shaft)), rests)
    measuring = replace(DAY.measuring, sample_rate=1000.0)
    simulator = measuring.simulator(DAY.valve, machine, coulomb_force=DAY.coulomb, seed=4)
    for _ in range(round(seconds)):
        yield simulator.stamp, simulator.truth.oil_temperature
        yield from simulator.records(1.0)


def replay(seconds: float, hurt: Callable[[Block, float], Block] = lambda block, _: block) -> Replay:
    """Return the cores after ``seconds``, whose blocks pass ``hurt``."""
    monitor = Monitor(MonitorSettings(natural_frequency=DAY.valve.natural_frequency))
    one = Replay(Estimator(settings_for(DAY.valve)), monitor)
    for item in stream(seconds):
        if not isinstance(item, Block):
            one.update_temperature(*item)
        else:
            one.update(hurt(item, (item.stamp - DEFAULT_START_STAMP) * 1e-9))
    return one


@pytest.mark.parametrize("name", DETECTORS)
def test_each_begins_without_a_judgement_and_knows_its_kind(name: str) -> None:
    made = DETECTORS[name](MonitorSettings())
    assert made.name == name
    assert made.judgement is Judgement.UNKNOWN
    assert made.suspicious == ""
    assert made.delay >= 0.0 < made.off_delay


# Every moment shows whether the others can judge, which is what this one looks at.
@pytest.mark.parametrize("name", [name for name in DETECTORS if name != "not_judged"])
def test_a_moment_that_shows_nothing_of_what_a_detector_looks_at_tells_it_nothing(name: str) -> None:
    detection = replay(20.0).monitor.detection
    one = {detector.name: detector for detector in detection.detectors}[name]
    before = pickle.dumps(vars(one))
    nothing = Moment(10**18, 15.0, detection.reference, detection.parameters, detection.learned)
    window = Line(10**18, 15.0, 5.0, 9.0, 1.8, 1e-3, 0.9)
    unseen = nothing if "line" in one.looks_at else nothing._replace(line=window)
    assert not one.update(unseen)
    assert pickle.dumps(vars(one)) == before


def test_names_of_conditions_are_unique_and_sensors_come_first() -> None:
    conditions = Monitor().detection.conditions
    assert len({condition.name for condition in conditions.values()}) == len(conditions)
    assert len(conditions) == sum(len(entry.parts) for entry in DETECTORS.values())
    kinds = [entry.kind.name for entry in DETECTORS.values() if entry.kind.name != "data_fault"]
    assert kinds == sorted(kinds, key=lambda kind: kind != "sensor_fault")


def test_what_cannot_be_judged_is_said() -> None:
    monitor = Monitor(MonitorSettings(baseline_time=5.0))
    assert set(dict(monitor.health.judgements).values()) == {Judgement.UNKNOWN}
    both = Replay(Estimator(settings_for(DAY.valve)), monitor)
    seen = []
    for item in stream(12.0, ((8.0, 99.0),)):
        if isinstance(item, Block):
            both.update(item)
            seen.append(dict(monitor.health.judgements))
        else:
            both.update_temperature(*item)
    assert seen[35]["friction_drift"] is Judgement.LEARNING
    assert seen[75]["friction_drift"] is Judgement.JUDGED
    assert seen[-1]["friction_drift"] is Judgement.NOT_EXCITED
    assert seen[-1]["resonance"] is Judgement.NOT_EXCITED
    assert seen[-1]["stuck_spool"] is Judgement.NOT_EXCITED


@pytest.mark.parametrize(
    ("name", "channel", "size"),
    [
        ("dead", "spool", 0.02),
        ("dead", "body", 0.0),
        ("clipping", "spool", 0.8),
        ("offset", "body", 2.0),
        ("swapped", "spool", 0.0),
        ("scale", "spool", 0.65),
        ("sticking", "spool", 0.0),
    ],
)
def test_a_faulty_channel_is_named_and_nothing_is_said_of_friction(
    name: str, channel: Channel, size: float
) -> None:
    one = replay(45.0, Hurt(OperationFault(name, "", (), size=size, begin=28.0, channel=channel), 0.05, 4))
    raised = [event for event in one.events if event.state is EventState.RAISED]
    kind, cause = ("stuck_spool", "") if name == "sticking" else ("sensor_fault", name)
    # A gain that jumps is seen by its jump, and once it lasts by the ratio of the sensitivities.
    lasting = {(kind, "sensitivity")} if name == "scale" else set()
    assert {(event.kind, event.cause) for event in raised} - lasting == {(kind, cause)}
    assert 28.0 < (raised[0].stamp - DEFAULT_START_STAMP) * 1e-9 < 40.0
    if name != "offset":  # a constant is filtered away before anything is estimated
        assert dict(one.monitor.health.judgements)["friction_drift"] is Judgement.NOT_JUDGED
    facts = raised[0].facts
    assert facts.parameter
    assert np.isfinite([facts.value, facts.limit]).all()


@pytest.mark.parametrize(("seed", "gain"), [(4, 0.6), pytest.param(7, 1.5, marks=pytest.mark.slow)])
def test_what_the_estimator_still_remembers_of_a_fault_that_is_over_is_no_drift(
    seed: int, gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"{__name__}.DAY", draw_day(seed))
    fault = OperationFault("scale", "", (), size=gain, begin=45.0)
    over = Hurt(fault, 0.0, 4)
    one = replay(150.0, lambda block, second: over(block, second) if second < 60.0 else block)
    assert {event.kind for event in one.events} == {"sensor_fault"}
    assert EventState.CLEARED in {event.state for event in one.events}


def test_a_copy_goes_on_equally() -> None:
    items = [item for item in islice(stream(20.0), 220) if isinstance(item, Block)]
    one = Replay(Estimator(settings_for(DAY.valve)), Monitor())
    one.run(items[:100])
    copy = pickle.loads(pickle.dumps(one))
    for each in (one, copy):
        each.run(items[100:])
    assert repr(copy.monitor.health) == repr(one.monitor.health)
