"""node-opcua's client against the server: it knows the standards, and none of our names.

`npm ci --prefix tests/node_opcua --ignore-scripts` installs it; `.ci/nightly` does both.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from spool_core.node import qos
from spool_msgs.msg import Alarm, AlarmList, ValveHealth

from ..conftest import PATIENCE
from ..opcua import OPERATOR
from ..test_conditions import SILENCE, Plant, _plant  # noqa: F401 - a fixture

HERE = Path(__file__).parent
VALVES = 100

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("SPOOL_NODE_OPCUA" not in os.environ, reason="SPOOL_NODE_OPCUA is not set: see above"),
]


def command(plant: Plant, mode: str, who: tuple[Path, Path], *more: str) -> list[str]:
    """Return the call of the client in ``mode`` with certificate and key."""
    files = *map(str, who), str(plant.folder.parent / "node_opcua")
    return ["node", str(HERE / "client.mjs"), mode, plant.url, *files, *more]


def looked(plant: Plant, who: tuple[Path, Path], *user: str) -> dict[str, Any]:
    done = subprocess.run(
        command(plant, "look", who, *user), capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_it_finds_machine_and_valves_and_acts_as_an_operator_only(plant: Plant) -> None:
    untrusted = looked(plant, plant.untrusted, *OPERATOR.values())
    assert set(untrusted) == {"refused"}
    onlooker = looked(plant, plant.trusted)
    assert onlooker["machines"] == [{"name": "press_7", "valves": ["valve_1"]}]
    assert {"name": SILENCE, "acknowledged": False} in onlooker["active"]
    assert {one.partition("=")[0] for one in onlooker["types"]} == {"DI i"}
    assert onlooker["acknowledge"] == "BadUserAccessDenied"
    assert looked(plant, plant.trusted, *OPERATOR.values())["acknowledge"] == "Good"


def test_raises_and_clears_of_100_valves_in_a_second_reach_it_in_order(plant: Plant) -> None:
    """Alarm lists come over DDS; the printed delays, from publishing to arrival, are of one clock."""
    node = plant.system.node
    names = [f"many_{number}" for number in range(VALVES)]
    lists = {one: node.create_publisher(AlarmList, f"/{one}/alarms", qos.state()) for one in names}
    health = {one: node.create_publisher(ValveHealth, f"/{one}/health", qos.state()) for one in names}

    def publish(name: str, state: int, occurrence: int) -> None:
        alarm = Alarm(name=SILENCE, kind="stale", state=state, underlying=state, severity=2, message="m")
        alarm.occurrence = occurrence
        alarm.header.stamp = node.get_clock().now().to_msg()
        lists[name].publish(AlarmList(header=alarm.header, alarms=[alarm]))

    def alive() -> None:
        for one in health.values():
            one.publish(ValveHealth(level=ValveHealth.LEVEL_OK))

    for name in names:
        publish(name, Alarm.STATE_NORMAL, 0)
    alive()
    plant.system.until(
        lambda: all(one.get_subscription_count() for one in lists.values()), "the server hears all valves"
    )
    settled = time.monotonic() + 5.0
    plant.system.until(lambda: time.monotonic() > settled, "all lists are taken")
    follower = command(plant, "follow", plant.trusted, str(2 * VALVES))
    with subprocess.Popen(follower, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while process.stdout.readline().strip() != "ready":
            assert process.poll() is None
        for state in (Alarm.STATE_UNACKNOWLEDGED, Alarm.STATE_RETURNED_UNACKNOWLEDGED):
            alive()
            begin = time.monotonic()
            for number, name in enumerate(names):
                due = begin + number / VALVES
                plant.system.until(lambda due=due: time.monotonic() >= due, "its turn")
                publish(name, state, 1)
        out = process.communicate(timeout=PATIENCE)[0]
    arrived = [one for one in json.loads(out.splitlines()[-1])["arrived"] if one[0] in names]
    for active in (True, False):
        assert [source for source, its, _ in arrived if its is active] == names
    delays = sorted(delay / 1e3 for *_, delay in arrived)
    late = delays[int(0.99 * len(delays)) - 1]
    print(f"{len(arrived)} raises and clears: median {delays[len(delays) // 2]:.2f} s, p99 {late:.2f} s")
