"""Which ROS arguments reach which process of a host, as the middleware itself reads them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from spool_bringup.host import program
from spool_bringup.host.arguments import (
    FILES,
    arguments_of_nodes,
    arguments_of_process,
    economise,
    names_for_all,
    node_name,
)
from spool_bringup.host.host_process import valve_timings
from spool_core.errors import InputError
from spool_core.kernels.kernel_files import KernelCache
from spool_core.node.block_hub import TopicTimes
from spool_core.node.diagnostics import Level
from spool_core.node.parameters import refuse_other_nodes

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
    """The last one as well for the second process: a rule by name applies, wherever it stands."""
    file = tmp_path / "my.yaml"
    file.write_text(text, "utf-8")
    for number in (0, 1, 2) if "host_1" not in text else (1,):
        found = host_node(["--params-file", str(file)], number)
        assert found == {"name": f"/{node_name(number)}", "together": 0.1, "state_folder": "2026"}


def test_a_nested_section_of_a_host_in_a_namespace_reaches_each_process(
    host_node: Reader, tmp_path: Path
) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(f"plant:\n  host: {SECTION}\n", "utf-8")
    for number in (0, 1):
        found = host_node(["-r", "__ns:=/plant", "--params-file", str(file)], number)
        assert found["name"] == f"/plant/{node_name(number)}"
        assert found["state_folder"] == "2026"


def test_a_name_that_a_launch_file_gives_is_numbered(host_node: Reader, tmp_path: Path) -> None:
    """Two nodes of one name would answer for each other."""
    file = tmp_path / "my.yaml"
    file.write_text(f"/watch: {SECTION}\n", "utf-8")
    arguments = ["-r", "__node:=watch", "--params-file", str(file), "-p", "watch:valves_file:=a.yaml"]
    for number, name in ((0, "/watch"), (1, "/watch_1")):
        expected = {"name": name, "together": 0.1, "state_folder": "2026", "valves_file": "a.yaml"}
        assert host_node(arguments, number) == expected


def test_later_files_and_rules_rule_over_earlier_ones(host_node: Reader, tmp_path: Path) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(f"/host: {SECTION}\n", "utf-8")
    second.write_text("/host: {ros__parameters: {together: 0.2}}\n", "utf-8")
    files = ["--params-file", str(first), "--params-file", str(second)]
    for number in (0, 1):
        assert host_node(files, number)["together"] == 0.2
        assert host_node(files[::-1][1::-1] + files[:2], number)["state_folder"] == "2026"


@pytest.mark.parametrize("text", ["", "- a list", "a: [", "/host: 3", "{}"])
def test_a_file_that_is_none_is_left_to_the_middleware(tmp_path: Path, text: str) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(text, "utf-8")
    arguments = ["--ros-args", "--params-file", str(file), "--params-file", "missing.yaml"]
    assert arguments_of_process(arguments, 1) == arguments
    assert names_for_all(arguments) == set()


def test_hosted_nodes_get_the_files_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(f"/**: {SECTION}\n/host: {{ros__parameters: {{source: none}}}}\n", "utf-8")
    arguments = ["--ros-args", "-r", "__node:=x", "-p", "together:=0.2", "--params-file", str(file)]
    assert arguments_of_nodes(arguments) == ["--params-file", str(file)]
    assert names_for_all(arguments) == {"together", "state_folder"}


NODES = ("/valve_1/estimator", "/valve_1/monitor", "/valve_2/estimator", "/valve_2/monitor")


@pytest.mark.parametrize("section", ["monitor", "/valve_9/monitor", "/**/recorder", "/valve_1/host"])
def test_a_file_for_none_of_the_hosts_nodes_is_refused(tmp_path: Path, section: str) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(f"{section}: {SECTION}", "utf-8")
    with pytest.raises(
        InputError, match=f"only for /?{re.escape(section)}: write a section /../estimator or"
    ):
        refuse_other_nodes(["--params-file", str(file)], "/host", NODES)


@pytest.mark.parametrize("section", ["/host", "/**", "/**/monitor", "/valve_2/estimator", "/*/monitor"])
def test_a_section_for_another_valves_node_is_named_beside_those_that_are_right(
    tmp_path: Path, section: str
) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(f"{section}: {SECTION}\n/valve_9/monitor: {SECTION}\n/**/recorder: {SECTION}", "utf-8")
    doubts = refuse_other_nodes(["--params-file", str(file)], "/host", NODES)
    assert doubts == [f"{file}: section /valve_9/monitor matches no node here"]


def test_a_rule_for_a_hosted_node_is_refused_with_what_to_write() -> None:
    with pytest.raises(InputError, match=r"write a parameter file with a section /\*\*/monitor"):
        refuse_other_nodes(["-p", "monitor:coulomb_change:=0.3"], "/host", NODES)


def test_a_host_of_several_processes_says_that_it_compiles(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def compiles() -> None:
        assert KernelCache.watch is not None
        KernelCache.watch(1)
        KernelCache.watch(-1)

    monkeypatch.setattr("spool_bringup.host.host_process.warm_up_estimator", compiles)
    monkeypatch.setattr("spool_bringup.host.host_process.warm_up_monitor", lambda: None)
    program._load([], program.FirstList())
    assert "compiling the numerical kernels" in capsys.readouterr().err
    monkeypatch.setattr("spool_bringup.host.host_process.warm_up_estimator", lambda: None)
    program._load([], program.FirstList())
    assert not capsys.readouterr().err


def test_a_host_s_diagnostics_name_each_valve_with_its_share_and_its_late_and_lost_blocks() -> None:
    times = {
        "/valve_1/acceleration": TopicTimes(7, 1, work=0.5, longest_wait=0.2, age=0.3),
        "/line/valve_2/acceleration": TopicTimes(9, 2, 4, 1.5, 0.6, 0.7, 3),
        "/valve_3/acceleration": TopicTimes(),
    }
    found = valve_timings(times, 10.0, 600)
    assert [(one.task, one.level, one.message) for one in found] == [
        ("valve_1", Level.OK, "in time"),
        ("line/valve_2", Level.WARNING, "4 blocks late, 3 blocks lost"),
        ("valve_3", Level.WARNING, "no blocks"),
    ]
    assert found[1].values == {
        "blocks": 9, "blocks_late": 4, "blocks_lost": 3, "blocks_dropped": 0, "blocks_waiting": 2,
        "block_age_s": 0.7, "longest_wait_s": 0.6,
        "cpu_share": 0.15, "cpu_time_s": "1.500", "resident_B": 200,
    }  # fmt: skip
    assert [one.message for one in valve_timings(times, 10.0, 600)] == ["no blocks"] * 3


LOOPBACK = Path(__file__).resolve().parents[4] / "setup" / "this_host.xml"


@pytest.mark.parametrize("file", [None, LOOPBACK], ids=["none", "this host alone"])
def test_a_host_allocates_little_whatever_file_names_its_transports(
    file: Path | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "environ", dict.fromkeys(FILES, str(file)) if file else {})
    economise()
    found = ElementTree.parse(os.environ[FILES[0]]).getroot()
    profiles = {one.tag.rpartition("}")[2] for one in found.iter() if one.get("is_default_profile")}
    assert profiles == {"data_writer", "data_reader"} | ({"participant"} if file else set())
    assert os.environ["RMW_FASTRTPS_USE_QOS_FROM_XML"] == "1"


def test_a_file_with_profiles_of_readers_is_kept_by_a_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "own.xml"
    file.write_text('<dds><profiles><data_reader profile_name="own"/></profiles></dds>')
    monkeypatch.setattr(os, "environ", dict.fromkeys(FILES, str(file)))
    economise()
    assert [os.environ[name] for name in FILES] == [str(file)] * 2
