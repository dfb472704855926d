"""Bridge to plant systems: numbers of real nodes come out, and nothing comes in."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from spool_msgs.msg import ValveHealth

from .conftest import PATIENCE, Process, System

if TYPE_CHECKING:
    from asyncua import Client

LEVEL = "valve_1.health.level"
STIFFNESS = "valve_1.estimate.spring_stiffness [N/m]"


@dataclass
class Bridged:
    """A valve that is judged, with the bridge."""

    system: System
    port: int
    monitor: Process
    bridge: Process


@pytest.fixture(scope="module", name="valve")
def _valve(
    make_system: Callable[[Path], AbstractContextManager[System]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Bridged]:
    with make_system(tmp_path_factory.mktemp("bridge")) as system:
        port = free_port()
        system.forks = False  # no other test starts it
        bridge = system.start("opcua", namespace="", port=port)
        system.forks = True
        health = system.listen(ValveHealth, "/valve_1/health", latched=True)
        monitor = system.start("monitor", baseline_time=3.0)
        system.start("estimator")
        system.start("simulator", excitation="multisine", wait_for_subscribers=2)
        system.until(lambda: health.heard and health.last.level == ValveHealth.LEVEL_OK, "data are judged")
        yield Bridged(system, port, monitor, bridge)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def until(met: Callable[[], Any], what: str) -> Any:
    end = time.monotonic() + PATIENCE
    while True:
        found = await met()
        if found:
            return found
        assert time.monotonic() < end, f"waited in vain: {what}"
        await asyncio.sleep(0.1)


async def attacks(client: Client, index: int) -> list[str]:
    """Try to change something in every way that the protocol has; return what was let through."""
    from asyncua import ua  # noqa: PLC0415 - slow to load

    level = client.get_node(ua.NodeId(LEVEL, index))
    valves = client.get_node(ua.NodeId("Valves", index))
    tries: dict[str, Callable[[], Any]] = {
        "write a value": lambda: level.write_value(1),
        "make it writable": level.set_writable,
        "add a folder": lambda: valves.add_folder(index, "mine"),
        "delete the valves": lambda: client.delete_nodes([valves], recursive=True),
        "call a method": lambda: client.nodes.server.call_method("0:GetMonitoredItems", ua.UInt32(1)),
    }
    through = []
    for name, attempt in tries.items():
        try:
            await attempt()
        except (ua.UaError, ConnectionError, TimeoutError):
            continue
        through.append(name)
    return through


def test_plant_systems_see_state_and_quality_and_change_nothing(valve: Bridged) -> None:
    from asyncua import Client, ua  # noqa: PLC0415 - slow to load

    port = valve.port
    url = f"opc.tcp://127.0.0.1:{port}"

    async def listens() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    async def work() -> None:
        await until(listens, "the server starts")
        async with Client(url, timeout=PATIENCE, watchdog_intervall=PATIENCE) as client:
            index = await client.get_namespace_index("urn:spool-suite:valves")

            async def read(name: str) -> Any:
                try:
                    node = client.get_node(ua.NodeId(name, index))
                    return await node.read_data_value(raise_on_bad_status=False)
                except ua.UaError:
                    return None

            async def good() -> Any:
                value = await read(STIFFNESS)
                return value if value is not None and value.StatusCode.is_good() else None

            known = await until(good, "the stiffness is known")
            assert 1500.0 < known.Value.Value < 1800.0

            async def fine() -> bool:
                return bool((await read(LEVEL)).Value.Value == ValveHealth.LEVEL_OK)

            await until(fine, "the level is shown")
            valve.monitor.kill()

            async def lost() -> bool:
                value = await read(LEVEL)
                return bool(value.StatusCode.value == ua.StatusCodes.BadNoCommunication)

            await until(lost, "a dead monitor is shown by the quality")
        async with Client(url, timeout=PATIENCE, watchdog_intervall=PATIENCE) as client:
            assert await attacks(client, index) == []
        administrator = Client(url, timeout=PATIENCE)
        administrator.set_user("admin")
        with pytest.raises(ua.UaError):
            await administrator.connect()

    asyncio.run(work())
    assert valve.bridge.alive
    with socket.socket() as other:
        other.settimeout(2.0)
        # Only loopback's own address is listened on.
        assert other.connect_ex((_own_address(), port)) != 0


def _own_address() -> str:
    """Return an address of this host that is not loopback's own, as the network would use it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return "127.0.0.2"
        address = str(probe.getsockname()[0])
    return "127.0.0.2" if address == "127.0.0.1" else address
