from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import rclpy
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import ParameterType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter as Given
from spool_core.errors import InputError
from spool_core.node.parameters import NodeParameter, declare, read_parameters, rule
from spool_core.node.running import REFUSED, one_line

from .conftest import PATIENCE

PROBE = Path(__file__).with_name("probe_node.py")
PARAMETERS = (
    NodeParameter("gain", 1.0, "A number.", "N", 0.0, 10.0),
    NodeParameter("count", 3, "A whole number.", "", 1, 5),
    NodeParameter("mode", "slow", "A word.", choices=("slow", "fast")),
)


@pytest.fixture
def bare_node(domain_id: int) -> Iterator[Callable[..., Node]]:
    """Make a node that was started with these parameters."""
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    yield lambda given: Node("bare", context=context, parameter_overrides=[given])
    rclpy.shutdown(context=context)


SECTIONS = (
    "/**",
    "/**/bare",
    "/*/bare",
    "/valve_1/bare",
    "valve_1/bare",
    "/valve_2/bare",
    "bare",
    "/valve_1/*",
)
VALUES = ("2.0", "3", "15e-6", "11.0", "-1", "high", "true", "[1.0]", "1.", ".inf")


@given(
    st.lists(
        st.tuples(st.sampled_from(SECTIONS), st.sampled_from(VALUES)),
        min_size=1,
        max_size=4,
        unique_by=lambda one: one[0],
    )
)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_parameter_file_is_read_without_ros_as_a_node_reads_it(
    domain_id: int, tmp_path: Path, sections: list[tuple[str, str]]
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "".join(f"{name}:\n  ros__parameters:\n    gain: {value}\n" for name, value in sections), "utf-8"
    )
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context, domain_id=domain_id)
    try:
        node = Node(
            "bare", namespace="/valve_1", context=context, start_parameter_services=False, enable_rosout=False
        )
        try:
            declare(node, PARAMETERS, node._parameter_overrides)
            taken = node.get_parameter("gain").value
        except InputError as error:
            taken = str(error)
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    if isinstance(taken, str):
        with pytest.raises(InputError, match="^" + re.escape(f"{file}: /valve_1/bare: parameter gain")):
            read_parameters(file, "/valve_1/bare", PARAMETERS)
    else:
        assert read_parameters(file, "/valve_1/bare", PARAMETERS).get("gain", 1.0) == taken


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("gian", 2.0, "parameter gian is unknown; this node has: count, gain, "),
        (
            "forgetting",
            "window",
            "parameter forgetting no longer exists: the estimator forgets exponentially: remove ",
        ),
        ("gain", "high", "parameter gain must be of type double"),
        ("gain", 3, "parameter gain must be of type double"),
        ("count", 2.5, "parameter count must be of type integer"),
        ("gain", 11.0, "parameter gain = 11.0 is out of range (from 0.0 to 10.0 N)"),
        ("gain", -0.1, "parameter gain = -0.1 is out of range (from 0.0 to 10.0 N)"),
        ("count", 6, "parameter count = 6 is out of range (from 1 to 5)"),
        ("mode", "quick", "parameter mode: 'quick' is not one of slow, fast"),
        ("qos_overrides./said.publisher.depth", 5, "parameter qos_overrides./said.publisher.depth: "),
    ],
)
def test_wrong_values_are_refused_with_the_reason(
    bare_node: Callable[..., Node], name: str, value: Any, said: str
) -> None:
    node = bare_node(Given(name, value=value))
    with pytest.raises(InputError, match=re.escape(f"/bare: {said}")):
        declare(node, PARAMETERS, {name: Given(name, value=value)})


TYPED = (
    NodeParameter("label", "", "Text."),
    NodeParameter("gain", 1.0, "A number."),
    NodeParameter("count", 3, "A whole number."),
    NodeParameter("flag", False, "Yes or no."),
    NodeParameter("names", [""], "Texts."),
    NodeParameter("levels", [0.0], "Numbers."),
)


