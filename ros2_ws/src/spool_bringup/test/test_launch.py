"""The launch file, run with stand-ins for what it builds.

`launch` and `launch_ros` are not on PyPI; a ROS 2 installation brings them. The stand-ins below keep what
the file hands over, so that its own decisions can be looked at anywhere.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

PACKAGE = Path(__file__).resolve().parent.parent
LAUNCH_FILE = PACKAGE / "launch" / "valve.launch.py"


@dataclass(frozen=True)
class LaunchConfiguration:
    name: str

    def perform(self, context: Mapping[str, str]) -> str:
        return context[self.name]


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: str
    description: str
    choices: list[str] | None = None


@dataclass
class OpaqueFunction:
    function: Callable[[Mapping[str, str]], list[Any]]


@dataclass
class IfCondition:
    predicate: LaunchConfiguration


@dataclass
class ParameterValue:
    value: LaunchConfiguration
    value_type: type


@dataclass
class LaunchDescription:
    entities: list[Any]


@dataclass
class LifecycleNode:
    """Takes keywords only, as the real one does; name and namespace are required."""

    package: str
    executable: str
    name: str
    namespace: str
    parameters: list[Any]
    output: str = "log"
    condition: IfCondition | None = field(default=None)
    respawn: bool = False
    respawn_delay: float | None = None
    respawn_max_retries: int = -1


@dataclass
class Node:
    """The host's process: takes keywords only, as the real one does."""

    package: str
    executable: str
    parameters: list[Any]
    arguments: list[str]
    output: str = "log"
    respawn: bool = False
    respawn_delay: float | None = None
    respawn_max_retries: int = -1


@pytest.fixture(name="description")
def _description(monkeypatch: pytest.MonkeyPatch) -> LaunchDescription:
    def module(name: str, **contents: object) -> None:
        made = ModuleType(name)
        made.__dict__.update(contents)
        monkeypatch.setitem(sys.modules, name, made)

    module("launch", LaunchDescription=LaunchDescription)
    module("launch.actions", DeclareLaunchArgument=DeclareLaunchArgument, OpaqueFunction=OpaqueFunction)
    module("launch.conditions", IfCondition=IfCondition)
    module("launch.substitutions", LaunchConfiguration=LaunchConfiguration)
    module("launch_ros")
    module("launch_ros.actions", LifecycleNode=LifecycleNode, Node=Node)
    module("launch_ros.parameter_descriptions", ParameterValue=ParameterValue)
    contents: dict[str, Any] = {"__file__": str(LAUNCH_FILE)}
    exec(compile(LAUNCH_FILE.read_text(encoding="utf-8"), LAUNCH_FILE, "exec"), contents)
    made: LaunchDescription = contents["generate_launch_description"]()
    return made


def nodes(description: LaunchDescription, valves_file: Path, **given: str) -> list[LifecycleNode]:
    """Return what is started with the arguments that are ``given``."""
    (function,) = (one.function for one in description.entities if isinstance(one, OpaqueFunction))
    defaults = {
        one.name: one.default_value for one in description.entities if isinstance(one, DeclareLaunchArgument)
    }
    return function({**defaults, "valves_file": str(valves_file), **given})


def write(path: Path, valves: object) -> Path:
    path.write_text(yaml.safe_dump(valves), encoding="utf-8")
    return path


