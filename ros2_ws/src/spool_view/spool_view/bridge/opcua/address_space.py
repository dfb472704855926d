"""Address space of the OPC UA server: a folder for each valve, with state, numbers and alarms.

Node ids are strings made of names, so that a client that stored them finds them after a restart:
``ns=2;s=valve_1.health.level``. Quality is the status code: ``Good``, ``UncertainLastUsableValue`` (held),
``BadWaitingForInitialData``, ``BadNoCommunication`` (nothing is heard).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

from asyncua import Server, ua
from spool_monitor.alarms.alarm import AlarmState
from spool_monitor.node.valve_condition import NO_WORD, condition_of
from spool_msgs.msg import Alarm, Quantity, ValveHealth
from spool_tools.watch.heard import HeardValve

NAMESPACE = "urn:spool-suite:valves"
#: Numbers and alarms of one valve at most: what comes over the network is data.
MOST = 64
_NAMUR = {
    ValveHealth.NAMUR_UNKNOWN: "unknown",
    ValveHealth.NAMUR_NORMAL: "normal",
    ValveHealth.NAMUR_MAINTENANCE_REQUIRED: "maintenance required",
    ValveHealth.NAMUR_OUT_OF_SPECIFICATION: "out of specification",
    ValveHealth.NAMUR_FUNCTION_CHECK: "function check",
    ValveHealth.NAMUR_FAILURE: "failure",
}
_QUALITY = {
    Quantity.VALIDITY_VALID: ua.StatusCodes.Good,
    Quantity.VALIDITY_HELD: ua.StatusCodes.UncertainLastUsableValue,
    Quantity.VALIDITY_UNKNOWN: ua.StatusCodes.BadWaitingForInitialData,
    Quantity.VALIDITY_IMPLAUSIBLE: ua.StatusCodes.UncertainEngineeringUnitsExceeded,
}


@dataclass(frozen=True, slots=True)
class Item:
    """Variable of a valve: its place below the valve, value, quality and the source's time."""

    path: tuple[str, ...]
    value: str | float | int | bool
    quality: int
    time: datetime | None


class AddressSpace:
    """Variables of all valves; a write happens only where value, quality or time changed."""

    def __init__(self, server: Server, index: int) -> None:
        """Fill ``server`` below Objects/Valves, in the namespace ``index``."""
        self._server, self._index = server, index
        self._folders: dict[tuple[str, ...], Any] = {}
        self._written: dict[tuple[str, ...], Item] = {}

    async def update(self, valves: Iterable[HeardValve], now: float) -> int:
        """Bring all variables up to date at ``now`` (s, monotonic); return how many were written."""
        written = 0
        for valve in valves:
            for item in items_of(valve, now):
                if self._written.get(item.path) != item:
                    await self._write(item)
                    written += 1
        return written

    async def _write(self, item: Item) -> None:
        value = ua.DataValue(
            ua.Variant(item.value),
            ua.StatusCode(item.quality),
            SourceTimestamp=item.time,
            ServerTimestamp=datetime.now(timezone.utc),
        )
        known = item.path in self._written
        self._written[item.path] = item
        identity = ua.NodeId(".".join(item.path), self._index)
        if not known:
            folder = await self._folder(item.path[:-1])
            await folder.add_variable(identity, item.path[-1], item.value)
        await self._server.write_attribute_value(identity, value)

    async def _folder(self, path: tuple[str, ...]) -> Any:
        if path not in self._folders:
            if path:
                parent = await self._folder(path[:-1])
                name, identity = path[-1], ".".join(path)
            else:
                parent, name, identity = self._server.get_objects_node(), "Valves", "Valves"
            self._folders[path] = await parent.add_folder(ua.NodeId(identity, self._index), name)
        return self._folders[path]


def items_of(valve: HeardValve, now: float) -> Iterator[Item]:
    """Yield what plant systems see of ``valve`` at ``now`` (s, monotonic)."""
    name = valve.name
    condition = condition_of(valve.health, now - valve.health_at)
    silent = condition == NO_WORD
    lost = ua.StatusCodes.BadNoCommunication
    yield Item((name, "condition"), condition.replace("_", " "), ua.StatusCodes.Good, None)
    health = valve.health
    if health is not None:
        at = _time(health.header.stamp)
        good = lost if silent else ua.StatusCodes.Good
        for key, value in (
            ("level", int(health.level)),
            ("ne107", _NAMUR.get(health.namur, "unknown")),
            ("summary", health.summary),
            ("active", ", ".join(health.active)),
        ):
            yield Item((name, "health", key), value, good, at)
        own = (health.dominant_frequency, health.amplification, health.viscous_drift, health.coulomb_drift)
        yield from _numbers(name, "health", own, at, lost=silent)
    if valve.estimate is not None:
        estimate = valve.estimate
        at = _time(estimate.header.stamp)
        own = (*estimate.parameters, estimate.natural_frequency, estimate.damping_ratio, estimate.residual)
        yield from _numbers(name, "estimate", own, at, lost=silent)
    if valve.alarms is not None:
        for alarm in valve.alarms.alarms[:MOST]:
            yield from _alarm(name, alarm, lost=silent)


def _numbers(
    valve: str, group: str, quantities: Iterable[Quantity], at: datetime | None, *, lost: bool
) -> Iterator[Item]:
    for one in list(quantities)[:MOST]:
        quality = ua.StatusCodes.BadNoCommunication if lost else _QUALITY.get(one.validity)
        quality = ua.StatusCodes.BadWaitingForInitialData if quality is None else quality
        key = f"{one.name}" if one.unit in ("", "1") else f"{one.name} [{one.unit}]"
        yield Item((valve, group, key), _finite(one.value), quality, at)
        yield Item((valve, group, f"{key} standard deviation"), _finite(one.standard_deviation), quality, at)


def _finite(value: float) -> float:
    """Return ``value``, 0 for what is not a number: its quality says that it is not known."""
    return float(value) if math.isfinite(value) else 0.0


def _alarm(valve: str, alarm: Alarm, *, lost: bool) -> Iterator[Item]:
    at = _time(alarm.header.stamp) or _time(alarm.raised_at)
    quality = ua.StatusCodes.BadNoCommunication if lost else ua.StatusCodes.Good
    values: dict[str, str | int] = {
        "state": AlarmState(alarm.state).name.lower().replace("_", " "),
        "severity": int(alarm.severity),
        "code": int(alarm.code),
        "cause": alarm.cause,
        "message": alarm.message,
        "acknowledged by": alarm.acknowledged_by,
    }
    for key, value in values.items():
        yield Item((valve, "alarms", alarm.name, key), value, quality, at)


def _time(stamp: object) -> datetime | None:
    seconds = getattr(stamp, "sec", 0)
    if not seconds:
        return None
    return datetime.fromtimestamp(seconds + 1e-9 * getattr(stamp, "nanosec", 0), timezone.utc)
