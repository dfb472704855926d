"""Which ROS arguments reach which process of a host, as the middleware itself reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from spool_bringup.host.arguments import arguments_of_nodes, arguments_of_process, names_for_all, node_name

Reader = Callable[[Sequence[str], int], dict[str, Any]]


@pytest.fixture
def host_node(domain_id: int) -> Iterator[Reader]:
    """Return name and parameters that the host's node of a process has with these arguments."""

    def start(arguments: Sequence[str], number: int) -> dict[str, Any]:
        context = Context()
        words = arguments_of_process(["--ros-args", *arguments], number)
        rclpy.init(args=words, context=context, domain_id=domain_id)
        node = Node(node_name(number), context=context, automatically_declare_parameters_from_overrides=True)
        names = ("together", "state_folder", "valves_file")
        found = {name: node.get_parameter(name).value for name in names if node.has_parameter(name)}
        found["name"] = node.get_fully_qualified_name()
        node.destroy_node()
        rclpy.shutdown(context=context)
        return found

    return start


SECTION = "{ros__parameters: {together: 0.1, state_folder: '2026'}}"


@pytest.mark.parametrize(
    "text",
    [
        f"/host: {SECTION}",
        f"host: {SECTION}",
        f"/**/host: {SECTION}",
        f"/**: {SECTION}",
        f"/*: {SECTION}",
        f"/**: {{ros__parameters: {{together: 0.4}}}}\n/host: {SECTION}",
        f"/host_1: {SECTION}\n/host: {{ros__parameters: {{together: 0.4}}}}",
    ],
)
def test_a_section_for_the_host_reaches_each_process(host_node: Reader, tmp_path: Path, text: str) -> None:
    """The last one as well for the second process: what is said of it by name rules, wherever it stands."""
    file = tmp_path / "my.yaml"
    file.write_text(text)
    for number in (0, 1, 2) if "host_1" not in text else (1,):
        found = host_node(["--params-file", str(file)], number)
        assert found == {"name": f"/{node_name(number)}", "together": 0.1, "state_folder": "2026"}


def test_a_nested_section_of_a_host_in_a_namespace_reaches_each_process(
    host_node: Reader, tmp_path: Path
) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(f"plant:\n  host: {SECTION}\n")
    for number in (0, 1):
        found = host_node(["-r", "__ns:=/plant", "--params-file", str(file)], number)
        assert found["name"] == f"/plant/{node_name(number)}"
        assert found["state_folder"] == "2026"


def test_a_name_that_a_launch_file_gives_is_numbered(host_node: Reader, tmp_path: Path) -> None:
    """Two nodes of one name would answer for each other."""
    file = tmp_path / "my.yaml"
    file.write_text(f"/watch: {SECTION}\n")
    arguments = ["-r", "__node:=watch", "--params-file", str(file), "-p", "watch:valves_file:=a.yaml"]
    for number, name in ((0, "/watch"), (1, "/watch_1")):
        expected = {"name": name, "together": 0.1, "state_folder": "2026", "valves_file": "a.yaml"}
        assert host_node(arguments, number) == expected


def test_later_files_and_rules_rule_over_earlier_ones(host_node: Reader, tmp_path: Path) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(f"/host: {SECTION}\n")
    second.write_text("/host: {ros__parameters: {together: 0.2}}\n")
    files = ["--params-file", str(first), "--params-file", str(second)]
    for number in (0, 1):
        assert host_node(files, number)["together"] == 0.2
        assert host_node(files[::-1][1::-1] + files[:2], number)["state_folder"] == "2026"


@pytest.mark.parametrize("text", ["", "- a list", "a: [", "/host: 3", "{}"])
def test_a_file_that_is_none_is_left_to_the_middleware(tmp_path: Path, text: str) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(text)
    arguments = ["--ros-args", "--params-file", str(file), "--params-file", "missing.yaml"]
    assert arguments_of_process(arguments, 1) == arguments
    assert names_for_all(arguments) == set()


def test_hosted_nodes_get_the_files_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(f"/**: {SECTION}\n/host: {{ros__parameters: {{source: none}}}}\n")
    arguments = ["--ros-args", "-r", "__node:=x", "-p", "together:=0.2", "--params-file", str(file)]
    assert arguments_of_nodes(arguments) == ["--params-file", str(file)]
    assert names_for_all(arguments) == {"together", "state_folder"}
