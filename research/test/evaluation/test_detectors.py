"""What holds for every detector there is, found by its file."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.uncertainty import Quantity
from spool_estimator.estimator import Estimator, settings_for
from spool_evaluation.studies.monitor import counts, judge, replay, run_case, stream, table, write_study
from spool_evaluation.studies.scenarios import SCENARIOS, ChannelFault, Scenario, draw_cases, draw_scenario
from spool_monitor.detectors import DETECTORS, LINE, Judgement, Moment, MonitorSettings
from spool_monitor.event import Event, EventState, Severity
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_monitor.window import Line
from spool_sim.simulator import DEFAULT_START_STAMP


def short(seconds: float = 40.0, **changes: object) -> Scenario:
    return replace(
        draw_scenario("healthy", np.random.default_rng(4)), seconds=seconds, sample_rate=1000.0, **changes
    )


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
    detection = replay(short(20.0)).monitor.detection
    one = {detector.name: detector for detector in detection.detectors}[name]
    before = pickle.dumps(vars(one))
    nothing = Moment(10**18, 15.0, detection.reference, detection.parameters, detection.learned)
    window = Line(10**18, 15.0, 5.0, 9.0, 1.8, 1e-3, 0.9)
    unseen = nothing if LINE in one.looks_at else nothing._replace(line=window)
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
    case = short(12.0, machine=short().machine.model_copy(update={"rests": ((8.0, 99.0),)}))
    both = Replay(Estimator(settings_for(case.drawn_valve)), monitor)
    seen = []
    for item in stream(case):
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
    ("fault", "cause"),
    [
        (ChannelFault("dead", "spool", 28.0, 0.02), "dead"),
        (ChannelFault("dead", "body", 28.0, 0.0), "dead"),
        (ChannelFault("clipping", "spool", 28.0, 0.8), "clipping"),
        (ChannelFault("offset", "body", 28.0, 2.0), "offset"),
        (ChannelFault("swapped", "spool", 28.0), "swapped"),
        (ChannelFault("scale", "spool", 28.0, 0.65), "scale"),
        (ChannelFault("stuck", "spool", 28.0), ""),
    ],
    ids=lambda value: value.kind + " " + value.channel if isinstance(value, ChannelFault) else None,
)
def test_a_faulty_channel_is_named_and_nothing_is_said_of_friction(fault: ChannelFault, cause: str) -> None:
    one = replay(short(45.0, faults=(fault,)))
    raised = [event for event in one.events if event.state is EventState.RAISED]
    kind = "stuck_spool" if fault.kind == "stuck" else "sensor_fault"
    # A gain that jumps is seen by its jump, and once it lasts by the ratio of the sensitivities.
    lasting = {(kind, "sensitivity")} if fault.kind == "scale" else set()
    assert {(event.kind, event.cause) for event in raised} - lasting == {(kind, cause)}
    assert 28.0 < (raised[0].stamp - DEFAULT_START_STAMP) * 1e-9 < 40.0
    if fault.kind != "offset":  # a constant is filtered away before anything is estimated
        assert dict(one.monitor.health.judgements)["friction_drift"] is Judgement.NOT_JUDGED
    facts = raised[0].facts
    assert facts.parameter
    assert np.isfinite([facts.value, facts.limit]).all()


@pytest.mark.parametrize("gain", [0.6, pytest.param(1.5, marks=pytest.mark.slow)])
def test_what_the_estimator_still_remembers_of_a_fault_that_is_over_is_no_drift(gain: float) -> None:
    case = short(150.0)
    valve = case.drawn_valve
    monitor = Monitor(MonitorSettings(natural_frequency=valve.natural_frequency))
    one = Replay(Estimator(settings_for(valve)), monitor)
    for item in stream(case):
        if not isinstance(item, Block):
            one.update_temperature(*item)
            continue
        hurt = 45.0 <= (item.stamp - DEFAULT_START_STAMP) * 1e-9 < 60.0
        one.update(replace(item, spool=np.float32(gain) * item.spool) if hurt else item)
    assert {event.kind for event in one.events} == {"sensor_fault"}
    assert EventState.CLEARED in {event.state for event in one.events}


def test_a_copy_goes_on_equally() -> None:
    items = [item for item in islice(stream(short(20.0)), 220) if isinstance(item, Block)]
    one = Replay(Estimator(settings_for(short().drawn_valve)), Monitor())
    one.run(items[:100])
    copy = pickle.loads(pickle.dumps(one))
    for each in (one, copy):
        each.run(items[100:])
    assert repr(copy.monitor.health) == repr(one.monitor.health)


# The study.


def test_every_kind_of_scenario_is_drawn_and_each_depends_on_its_number_alone() -> None:
    cases = draw_cases(2 * len(SCENARIOS), 5)
    assert [case.kind for case in cases] == [*SCENARIOS, *SCENARIOS]
    assert draw_cases(7, 5)[6] == cases[6]
    assert draw_cases(7, 6)[6] != cases[6]


@pytest.mark.parametrize(("seed", "number"), [(1, 4), (1, 11), (66500, 2), (66500, 14)])
def test_a_sample_of_the_study_is_found_in_time_and_nothing_else(seed: int, number: int) -> None:
    """Wear, contamination in warming oil, and what bends the gain: another speed, and a weak spring."""
    outcome = run_case(draw_cases(number + 1, seed)[number])
    assert outcome.false == ()
    assert np.isfinite(outcome.delays).all()


def test_a_study_writes_its_page_and_every_outcome(tmp_path: Path) -> None:
    missed = [judge(case, []) for case in draw_cases(2, 1)]
    page = write_study(missed, tmp_path, "./spool study monitor")
    assert "./spool study monitor" in page.read_text("utf-8")
    assert len(json.loads((tmp_path / "monitor_study.json").read_text("utf-8"))) == 2


def test_an_open_cause_counts_only_for_what_it_leaves_and_until_one_is_named() -> None:
    case = draw_cases(6, 1)[5]  # a slow wear
    one = case.expected[0]
    wear, late = (
        Event(
            DEFAULT_START_STAMP + round(second * 1e9), one.kind, EventState.RAISED, Severity.WARNING, cause,
            Quantity("viscous_coefficient_change", "1", -0.3),
        )
        for second, cause in ((one.reached, "oil_or_wear"), (one.by + 1.0, "wear"))
    )  # fmt: skip
    for events, found, left_open, false in (
        ([wear, late], 1, 1, 0),
        ([wear, replace(late, stamp=wear.stamp + 10**9)], 1, 0, 0),
        ([replace(wear, cause="sensor_or_spring")], 0, 0, 1),
    ):
        row = counts([judge(case, events)])[0]
        assert (row.found, row.left_open, row.false_alarms) == (found, left_open, false)


def test_the_table_counts_what_was_missed_and_what_was_false() -> None:
    case = draw_cases(5, 1)[4]
    missed = judge(case, [])
    row = counts([missed])[0]
    assert (row.expected, row.found, row.false_alarms) == (1, 0, 0)
    assert "0/1" in table([missed])
    assert row.highest_false == pytest.approx(3.689 / row.hours, rel=1e-3)