def start(domain: int, words: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the parameters of a node that is started as its program is."""
    monkeypatch.setattr(sys, "argv", ["node", "--ros-args", *words])
    context = Context()
    rclpy.init(args=sys.argv, context=context, domain_id=domain)
    node = Node("bare", context=context, start_parameter_services=False, enable_rosout=False)
    try:
        declare(node, TYPED, node._parameter_overrides)
        return {parameter.name: node.get_parameter(parameter.name).value for parameter in TYPED}
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ("by", "word", "meant"),
    [
        ("; type", "label:=2026", "2026"),
        ("; type", "label:=007", "007"),
        ("; type", "label:=1e5", "1e5"),
        ("; type", "label:=on", "on"),
        ("; type", "bare:label:=12.50", "12.50"),
        ("; type", "label:=[1, 2]", "[1, 2]"),
        ("; type", "gain:=4", 4.0),
        ("; type", "gain:=-4", -4.0),
        ("; type", "count:=4.0", 4),
        ("; type", "flag:=1", True),
        ("; type", "flag:=0", False),
        ("; type", "names:=valve_1", ["valve_1"]),
        ("; type", "names:=[1, 2]", ["1", "2"]),
        ("; type", "levels:=[1, 2]", [1.0, 2.0]),
        ("; type", "levels:=3", [3.0]),
        ("; an example is", "gain:=high", 1.0),
        ("; an example is", "count:=2.5", 3),
        ("; an example is", "flag:=maybe", False),
        *(("for a text type", f"label:={text}", text) for text in ("", "[a", "'", "a: b", "{", "@x")),
    ],
)
def test_what_is_advised_for_a_value_of_the_wrong_type_works_as_it_is_typed(
    domain_id: int, monkeypatch: pytest.MonkeyPatch, by: str, word: str, meant: object
) -> None:
    """As an example, where the value has no meaning; ``for a text``, where YAML cannot read it."""
    name = word.partition(":=")[0].split(":")[-1]
    with pytest.raises((InputError, *REFUSED)) as caught:
        start(domain_id, ["-p", word], monkeypatch)
    said, _, advice = one_line(caught.value).partition(f"{by} ")
    assert by == "for a text type" or said.startswith(f"/bare: parameter {name} must be of type ")
    assert start(domain_id, shlex.split(advice), monkeypatch)[name] == meant


@given(text=st.text(st.characters(min_codepoint=32, exclude_categories=("Cs", "Cc")), max_size=12))
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(text="2026")
@example(text='a: "b" # {c} \\ \'')
def test_a_text_that_a_program_hands_on_arrives_as_it_is(
    domain_id: int, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    assert start(domain_id, rule("label", text), monkeypatch)["label"] == text


def test_a_wrong_type_in_a_file_is_shown_as_it_is_to_be_written(bare_node: Callable[..., Node]) -> None:
    asked = Given("mode", value=2026)
    with pytest.raises(InputError, match=r'not 2026; write mode: "2026" in the parameter file$'):
        declare(bare_node(asked), PARAMETERS, {"mode": asked})


def test_values_given_at_start_hold_and_each_describes_itself(
    probe: Callable[..., Any], observer: Any
) -> None:
    probe(gain=2.5, count=4, mode="fast", label="mine", use_sim_time="false")
    assert observer.get("gain").double_value == 2.5
    assert observer.get("count").integer_value == 4
    assert observer.get("mode").string_value == "fast"
    assert observer.get("label").string_value == "mine"
    gain, count, mode, label = observer.describe(["gain", "count", "mode", "label"])
    assert gain.type == ParameterType.PARAMETER_DOUBLE
    assert gain.description == "A number that may change while running. [N]"
    assert (gain.floating_point_range[0].from_value, gain.floating_point_range[0].to_value) == (0.0, 10.0)
    assert count.type == ParameterType.PARAMETER_INTEGER
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 5)
    assert mode.additional_constraints == "one of: slow, fast"
    assert label.additional_constraints == "fixed at start"
    assert gain.additional_constraints == ""


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("autostart:=1", "/probe: parameter autostart must be of type bool"),
        ("gain:=6.0", "can't configure: /probe: gain: 6.0 is above limit (5.0)"),
    ],
)
def test_wrong_and_contradicting_values_at_the_start_end_the_node_with_one_line(
    environment: dict[str, str], given: str, said: str
) -> None:
    command = [sys.executable, str(PROBE), "--ros-args", "-p", given]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert said in line


def test_structural_parameters_change_only_while_unconfigured(
    probe: Callable[..., Any], observer: Any
) -> None:
    probe(autostart="false")
    assert observer.set(size=3) == (True, "")
    assert observer.change("configure")
    successful, reason = observer.set(size=4)
    assert not successful
    assert "size changes only while the node is unconfigured" in reason
    # A whole parameter file can be loaded: what stays is no change.
    assert observer.set(size=3, label="probe", gain=2.0) == (True, "")
    assert observer.get("gain").double_value == 2.0
    assert observer.change("cleanup")
    assert observer.set(size=4) == (True, "")


def test_changes_while_running_are_judged(probe: Callable[..., Any], observer: Any) -> None:
    process = probe()
    refused: list[tuple[dict[str, object], str]] = [
        ({"gain": 10.5}, "gain"),
        ({"gain": "high"}, "Wrong parameter type"),  # in rclpy's words
        ({"count": 0}, "count"),
        ({"mode": "quick"}, "mode: 'quick' is not one of slow, fast"),
        ({"label": "other"}, "label"),
        ({"autostart": False}, "autostart"),
        ({"gain": 6.0}, "gain: 6.0 is above limit (5.0)"),
    ]
    for changes, reason in refused:
        successful, text = observer.set(**changes)
        assert not successful, changes
        assert reason in text
    assert observer.get("gain").double_value == 1.0
    assert observer.set(gain=6.0, limit=7.0) == (True, "")
    assert observer.get("gain").double_value == 6.0
    process.terminate()
    stdout, log = process.communicate(timeout=PATIENCE)
    assert "parameters changed: gain from 1.0 to 6.0, limit from 5.0 to 7.0" in log
    assert [line for line in stdout.splitlines() if line.startswith("applied")] == [
        "applied ['gain', 'limit']"
    ]
