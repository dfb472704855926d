"""What a healthy valve looked like belongs to that valve, and is there after a restart."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State
from spool_monitor.alarm import AlarmRefusedError, Operator
from spool_monitor.detection import Detection
from spool_monitor.detectors import MonitorSettings
from spool_monitor.state_file import BaselineStage, HealthyValue
from spool_monitor.valve_state import KEPT, BaselineKeeper, healthy_values, take_up

SECOND = 1_000_000_000
EVA = Operator("Eva", 5, "looks good")
PARAMETERS = {
    "viscous_coefficient": (10.0, "N s/m"),
    "coulomb_force": (0.1, "N"),
    "spring_stiffness": (1632.0, "N/m"),
}


def estimate(second: int, shift: float = 1.0, celsius: float = math.nan) -> Estimate:
    """Return a sure estimate; ``shift`` multiplies every parameter."""
    wobble = 1.0 + 0.001 * (second % 3 - 1)
    nothing = Quantity("x", "1")
    parameters = tuple(
        Quantity(name, unit, value * wobble * shift, 1e-4 * value, Validity.VALID)
        for name, (value, unit) in PARAMETERS.items()
    )
    temperature = Quantity("oil_temperature", "deg C", celsius, 0.1, Validity.VALID)
    return Estimate(
        second * SECOND, "coulomb", State.TRACKING, second, 2000 * second, 0.0, 4.0, parameters,
        Quantity("natural_frequency", "Hz", 15.0, 0.01, Validity.VALID), nothing, nothing, nothing, nothing,
        oil_temperature=nothing if math.isnan(celsius) else temperature,
    )  # fmt: skip


def learned(
    keeper: BaselineKeeper, first: int = 1, shift: float = 1.0, celsius: float = math.nan
) -> list[bool]:
    """Show ``keeper`` and its detection 20 s of estimates; return what it had to keep."""
    told = []
    for second in range(first, first + 20):
        one = estimate(second, shift, celsius + 0.5 * (second - first))
        keeper.detection.update_estimate(one, 15.0)
        told.append(keeper.update(one))
    return told


def keeper() -> BaselineKeeper:
    return BaselineKeeper(Detection(MonitorSettings()))


def known() -> BaselineKeeper:
    made = keeper()
    made.identify("4weh10_soft", "HL68")
    learned(made)
    return made


def restarted(before: BaselineKeeper) -> BaselineKeeper:
    after = keeper()
    after.load(json.loads(json.dumps(before.dump(), allow_nan=False)))
    return after


def test_it_is_kept_once_it_is_learned() -> None:
    made = keeper()
    made.identify("4weh10_soft", "HL68")
    assert learned(made, celsius=40.0).count(True) == 1
    record = made.current
    assert record is not None
    assert (record.version, record.stage, record.valve_id) == (1, BaselineStage.LEARNED, "4weh10_soft")
    low, high = record.temperature
    assert low == 40.0
    assert 45.0 < high < 50.0
    force = record.value("coulomb_force")
    assert force is not None
    assert force.value == pytest.approx(0.1, rel=1e-3)
    assert force.standard_deviation == pytest.approx(0.1 * 0.001 * math.sqrt(2 / 3), rel=0.1)
    assert force.count >= 14
    assert -1.0 < force.correlation < 1.0


def test_nothing_is_kept_before_the_valve_is_known() -> None:
    made = keeper()
    assert not any(learned(made))
    made.identify("4weh10_soft")
    assert made.update(estimate(100))
    assert made.current is not None


def test_it_is_compared_with_after_a_restart() -> None:
    before = known()
    after = restarted(before)
    assert after.identify("4weh10_soft", "HL68")
    kept, first = healthy_values(after.detection), healthy_values(before.detection)
    # NaN, what was not measured, is not equal to itself.
    known_of = [
        [replace(one, temperature=0.0, sensitivity=0.0) for one in values] for values in (kept, first)
    ]
    assert known_of[0] == known_of[1]
    assert not any(learned(after, 100, shift=1.5))
    assert after.current is not None
    assert after.current.version == 1


@pytest.mark.parametrize(
    ("valve_id", "oil", "reason"),
    [
        ("4weh10_stiff", "HL68", "is of valve 4weh10_soft, not of 4weh10_stiff"),
        ("4weh10_soft", "HL46", "was learned with HL68, the valve runs on HL46"),
    ],
)
def test_anothers_is_refused_by_name_and_learned_anew(valve_id: str, oil: str, reason: str) -> None:
    after = restarted(known())
    with pytest.raises(InputError, match=reason):
        after.identify(valve_id, oil)
    assert healthy_values(after.detection) == ()
    assert learned(after).count(True) == 1
    assert after.current is not None
    assert (after.current.version, after.current.valve_id, after.current.oil) == (2, valve_id, oil)


@pytest.mark.parametrize("other", [("4weh10_stiff", "HL68"), ("4weh10_soft", "HL46")])
def test_another_valve_that_begins_meanwhile_is_not_compared_with_the_one_before(
    other: tuple[str, str],
) -> None:
    made = known()
    with pytest.raises(InputError, match=r"4weh10_soft|HL68"):
        made.identify(*other)
    assert made.current is None
    assert healthy_values(made.detection) == ()
    learned(made, 100, shift=1.5)
    assert made.current is not None
    assert (made.current.version, made.current.valve_id, made.current.oil) == (2, *other)


@pytest.mark.parametrize("seconds", [3, 20])
def test_a_description_that_was_wrong_for_a_while_costs_no_baseline(seconds: int) -> None:
    """Whether or not the other valve was learned meanwhile, or the monitor was restarted."""
    made = known()
    healthy = healthy_values(made.detection)
    with pytest.raises(InputError, match="4weh10_soft"):
        made.identify("4weh10_stiff", "HL68")
    for second in range(100, 100 + seconds):
        made.detection.update_estimate(estimate(second, 1.5), 15.0)
        made.update(estimate(second, 1.5))
    for keeper_then in (restarted(made), made):
        assert keeper_then.identify("4weh10_soft", "HL68")
        assert keeper_then.current is not None
        assert keeper_then.current.version == 1
        assert [one.value for one in healthy_values(keeper_then.detection)] == [one.value for one in healthy]


def test_a_valve_that_is_described_otherwise_while_it_is_learned_is_learned_from_then_on() -> None:
    made = keeper()
    made.identify("4weh10_stiff", "HL68")
    for second in range(1, 10):
        made.detection.update_estimate(estimate(second, 1.5), 15.0)
        made.update(estimate(second, 1.5))
    made.identify("4weh10_soft", "HL68")
    learned(made, 100)
    assert made.current is not None
    force = made.current.value("coulomb_force")
    assert force is not None
    assert force.value == pytest.approx(0.1, rel=1e-3)


def test_a_valve_that_names_itself_again_stays_compared_with_what_was_learned() -> None:
    made = known()
    assert not made.identify("4weh10_soft", "HL68")
    assert made.current is not None
    assert healthy_values(made.detection) != ()


def test_an_oil_that_is_not_known_fits() -> None:
    assert restarted(known()).identify("4weh10_soft", "")


def test_freezing_says_who_and_is_done_once() -> None:
    made = keeper()
    with pytest.raises(AlarmRefusedError, match="still being learned"):
        made.freeze(EVA)
    made = known()
    made.freeze(EVA)
    after = restarted(made)
    after.identify("4weh10_soft")
    assert after.current is not None
    assert (after.current.stage, after.current.who) == (BaselineStage.FROZEN, "Eva")
    with pytest.raises(AlarmRefusedError, match="frozen by Eva already"):
        after.freeze(EVA)


def test_an_older_version_can_be_taken_back() -> None:
    made = known()
    made.learn()
    learned(made, 100, shift=1.2)
    made.restore(1)
    values = {value.name: value.value for value in healthy_values(made.detection)}
    assert values["spring_stiffness"] == pytest.approx(1632.0, rel=1e-3)
    after = restarted(made)
    after.identify("4weh10_soft", "HL68")
    assert after.current is not None
    assert after.current.version == 1
    after.learn()
    learned(after, 200)
    assert after.current.version == 3
    with pytest.raises(AlarmRefusedError, match="no version 9; there are: 2, 1, 3"):
        after.restore(9)


def test_only_the_newest_versions_are_kept() -> None:
    made = known()
    for number in range(KEPT + 3):
        made.learn()
        learned(made, 100 * (number + 1))
    assert [record.version for record in made.records] == list(range(5, KEPT + 5))


@pytest.mark.parametrize(
    "content", [None, [], {"anew": False}, {"anew": False, "records": [{"valve_id": 3}]}, {"records": []}]
)
def test_what_cannot_be_read_is_refused(content: Any) -> None:
    with pytest.raises(InputError, match="the kept baseline can't be read"):
        keeper().load(content)


def test_a_value_of_an_unknown_name_is_left_alone() -> None:
    detection = Detection(MonitorSettings())
    take_up(detection, (HealthyValue("mood", "1", 1.0, 0.1, 1.0, 0.1, 5),))
    assert healthy_values(detection) == ()
    detection.relearn()


def test_a_baseline_that_is_read_late_takes_the_place_of_what_was_learned() -> None:
    before = BaselineKeeper(Detection(MonitorSettings(baseline_time=10.0)))
    before.identify("a", "HL68")
    assert any(learned(before))
    before.freeze(EVA)
    after = BaselineKeeper(Detection(MonitorSettings(baseline_time=10.0)))
    after.identify("a", "HL68")
    assert any(learned(after, shift=1.2))
    after.load(json.loads(json.dumps(before.dump())))
    assert after.current is not None
    assert (after.current.who, len(after.records)) == ("Eva", 1)
    assert healthy_values(after.detection)[0].value == before.records[0].values[0].value
