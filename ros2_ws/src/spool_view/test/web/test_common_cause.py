"""A hundred valves lose their clock: cores, journals and topics of real monitors; a real page and browser."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.request import ProxyHandler, build_opener

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from spool_core.block import Block
from spool_core.events.event import Event
from spool_core.events.language import ENGLISH
from spool_core.node import qos
from spool_monitor.detectors import MonitorSettings
from spool_monitor.monitor import Monitor
from spool_monitor.monitor_node import to_alarm_list, to_health_message
from spool_monitor.state_file import valve_folder
from spool_monitor.valve_state import ValveState, entries_of
from spool_msgs.msg import AlarmList, ValveHealth

from .conftest import Domain
from .test_many_valves import NOW, VALVES
from .test_views import estimated

#: The valve whose dry friction rises as well.
WORN = VALVES[42]


class Valve:
    """What a monitor does but for its node: judges blocks and estimates, keeps alarms and journal."""

    def __init__(self, name: str, base: Path) -> None:
        self.name = name
        self.monitor = Monitor(MonitorSettings(natural_frequency=28.7))
        self.state = ValveState(self.monitor, valve_folder(base, name), lambda _: None)
        self.state.open()

    def lose_clock(self) -> None:
        """Take a tenth of a second of blocks, then those of an adapter whose spool sensor's clock was set."""
        shaken = np.ones(40, np.float32)
        for number in range(8):
            spool = shaken if number < 5 else np.empty(0, np.float32)
            block = Block(NOW * 10**9 + number * 20_000_000, number, 5e-4, shaken, spool)
            self.take(self.monitor.update(block))

    def wear(self) -> list[Event]:
        """Return what follows from a dry friction that rises by a fifth of its start value a second."""
        return [
            event
            for second in range(60)
            for event in self.monitor.update_estimate(
                estimated(NOW - 60 + second, coulomb_force=0.5 * (1.0 + 0.2 * max(0, second - 30)))
            )
        ]

    def take(self, events: list[Event]) -> None:
        """Keep what happened, as the node does."""
        transitions = [self.state.alarms.update(event) for event in events]
        if transitions:
            self.state.note(entries_of(transitions, None))

    def message(self) -> AlarmList:
        return to_alarm_list(self.state.alarms.shown, NOW * 10**9, "4weh10_stiff", ENGLISH)


@pytest.fixture(name="speak")
def _speak(domain_id: int) -> Iterator[Callable[[list[Valve]], None]]:
    """Return what publishes the alarms and health of valves, once a second, from one process."""
    ended, context = threading.Event(), Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = rclpy.create_node("monitors", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread: list[threading.Thread] = []

    def make(valves: list[Valve]) -> None:
        told = [
            tuple(
                node.create_publisher(kind, f"/{one.name}/{topic}", qos.state())
                for kind, topic in ((AlarmList, "alarms"), (ValveHealth, "health"))
            )
            for one in valves
        ]

        def say() -> None:
            while not ended.wait(1.0):
                for one, (alarms, health) in zip(valves, told, strict=True):
                    alarms.publish(one.message())
                    health.publish(to_health_message(one.monitor.health, "4weh10_stiff"))

        thread.append(threading.Thread(target=say))
        thread[0].start()

    yield make
    ended.set()
    for one in thread:
        one.join()
    executor.shutdown()
    node.destroy_node()
    context.shutdown()


def test_a_clock_that_all_valves_lose_is_one_entry_and_a_hundred_in_the_history(
    domain: Domain, speak: Callable[[list[Valve]], None], open_page: Callable[..., Any], tmp_path: Path
) -> None:
    """With a real fault among them two entries wait."""
    valves = {name: Valve(name, tmp_path) for name in VALVES}
    worn = valves[WORN].wear()
    for one in valves.values():
        one.lose_clock()
    speak(list(valves.values()))
    _, address = domain.page(state_folder=tmp_path)
    page = open_page(f"{address}alarms")
    page.wait_for_selector("tr[data-group='707'] >> text=100 valves: Clock step")
    assert page.inner_text("#banner") == "1 to acknowledge"
    assert page.query_selector("tr[data-alarm]") is None
    assert raised(address) == {707: set(VALVES)}
    valves[WORN].take(worn[:1])
    page.wait_for_selector("#banner >> text=2 to acknowledge")
    rows = page.query_selector_all("tr[data-alarm], tr[data-group]")
    assert {row.get_attribute("data-group") or row.get_attribute("data-alarm") for row in rows} == {
        "707",
        "friction_drift/coulomb_force",
    }
    assert raised(address) == {707: set(VALVES), 202: {WORN}}


def raised(address: str) -> dict[int, set[str]]:
    """Return the valves that each alarm was raised at, by its number, as the page's history has them."""
    reader, found = build_opener(ProxyHandler({})), dict[int, set[str]]()
    for one in json.loads(reader.open(f"{address}history.json?range=all").read())["entries"]:
        assert (one["action"], one["valve"] in found.get(one["code"], ())) == ("raise", False)
        found.setdefault(one["code"], set()).add(one["valve"])
    return found