def test_it_uses_only_what_the_stand_ins_offer() -> None:
    """A name that a stand-in lacks would hide behind them."""
    imported = {
        f"{node.module}.{alias.name}"
        for node in ast.walk(ast.parse(LAUNCH_FILE.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if node.module and node.module.startswith("launch")
    }
    assert imported == {
        "launch.LaunchDescription",
        "launch.actions.DeclareLaunchArgument",
        "launch.actions.OpaqueFunction",
        "launch.conditions.IfCondition",
        "launch.substitutions.LaunchConfiguration",
        "launch_ros.actions.LifecycleNode",
        "launch_ros.actions.Node",
        "launch_ros.parameter_descriptions.ParameterValue",
    }


def test_every_argument_is_described_and_defaults_exist(description: LaunchDescription) -> None:
    arguments = {one.name: one for one in description.entities if isinstance(one, DeclareLaunchArgument)}
    assert set(arguments) == {
        "valves_file",
        "params_file",
        "simulate",
        "adapt",
        "record",
        "host_processes",
        "host_sources",
        "respawn",
        "output",
        "state_folder",
        "use_sim_time",
        "autostart",
    }
    assert all(argument.description.endswith(".") for argument in arguments.values())
    for name in ("valves_file", "params_file"):
        assert Path(arguments[name].default_value).is_file()
    for name in ("simulate", "adapt", "host_sources", "record", "respawn"):
        assert arguments[name].choices == ["true", "false"]
    for name in ("use_sim_time", "autostart"):
        assert arguments[name].choices == ["", "true", "false"]
        assert arguments[name].default_value == ""
    assert arguments["simulate"].default_value == "false"
    assert arguments["respawn"].default_value == "true"


def test_two_valves_have_a_namespace_and_nodes_of_their_own_and_share_a_recorder(
    description: LaunchDescription, tmp_path: Path
) -> None:
    file = write(
        tmp_path / "valves.yaml",
        [{"namespace": "left", "valve_file": "4weh10_stiff"}, {"namespace": "plant/right"}],
    )
    made = nodes(description, file)
    assert [(one.package, one.executable, one.name, one.namespace) for one in made] == [
        ("spool_estimator", "estimator", "estimator", "left"),
        ("spool_monitor", "monitor", "monitor", "left"),
        ("spool_sim", "simulator", "simulator", "left"),
        ("spool_stream", "adapter", "adapter", "left"),
        ("spool_estimator", "estimator", "estimator", "plant/right"),
        ("spool_monitor", "monitor", "monitor", "plant/right"),
        ("spool_sim", "simulator", "simulator", "plant/right"),
        ("spool_stream", "adapter", "adapter", "plant/right"),
        ("spool_bag", "recorder", "recorder", ""),
    ]
    conditions = [one.condition.predicate.name if one.condition else None for one in made]
    assert conditions == [*[None, None, "simulate", "adapt"] * 2, "record"]
    assert [one.parameters[1] for one in made[:8]] == [
        {"valve_file": "4weh10_stiff"},
        {},
        {"valve_file": "4weh10_stiff"},
        {},
        {},
        {},
        {},
        {},
    ]
    assert made[8].parameters[1] == {"valves": ["left", "plant/right"], "number_output": True}


def test_what_is_not_given_is_left_to_the_parameter_file(
    description: LaunchDescription, tmp_path: Path
) -> None:
    """Parameters that a launch file passes rule over those of the file."""
    params = write(tmp_path / "my.yaml", {"/**/recorder": {"ros__parameters": {"output": "mine"}}})
    made = nodes(description, PACKAGE / "config" / "valves.yaml", params_file=str(params))
    assert all(one.parameters[0] == str(params) for one in made)
    passed = {name for one in made for name in one.parameters[1]}
    assert passed == {"valve_file", "valves", "number_output"}
    given = {"output": "bag", "autostart": "false", "use_sim_time": "true", "respawn": "false"}
    made = nodes(description, PACKAGE / "config" / "valves.yaml", **given)
    for one in made:
        for name in ("autostart", "use_sim_time"):
            assert one.parameters[1][name] == ParameterValue(LaunchConfiguration(name), bool)
    assert made[-1].parameters[1]["output"] == ParameterValue(LaunchConfiguration("output"), str)


def test_a_node_that_ended_is_started_again_but_not_for_ever(description: LaunchDescription) -> None:
    file = PACKAGE / "config" / "valves.yaml"
    for one in nodes(description, file):
        assert one.respawn
        assert one.respawn_delay == 2.0
        assert 5 <= one.respawn_max_retries <= 100
    made = nodes(description, file, respawn="false")
    assert not any(one.respawn for one in made)
    assert "number_output" not in made[-1].parameters[1]


def test_a_valve_has_one_source(description: LaunchDescription) -> None:
    with pytest.raises(ValueError, match=r"^adapt: with simulate each valve has two sources"):
        nodes(description, PACKAGE / "config" / "valves.yaml", simulate="true", adapt="true")


def test_a_host_takes_the_place_of_all_estimators_and_monitors(description: LaunchDescription) -> None:
    made = nodes(description, PACKAGE / "config" / "valves.yaml", host_processes="2", simulate="true")
    executables = [one.executable for one in made]
    assert executables[0] == "host"
    assert made[0].arguments == ["--processes", "2"]
    assert not {"estimator", "monitor"} & set(executables)
    assert executables.count("recorder") == 1


def test_a_host_runs_the_sources_on_request(description: LaunchDescription) -> None:
    file = PACKAGE / "config" / "valves.yaml"
    made = nodes(description, file, host_processes="2", host_sources="true", simulate="true")
    assert [one.executable for one in made if one.executable != "adapter"] == ["host", "recorder"]
    assert made[0].parameters[1]["source"] == "simulator"
    for arguments in ({"host_processes": "2"}, {"simulate": "true"}):
        with pytest.raises(ValueError, match=r"^host_sources: needs"):
            nodes(description, file, host_sources="true", **arguments)


@pytest.mark.parametrize("argument", ["params_file", "valves_file"])
def test_a_missing_file_is_refused(description: LaunchDescription, tmp_path: Path, argument: str) -> None:
    """Nodes would start on their defaults."""
    missing = {"params_file": str(PACKAGE / "config" / "valve.yaml"), argument: str(tmp_path / "nofile.yaml")}
    with pytest.raises(ValueError, match=rf"^{argument}: .*nofile.yaml is no file"):
        nodes(description, Path(missing.pop("valves_file", PACKAGE / "config" / "valves.yaml")), **missing)


def test_the_monitors_keep_their_state_where_it_is_said(description: LaunchDescription) -> None:
    made = nodes(description, PACKAGE / "config" / "valves.yaml", state_folder="/var/lib/spool")
    folder = ParameterValue(LaunchConfiguration("state_folder"), str)
    told = [one.executable for one in made if one.parameters[1].get("state_folder") == folder]
    assert told == ["monitor", "monitor"]


def test_the_shipped_list_is_taken(description: LaunchDescription) -> None:
    assert len(nodes(description, PACKAGE / "config" / "valves.yaml")) == 9


@pytest.mark.parametrize(
    ("valves", "said"),
    [
        ([{"namespace": "a", "colour": "red"}], "entry 1: unknown key colour"),
        ([{"namespace": "a"}, {"valve_file": "4weh10_soft"}], "entry 2 has no namespace"),
        ([{"namespace": "a"}, {"namespace": "a"}], "a namespace stands twice"),
        ([{"namespace": "a"}, {"namespace": "/a"}], "a namespace stands twice"),
        (["a"], "entry 1 has no namespace"),
        ([], "give a list of valves"),
        ({"namespace": "a"}, "give a list of valves"),
        (None, "give a list of valves"),
    ],
)
def test_a_wrong_list_is_refused_with_file_and_entry(
    description: LaunchDescription, tmp_path: Path, valves: object, said: str
) -> None:
    file = write(tmp_path / "wrong.yaml", valves)
    with pytest.raises(ValueError, match=said) as caught:
        nodes(description, file)
    assert str(caught.value).startswith(f"{file}: ")
