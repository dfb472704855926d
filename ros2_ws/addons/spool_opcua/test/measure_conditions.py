"""Cost of OPC UA: processor time and memory of many valves, delay of alarms that come together.

./spool python ros2_ws/addons/spool_opcua/test/measure_conditions.py --valves 100 --alarms 8
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from spool_core.events.language import ENGLISH
from spool_monitor.detectors import KINDS
from spool_monitor.listener import ENDS, HeardValve
from spool_msgs.msg import Alarm, AlarmList, ModelEstimate, Quantity, ValveHealth
from spool_opcua.alarms import Conditions
from spool_opcua.machine import Machine, Nameplate
from spool_opcua.opcua_node import NAMESPACE, AddressSpace
from spool_opcua.security import PlantServer

_PAGE = os.sysconf("SC_PAGE_SIZE")


class Heard:
    """Arrivals at a client: name of the valve and s, monotonic."""

    def __init__(self) -> None:
        self.arrived: list[tuple[str, float]] = []

    def event_notification(self, event: Any) -> None:
        self.arrived.append((str(event.SourceName), time.monotonic()))


def main() -> int:
    """Measure, and print a line for each figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--valves", type=int, default=100)
    parser.add_argument("--alarms", type=int, default=8)
    given = parser.parse_args()
    asyncio.run(_measure(given.valves, given.alarms))
    return 0


async def _measure(valves: int, alarms: int) -> None:
    begin = time.process_time()
    server = PlantServer(None)
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:48410")
    index = await server.register_namespace(NAMESPACE)
    print(f"the server without conditions: {time.process_time() - begin:.2f} s, {_memory():.1f} MB")
    begin = time.process_time()
    machine = Machine(server, index, Nameplate("machine"))
    await machine.build()
    space = AddressSpace(server, index, machine)
    conditions = Conditions(server, index, machine, ENGLISH, space.folder, lambda _: Future())
    await conditions.build()
    server.iserver.answer = conditions.answer
    print(f"types, machine and notifiers: {time.process_time() - begin:.2f} s, {_memory():.1f} MB")
    heard = [_valve(f"valve_{number}", alarms, active=False) for number in range(valves)]
    begin = time.process_time()
    await space.update(heard, time.monotonic())
    print(f"components and variables of all alarms: {time.process_time() - begin:.2f} s, {_memory():.1f} MB")
    begin = time.process_time()
    await space.update(heard, time.monotonic())
    print(f"variables again, nothing changed: {time.process_time() - begin:.2f} s")
    before, begin = _memory(), time.process_time()
    await conditions.update(heard, time.monotonic())
    print(f"{valves * alarms} conditions: {time.process_time() - begin:.2f} s, {_memory() - before:.1f} MB")
    begin = time.process_time()
    heard = [_valve(f"valve_{number}", alarms, active=True) for number in range(valves)]
    sent = await conditions.update(heard, time.monotonic())
    print(f"{sent} events, no client: {time.process_time() - begin:.2f} s, {_memory() - before:.1f} MB")
    await server.start()
    try:
        await _follow(server, conditions, heard)
    finally:
        await server.stop()


async def _follow(server: PlantServer, conditions: Conditions, valves: list[HeardValve]) -> None:
    async with Client("opc.tcp://127.0.0.1:48410", timeout=60, watchdog_intervall=60) as client:
        arrivals = Heard()
        subscription = await client.create_subscription(100, arrivals)
        await subscription.subscribe_alarms_and_conditions(
            client.nodes.server, ua.ObjectIds.AlarmConditionType
        )
        begin = time.monotonic()
        number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
        await client.get_node(ua.ObjectIds.ConditionType).call_method("0:ConditionRefresh", number)
        count = sum(len(valve.alarms.alarms) for valve in valves if valve.alarms is not None)
        while sum(name != "Server" for name, _ in arrivals.arrived) < count:
            await asyncio.sleep(0.01)
        print(f"refresh of {count} conditions: {time.monotonic() - begin:.2f} s")
        arrivals.arrived.clear()
        said: dict[str, float] = {}
        for valve in valves:
            quiet = _valve(valve.name, 1, active=False)
            said[valve.name] = time.monotonic()
            await conditions.update([quiet], time.monotonic())
            await asyncio.sleep(1.0 / len(valves))
        while len(arrivals.arrived) < len(valves):
            await asyncio.sleep(0.01)
        delays = sorted(at - said[name] for name, at in arrivals.arrived)
        ordered = [name for name, _ in arrivals.arrived] == list(said)
        late = delays[int(0.99 * len(delays)) - 1]
        print(f"{len(valves)} alarms in a second: p99 {late:.2f} s, in order: {ordered}")


def _valve(name: str, alarms: int, *, active: bool) -> HeardValve:
    """Return a valve with so many alarms, of kinds in turn."""
    kinds = list(KINDS)
    listed = [
        Alarm(
            name=f"{kinds[number % len(kinds)]}/{number}", kind=kinds[number % len(kinds)],
            state=Alarm.STATE_UNACKNOWLEDGED if active else Alarm.STATE_NORMAL,
            underlying=Alarm.STATE_UNACKNOWLEDGED if active else Alarm.STATE_NORMAL,
            severity=2, occurrence=1, message="measured",
        )
        for number in range(alarms)
    ]  # fmt: skip
    names = ("coulomb_force", "viscous_coefficient", "spring_stiffness", "mass", "push", "backlash")
    estimate = ModelEstimate(
        parameters=[Quantity(name=one, unit="N", value=1.0, validity=1) for one in names]
    )
    health = ValveHealth(level=1)
    return HeardValve(
        name, health, time.monotonic(), estimate=estimate, alarms=AlarmList(alarms=listed),
        bounds={f"{one}_{end}_N": 1.0 for one in names for end in ENDS},
    )  # fmt: skip


def _memory() -> float:
    return int(Path("/proc/self/statm").read_text("utf-8").split()[1]) * _PAGE / 1e6


if __name__ == "__main__":
    sys.exit(main())
