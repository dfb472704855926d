"""config/valve.yaml is the manual: it and the nodes' tables say the same."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from spool_bag.adapter_node import AdapterNode
from spool_bag.recorder_node import RecorderNode
from spool_core.node.managed_node import AUTOSTART, ManagedNode
from spool_estimator.estimator_node import EstimatorNode
from spool_monitor.monitor_node import MonitorNode
from spool_sim.simulator_node import SimulatorNode
from spool_sim.valve import find_valve

CONFIG = Path(__file__).resolve().parent.parent / "config"
MANUAL = CONFIG / "valve.yaml"
NODES: Mapping[str, type[ManagedNode]] = {
    "adapter": AdapterNode,
    "estimator": EstimatorNode,
    "monitor": MonitorNode,
    "recorder": RecorderNode,
    "simulator": SimulatorNode,
}


def entries() -> dict[str, dict[str, tuple[Any, str]]]:
    """Return value and comment of every parameter by node, those that are commented out included."""
    found: dict[str, dict[str, tuple[Any, str]]] = {}
    node = ""
    for line in MANUAL.read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch(r"/\*\*/(\w+):", line):
            node = match[1]
            found[node] = {}
        elif match := re.fullmatch(r"    (?:# )?(\w+): (.+?)(?:\s+# (.*))?", line):
            found[node][match[1]] = (yaml.safe_load(match[2]), match[3] or "")
    return found


@pytest.mark.parametrize("name", NODES)
def test_every_parameter_stands_in_the_manual_with_its_default_and_nothing_else(name: str) -> None:
    table = {parameter.name: parameter for parameter in (AUTOSTART, *NODES[name].PARAMETERS)}
    manual = entries()[name]
    assert set(manual) == set(table)
    for key, (value, _) in manual.items():
        assert value == table[key].default, key
        assert type(value) is type(table[key].default), key


@pytest.mark.parametrize("name", NODES)
def test_the_manual_says_the_unit(name: str) -> None:
    manual = entries()[name]
    units = {parameter.name: parameter.unit for parameter in NODES[name].PARAMETERS}
    for key, unit in units.items():
        if unit not in ("", "1"):
            words = re.split(r"[ ,;]", manual[key][1])
            assert unit in words or (unit == "Hz" and "a second" in manual[key][1]), (
                f"{key}: {manual[key][1]}"
            )


def test_the_manual_holds_these_nodes_and_no_others() -> None:
    loaded = yaml.safe_load(MANUAL.read_text(encoding="utf-8"))
    assert set(loaded) == {f"/**/{name}" for name in NODES}
    assert all(set(section) == {"ros__parameters"} for section in loaded.values())


START_NODES = """
import json, sys
import rclpy
from spool_bag.adapter_node import AdapterNode
from spool_bag.recorder_node import RecorderNode
from spool_estimator.estimator_node import EstimatorNode
from spool_monitor.monitor_node import MonitorNode
from spool_sim.simulator_node import SimulatorNode

found = []
for namespace in sys.argv[2:]:
    rclpy.init(args=["--ros-args", "-r", "__ns:=" + namespace, "--params-file", sys.argv[1]])
    values = {}
    for kind in (AdapterNode, EstimatorNode, MonitorNode, RecorderNode, SimulatorNode):
        node = kind()
        values[node.get_name()] = {entry.name: node.value(entry.name) for entry in kind.PARAMETERS}
    found.append(values)
    rclpy.shutdown()
print(json.dumps(found))
"""


def started(params: Path, *namespaces: str) -> list[dict[str, dict[str, Any]]]:
    """Return the parameters of the real nodes, started with ``params`` in each of ``namespaces``."""
    done = subprocess.run(
        [sys.executable, "-c", START_NODES, str(params), *namespaces],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env={
            **os.environ,
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
            "PYTHONPATH": ":".join(filter(None, sys.path)),
        },
    )
    assert done.returncode == 0, done.stderr
    result: list[dict[str, dict[str, Any]]] = json.loads(done.stdout.splitlines()[-1])
    return result


def test_the_nodes_take_the_file_in_any_namespace(tmp_path: Path) -> None:
    changed = tmp_path / "changed.yaml"
    text = MANUAL.read_text(encoding="utf-8")
    for before, after in (
        ("memory: 4.0", "memory: 5.0"),
        ("baseline_time: 15.0", "baseline_time: 20.0"),
        ("depth: 1000", "depth: 2000"),
        ("seed: 0", "seed: 7"),
        ("stale_after: 0.5 ", "stale_after: 0.8 "),
    ):
        assert text.count(before) == 1
        text = text.replace(before, after)
    changed.write_text(text, encoding="utf-8")
    expected = {name: {one.name: one.default for one in kind.PARAMETERS} for name, kind in NODES.items()}
    expected["adapter"]["stale_after"] = 0.8
    expected["estimator"]["memory"] = 5.0
    expected["monitor"]["baseline_time"] = 20.0
    expected["recorder"]["depth"] = 2000
    expected["simulator"]["seed"] = 7
    assert started(changed, "/", "/valve_1", "/plant/valve_1") == [expected] * 3


def test_the_list_of_valves_names_shipped_valves_once_each() -> None:
    valves = yaml.safe_load((CONFIG / "valves.yaml").read_text(encoding="utf-8"))
    assert [set(valve) for valve in valves] == [{"namespace", "valve_file"}] * len(valves)
    assert len({valve["namespace"] for valve in valves}) == len(valves) > 0
    for valve in valves:
        assert find_valve(valve["valve_file"]).id == valve["valve_file"]
