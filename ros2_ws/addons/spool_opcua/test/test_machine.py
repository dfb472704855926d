"""Values, health and alarm figures of a machine on OPC UA, by the numbers of the standards."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from spool_core.errors import InputError
from spool_core.node.network import claimed_domain
from spool_monitor.alarm_statistics import PEAK_SPAN
from spool_monitor.listener import HeardValve
from spool_msgs.msg import ModelEstimate, Quantity, ValveHealth
from spool_opcua import machine
from spool_opcua.machine import HEALTH, TYPES, UNITS, AlarmFigures

ONE = ("valve_1", "friction_drift/coulomb_force")


@pytest.fixture(name="served", scope="module")
def _served() -> Iterator[Any]:
    """Yield a function that reads values of a server of ``valves`` by the names of their nodes."""
    from asyncua import Server, ua  # noqa: PLC0415 - slow to load
    from spool_opcua.machine import Machine, Nameplate  # noqa: PLC0415
    from spool_opcua.opcua_node import NAMESPACE, AddressSpace  # noqa: PLC0415

    async def made() -> tuple[Server, int, AddressSpace]:
        server = Server()
        await server.init()
        index = await server.register_namespace(NAMESPACE)
        machine = Machine(server, index, Nameplate("press 7"))
        await machine.build()
        return server, index, AddressSpace(server, index, machine)

    async def read(valves: list[HeardValve], names: tuple[str, ...]) -> list[Any]:
        await space.update(valves, 0.0)
        nodes = [server.get_node(ua.NodeId(name, index)) for name in names]
        found = [await node.read_data_value(raise_on_bad_status=False) for node in nodes]
        return [(one.StatusCode.name, one.Value.Value) for one in found]

    loop = asyncio.new_event_loop()
    server, index, space = loop.run_until_complete(made())
    yield lambda valves, *names: loop.run_until_complete(read(valves, names))
    loop.close()


def test_a_value_has_its_unit_and_the_range_beyond_which_the_monitor_warns(served: Any) -> None:
    force = Quantity(name="coulomb_force", unit="N", value=0.8, validity=Quantity.VALIDITY_VALID)
    bounds = {"coulomb_force_low_N": 0.5, "coulomb_force_high_N": 1.5}
    valve = HeardValve("valve_1", ValveHealth(), estimate=ModelEstimate(parameters=[force]), bounds=bounds)
    name = "valve_1.estimate.coulomb_force [N]"
    value, unit, ends = served([valve], name, f"{name}.EngineeringUnits", f"{name}.EURange")
    assert value == ("Good", 0.8)
    assert unit[1].NamespaceUri == "http://www.opcfoundation.org/UA/units/un/cefact"
    assert unit[1].UnitId == 5129559  # newton, as the OPC Foundation's table of units gives it
    assert (ends[1].Low, ends[1].High) == (0.5, 1.5)


def test_valves_share_what_is_alike_and_keep_their_own_names_and_values(served: Any) -> None:
    valves = [
        HeardValve(
            name,
            ValveHealth(summary=name),
            estimate=ModelEstimate(parameters=[Quantity(name="mass", unit="kg", value=value, validity=1)]),
        )
        for name, value in (("valve_1", 0.1), ("valve_2", 0.2))
    ]
    kept = (
        "valve_1.estimate.mass [kg]",
        "valve_2.estimate.mass [kg]",
        "valve_1.health.summary",
        "valve_2.health.summary",
    )
    assert [value for _, value in served(valves, *kept)] == [0.1, 0.2, "valve_1", "valve_2"]
    names = [f"{valve.name}.Identification.ComponentName" for valve in valves]
    assert [value.Text for _, value in served(valves, *names)] == ["valve_1", "valve_2"]


def test_the_machine_is_as_ill_as_its_worst_valve_and_moves_when_one_moves(served: Any) -> None:
    still = ValveHealth(namur=ValveHealth.NAMUR_NORMAL, judgements=["friction_drift: not enough excitation"])
    moved = ValveHealth(namur=ValveHealth.NAMUR_OUT_OF_SPECIFICATION, judgements=["friction_drift: judged"])
    names = ":machine.Monitoring.Health.DeviceHealth", ":machine.MachineryItemState.CurrentState"
    pair = [HeardValve("valve_1", still), HeardValve("valve_2", moved)]
    health, state = served(pair, *names)
    assert (health, state[0], state[1].Text) == (("Good", 3), "Good", "Executing")
    health, state = served(pair[:1], *names)
    assert (health, state[0], state[1].Text) == (("Good", 0), "Good", "NotExecuting")
    health, state = served([HeardValve("valve_1")], *names)
    assert (health[0], state[0]) == ("BadNoCommunication", "BadNoCommunication")


def test_figures_follow_announcements_and_begin_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(machine.time, "monotonic", lambda: now)
    figures = AlarmFigures(_began=now)

    def hear(occurrence: int, *, active: bool, shown: bool | None = None) -> None:
        shown = active if shown is None else shown
        figures.hear(ONE, occurrence, 0.0, shown=shown, active=active, waiting=active)

    def shown() -> dict[str, Any]:
        return {name: one.value.Value for name, one in figures.values().items()}

    hear(4, active=True)  # raised before the server began
    assert shown()["AlarmCount"] == 0
    now += 60.0
    hear(4, active=False)
    hear(6, active=True)  # two came, one of them between two messages
    now += 30.0
    hear(6, active=False)
    hear(7, active=True, shown=False)  # on the shelf: nobody sees it
    found = shown()
    assert (found["AlarmCount"], found["CurrentAlarmRate"], found["MaximumAlarmRate"]) == (2, 2.0, 2.0)
    assert (found["MaximumActiveState"], found["MaximumReAlarmCount"]) == (60e3, 0)
    now += 2.0 * PEAK_SPAN - 90.0
    found = shown()
    assert (found["CurrentAlarmRate"], found["MaximumAlarmRate"], found["AverageAlarmRate"]) == (
        0.0,
        2.0,
        1.0,
    )
    figures = figures.renewed()
    now += 5.0
    found = shown()
    assert (found["AlarmCount"], found["MaximumActiveState"], found["MaximumAlarmRate"]) == (0, 5e3, 0.0)


def test_a_server_that_starts_too_slowly_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    from spool_opcua import opcua_node  # noqa: PLC0415 - slow to load

    monkeypatch.setattr(opcua_node, "START", 0.0)
    with claimed_domain() as number:
        rclpy.init(args=[], domain_id=number)
        node = opcua_node.OpcUaNode()
        with pytest.raises(InputError, match="no server in 0 s, machine busy"):
            node.configure()
        node.cleanup()
        node.destroy_node()
        rclpy.shutdown()


def test_type_files_carry_their_license() -> None:
    import spool_opcua  # noqa: PLC0415

    for name in TYPES:
        path = Path(str(spool_opcua.__file__)).parent / "vendor" / f"Opc.Ua.{name}.NodeSet2.xml"
        assert "OPC Foundation MIT License 1.00" in path.read_text(encoding="utf-8")[:300]


def test_units_and_health_are_those_of_the_standards() -> None:
    numbers = {unit: int.from_bytes(code.encode(), "big") for unit, (code, _, _) in UNITS.items()}
    # Of the OPC Foundation's UNECE_to_OPCUA.csv.
    assert numbers["Hz"] == 4740186
    assert numbers["N/m"] == 13392
    assert numbers["N s/m"] == 4404536
    assert numbers["m/s^2"] == 5067595
    assert sorted(HEALTH.values()) == [0, 1, 2, 3, 4]
