"""The launch file: what it starts, and what becomes of that.

`launch` and `launch_ros` are not on PyPI; a ROS 2 installation brings them. The stand-ins below keep what the
file hands over, and make of it the command lines and parameter files that launch_ros 0.26 makes. Where the
real one is installed, a test compares both.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from spool_bag.information import describe
from spool_msgs.msg import ModelEstimate, ValveHealth
from spool_tools.operations.node_processes import find_executable

if TYPE_CHECKING:
    from .conftest import System

PACKAGE = Path(__file__).resolve().parent.parent / "ros2_ws" / "src" / "spool_bringup"
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

    def evaluate(self, context: Mapping[str, str]) -> object:
        text = self.value.perform(context)
        return yaml.safe_load(text) if self.value_type is bool else self.value_type(text)


@dataclass
class LaunchDescription:
    entities: list[Any]


@dataclass(kw_only=True)
class Node:
    """Takes keywords only, as the real one does."""

    package: str
    executable: str
    name: str | None = None
    namespace: str | None = None
    parameters: list[Any] = field(default_factory=list)
    arguments: list[str] = field(default_factory=list)
    ros_arguments: list[str] | None = None
    output: str = "log"
    condition: IfCondition | None = None
    respawn: bool = False
    respawn_delay: float | None = None
    respawn_max_retries: int = -1

    def command(self, context: Mapping[str, str], folder: Path) -> list[str]:
        """Return the command line that launch_ros makes, and write its parameter files to ``folder``.

        A dictionary of parameters stands in the file under the node's name, or, where name and namespace are
        not both given, under that of all nodes.
        """
        words = [str(find_executable(self.package, self.executable)), *self.arguments]
        words += ["--ros-args", *self.ros_arguments] if self.ros_arguments is not None else []
        words += ["--ros-args"]
        words += ["-r", f"__node:={self.name}"] if self.name is not None else []
        space = None if self.namespace is None else "/" + self.namespace.strip("/")
        words += ["-r", f"__ns:={space}"] if space is not None else []
        section = "/**" if None in (self.name, space) else f"{space}/{self.name}".replace("//", "/")
        for parameters in self.parameters:
            if isinstance(parameters, dict):
                values = {
                    name: value.evaluate(context) if isinstance(value, ParameterValue) else value
                    for name, value in parameters.items()
                }
                values = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
                file = folder / f"launch_params_{len(list(folder.iterdir()))}"
                file.write_text(
                    yaml.dump({section: {"ros__parameters": values}}, default_flow_style=False), "utf-8"
                )
                words += ["--params-file", str(file)]
            else:
                words += ["--params-file", str(parameters)]
        return words


@dataclass(kw_only=True)
class LifecycleNode(Node):
    """As a node; name and namespace are required."""

    name: str
    namespace: str


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


def nodes(description: LaunchDescription, valves_file: Path, **given: str) -> list[Node]:
    """Return what is started with the arguments that are ``given``."""
    (function,) = (one.function for one in description.entities if isinstance(one, OpaqueFunction))
    return function(context_of(description, valves_file, given))


def context_of(description: LaunchDescription, valves_file: Path, given: Mapping[str, str]) -> dict[str, str]:
    """Return all arguments with their values."""
    declared = (one for one in description.entities if isinstance(one, DeclareLaunchArgument))
    return {**{one.name: one.default_value for one in declared}, "valves_file": str(valves_file), **given}


def write(path: Path, valves: object) -> Path:
    path.write_text(yaml.safe_dump(valves), encoding="utf-8")
    return path


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
        ("spool_bag", "adapter", "adapter", "left"),
        ("spool_estimator", "estimator", "estimator", "plant/right"),
        ("spool_monitor", "monitor", "monitor", "plant/right"),
        ("spool_sim", "simulator", "simulator", "plant/right"),
        ("spool_bag", "adapter", "adapter", "plant/right"),
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
    (recorder,) = (one for one in made if one.executable == "recorder")
    assert recorder.parameters[0] == str(params)
    passed = {name for one in made for name in one.parameters[-1]}
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
    assert 'source:="simulator"' in made[0].ros_arguments
    for arguments in ({"host_processes": "2"}, {"simulate": "true"}):
        with pytest.raises(ValueError, match=r"^host_sources: needs"):
            nodes(description, file, host_sources="true", **arguments)


@pytest.mark.parametrize("argument", ["params_file", "valves_file"])
def test_a_missing_file_is_refused(description: LaunchDescription, tmp_path: Path, argument: str) -> None:
    """Nodes would start on their defaults."""
    missing = {"params_file": str(PACKAGE / "config" / "valve.yaml"), argument: str(tmp_path / "nofile.yaml")}
    with pytest.raises(ValueError, match=rf"^{argument}: .*nofile.yaml is no file"):
        nodes(description, Path(missing.pop("valves_file", PACKAGE / "config" / "valves.yaml")), **missing)


def test_files_given_in_place_of_each_other_are_recognised(
    description: LaunchDescription, tmp_path: Path
) -> None:
    valve = write(tmp_path / "my_valve.yaml", {"id": "a", "moving_mass": 0.18, "spring_stiffness": 1632.0})
    shipped = PACKAGE / "config"
    with pytest.raises(ValueError, match=r"^params_file: .*my_valve.yaml: this is a valve description: "):
        nodes(description, shipped / "valves.yaml", params_file=str(valve))
    with pytest.raises(ValueError, match=r"^params_file: .*valves.yaml: this is a list of valves: "):
        nodes(description, shipped / "valves.yaml", params_file=str(shipped / "valves.yaml"))
    with pytest.raises(ValueError, match=r"/valve.yaml: this is a parameter file of nodes: "):
        nodes(description, shipped / "valve.yaml")


@pytest.mark.parametrize("section", ["monitor", "/valve_7/monitor", "monitors/monitor"])
def test_a_section_that_reaches_no_node_of_the_launch_is_refused(
    description: LaunchDescription, tmp_path: Path, section: str
) -> None:
    params = tmp_path / "mine.yaml"
    params.write_text(f"{section}:\n  ros__parameters: {{coulomb_change: 0.3}}\n", "utf-8")
    with pytest.raises(ValueError, match=rf"section /?{section} is for no node of this launch: write"):
        nodes(description, PACKAGE / "config" / "valves.yaml", params_file=str(params))


def test_a_file_for_one_kind_of_node_is_given_to_these_nodes_alone(
    description: LaunchDescription, tmp_path: Path
) -> None:
    params = tmp_path / "mine.yaml"
    params.write_text("/**/monitor:\n  ros__parameters: {coulomb_change: 0.3}\n", "utf-8")
    made = nodes(description, PACKAGE / "config" / "valves.yaml", params_file=str(params))
    assert {node.executable for node in made if str(params) in node.parameters} == {"monitor"}


def test_the_monitors_keep_their_state_where_it_is_said(description: LaunchDescription) -> None:
    made = nodes(description, PACKAGE / "config" / "valves.yaml", state_folder="/var/lib/spool")
    folder = ParameterValue(LaunchConfiguration("state_folder"), str)
    told = [one.executable for one in made if one.parameters[1].get("state_folder") == folder]
    assert told == ["monitor", "monitor"]


@pytest.mark.parametrize(
    ("valves", "said"),
    [
        ([{"namespace": "a", "colour": "red"}], "entry 1: unknown key colour"),
        ([{"namespace": "a"}, {"valve_file": "4weh10_soft"}], "entry 2 has no namespace"),
        ([{"namespace": "a"}, {"namespace": "a"}], "duplicate namespace"),
        ([{"namespace": "a"}, {"namespace": "/a"}], "duplicate namespace"),
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


@pytest.mark.parametrize("processes", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_launched_host_monitors_each_valve_as_the_parameter_file_asks(
    system: System, description: LaunchDescription, tmp_path: Path, processes: int
) -> None:
    entries = [
        {"namespace": "left", "valve_file": "4weh10_soft"},
        {"namespace": "plant/right", "valve_file": "4weh10_stiff"},
    ]
    valves = write(tmp_path / "valves.yaml", entries)
    sections = {
        "/**": {"use_sim_time": False},
        "/host": {"together": 0.1, "state_folder": str(tmp_path / "kept")},
        "/**/estimator": {"memory": 2.0},
        "/left/estimator": {"memory": 3.0},
    }
    text = {name: {"ros__parameters": values} for name, values in sections.items()}
    given = {"params_file": str(write(tmp_path / "my.yaml", text)), "host_processes": str(processes)}
    files = tmp_path / "files"
    files.mkdir()
    context = context_of(description, valves, {**given, "simulate": "true", "output": "2026"})
    heard = [
        system.listen(kind, f"/{valve['namespace']}/{topic}", latched=True)
        for valve in entries
        for kind, topic in ((ModelEstimate, "estimate"), (ValveHealth, "health"))
    ]
    for node in started(description, context):
        system.run(node.command(context, files), f"/{node.namespace or ''}/{node.executable}")
    system.until(lambda: all(len(topic.heard) >= 2 for topic in heard), "each valve is estimated and judged")
    hosts = ["/host", "/host_1"][:processes]
    assert [system.state(name) for name in hosts] == ["active"] * processes
    assert [system.parameter(name, "together") for name in hosts] == [0.1] * processes
    for valve, memory in (("left", 3.0), ("plant/right", 2.0)):
        assert system.parameter(f"/{valve}/estimator", "memory") == memory
        assert system.parameter(f"/{valve}/monitor", "state_folder") == str(tmp_path / "kept")
    recorder = next(process for process in system.processes if process.name.endswith("recorder"))
    assert recorder.end() == 0
    recorded = {one.name.strip("/"): one.blocks for one in describe(tmp_path / "2026").valves}
    assert set(recorded) == {"left", "plant/right"}
    assert min(recorded.values()) > 50
    assert all(process.alive for process in system.processes if process is not recorder)


GIVEN: tuple[dict[str, str], ...] = (
    {},
    {"host_processes": "2", "state_folder": "/tmp/2026", "autostart": "false", "use_sim_time": "true"},
    {"host_processes": "1", "simulate": "true", "host_sources": "true", "output": "2026", "record": "true"},
    {"simulate": "true", "output": "007", "state_folder": "on", "autostart": "true", "respawn": "false"},
)


@pytest.mark.skipif(find_spec("launch_ros") is None, reason="launch_ros comes with a ROS 2 installation only")
@pytest.mark.parametrize("given", GIVEN, ids=lambda given: " ".join(given) or "nothing given")
def test_launch_ros_makes_the_commands_and_files_that_the_stand_ins_make(
    tmp_path: Path, request: pytest.FixtureRequest, given: dict[str, str]
) -> None:
    entries = [{"namespace": "left", "valve_file": "on"}, {"namespace": "plant/right"}]
    valves = write(tmp_path / "valves.yaml", entries)
    real = list(_commands_of_launch_ros(valves, given))
    description = request.getfixturevalue("description")
    folder = tmp_path / "files"
    folder.mkdir()
    context = context_of(description, valves, given)
    expected = [one.command(context, folder) for one in started(description, context)]
    assert [_resolved(one) for one in real] == [_resolved(one) for one in expected]


def started(description: LaunchDescription, context: Mapping[str, str]) -> list[Node]:
    """Return the nodes whose condition is met."""
    (function,) = (one.function for one in description.entities if isinstance(one, OpaqueFunction))
    return [
        one
        for one in function(context)
        if one.condition is None or one.condition.predicate.perform(context) == "true"
    ]


def _commands_of_launch_ros(valves: Path, given: Mapping[str, str]) -> Iterator[list[str]]:
    from launch import LaunchContext  # noqa: PLC0415 - only with a ROS 2 installation
    from launch.actions import OpaqueFunction as RealFunction  # noqa: PLC0415
    from launch.launch_description_sources import PythonLaunchDescriptionSource  # noqa: PLC0415
    from launch.utilities import perform_substitutions  # noqa: PLC0415

    context = LaunchContext()
    context.launch_configurations.update(given, valves_file=str(valves))
    source = PythonLaunchDescriptionSource(str(LAUNCH_FILE))
    for entity in source.get_launch_description(context).entities:
        made = entity.execute(context)
        if not isinstance(entity, RealFunction):
            continue
        for node in made:
            if node.condition is None or node.condition.evaluate(context):
                node._perform_substitutions(context)
                names = {"name": f"__node:={node._Node__expanded_node_name}"}
                names |= {"ns": f"__ns:={node._Node__expanded_node_namespace}"}
                context.extend_locals({"ros_specific_arguments": names})
                yield [perform_substitutions(context, word) for word in node.cmd]


def _resolved(words: list[str]) -> list[str]:
    """Return a command line with the contents of parameter files instead of their names."""
    return [
        Path(word).read_text("utf-8") if before == "--params-file" else word
        for before, word in zip(["", *words], words, strict=False)
    ]
