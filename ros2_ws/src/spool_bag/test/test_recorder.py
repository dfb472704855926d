from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import pytest
from spool_bag.metadata import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.recorder import TOPICS, LossCount, new_bag, select_topics, valve_namespaces
from spool_core.errors import InputError

GRAPH = {
    "/valve_1/acceleration": [ACCELERATION_BLOCK],
    "/valve_1/oil_temperature": [TEMPERATURE],
    "/valve_1/simulator/transition_event": ["lifecycle_msgs/msg/TransitionEvent"],
    "/valve_1/_hidden": ["std_msgs/msg/String"],
    "/press/left/events": ["spool_msgs/msg/HealthEvent"],
    "/press/right/oil_temperature": [TEMPERATURE],
    "/robot/acceleration": ["geometry_msgs/msg/Accel"],
    "/valve_10/mixed": ["std_msgs/msg/String", "std_msgs/msg/Bool"],
    "/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"],
    "/parameter_events": ["rcl_interfaces/msg/ParameterEvent"],
    "/rosout": ["rcl_interfaces/msg/Log"],
}


def test_valves_are_found_by_our_types() -> None:
    assert valve_namespaces(GRAPH) == ["/press/left", "/valve_1"]


def test_everything_of_the_valves_is_chosen_and_nothing_else() -> None:
    """With changes of parameters: a reader has to know by which limits the valves were judged."""
    assert list(select_topics(GRAPH)) == [
        "/diagnostics",
        "/parameter_events",
        "/press/left/events",
        "/valve_1/acceleration",
        "/valve_1/oil_temperature",
        "/valve_1/simulator/transition_event",
    ]


def test_named_valves_are_expected_before_they_speak() -> None:
    chosen = select_topics(GRAPH, ["valve_10"])
    assert chosen == {
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
        **{f"/valve_10/{name}": kind for name, kind in TOPICS.items()},
    }


def test_a_valve_without_namespace_brings_only_its_own_topics() -> None:
    graph = {"/events": ["spool_msgs/msg/HealthEvent"], **GRAPH}
    assert "/events" in select_topics(graph)
    assert "/rosout" not in select_topics(graph)


def test_losses_are_counted_by_topic() -> None:
    count = LossCount()
    for topic, sequences in (("/a", (5, 6, 9, 2, 3)), ("/b", (0, 1))):
        for sequence in sequences:
            count.take(topic, sequence, 1)
    assert count.lost == {"/a": 2, "/b": 0}


def test_one_false_number_is_no_loss() -> None:
    """A wrong word in one block would otherwise count 10^18 lost blocks."""
    count = LossCount()
    for number, sequence in enumerate((*range(50), 2**60, *range(51, 60), *range(62, 70))):
        count.take("/a", sequence, 10**9 + 20_000_000 * number)
    assert count.lost == {"/a": 3}  # the block with the false number, and two that are missing


def test_every_activation_gets_a_bag_of_its_own(tmp_path: Path) -> None:
    given = str(tmp_path / "bag")
    assert new_bag(given) == tmp_path / "bag"
    assert new_bag(given, activation=2) == tmp_path / "bag_2"
    moment = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
    assert new_bag("", moment) == Path("recording_20260102T030405Z")
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="bag exists already"):
        new_bag(given)


def test_a_recorder_that_is_started_again_finds_a_free_name(tmp_path: Path) -> None:
    """Its dead predecessor left a bag under the name that the launch file gives."""
    given = str(tmp_path / "bag")
    assert new_bag(given, number=True) == tmp_path / "bag"
    for name in ("bag", "bag_1"):
        (tmp_path / name).mkdir()
    assert new_bag(given, number=True) == tmp_path / "bag_2"
