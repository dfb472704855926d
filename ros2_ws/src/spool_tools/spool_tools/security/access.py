"""Access of each kind of node: which topics and services it may use, as DDS names them.

ROS 2 names (design.ros2.org, "Topic and Service name mapping to DDS"): topics ``rt/``, requests of services
``rq/...Request``, replies ``rr/...Reply``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

#: What every node of ROS 2 sends and hears.
_ALL_SEND = ("ros_discovery_info", "rt/rosout", "rt/parameter_events", "rt/diagnostics")
_ALL_HEAR = ("ros_discovery_info", "rt/clock", "rt/parameter_events")
#: Topics in a valve's namespace by who sends and who hears them.
_SENT = {
    "simulator": ("acceleration", "oil_temperature"),
    "adapter": ("acceleration",),
    "estimator": ("estimate", "valve", "refit", "gap", "events"),
    "monitor": ("health", "events"),
}
_HEARD = {
    "simulator": (),
    "adapter": ("*",),
    "estimator": ("acceleration", "oil_temperature", "events"),
    "monitor": ("acceleration", "valve", "estimate"),
}
VALVE_NODES = tuple(_SENT)


@dataclass(frozen=True, slots=True)
class Access:
    """Access of an enclave: DDS topics that it may publish and subscribe, patterns with ``*`` allowed."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]

    def __add__(self, other: Access) -> Access:
        return Access(
            tuple(dict.fromkeys((*self.publish, *other.publish))),
            tuple(dict.fromkeys((*self.subscribe, *other.subscribe))),
        )


def of_node(valve: str, node: str) -> Access:
    """Return what ``node`` (one of :data:`VALVE_NODES`) of ``valve`` needs, its services included."""
    own = f"{valve}/{node}"
    topics = Access(
        tuple(f"rt/{valve}/{topic}" for topic in _SENT[node]),
        tuple(f"rt/{valve}/{topic}" for topic in _HEARD[node]),
    )
    return _common(own) + topics


def of_host(valves: Sequence[str], source: str | None = None) -> Access:
    """Return what a host of estimators and monitors needs, and for a ``source`` of blocks that it runs."""
    access = _common("host") + _common("host_*")
    for valve in valves:
        for node in ("estimator", "monitor", *((source,) if source is not None else ())):
            access += of_node(valve, node)
    return access


def of_recorder(valves: Sequence[str]) -> Access:
    """Return what the recorder needs: it hears everything and sends nothing but its own state."""
    return _common("recorder") + Access((), ("rt/diagnostics", *(f"rt/{valve}/*" for valve in valves)))


def of_viewer(valves: Sequence[str]) -> Access:
    """Return what a viewer needs: it hears, and may ask for nothing."""
    hears = ("rt/diagnostics", *(f"rt/{valve}/*" for valve in valves))
    return Access(("ros_discovery_info", "rt/rosout"), (*_ALL_HEAR, *hears))


def of_operator(valves: Sequence[str]) -> Access:
    """Return what an operator needs: a viewer who may call the services of the nodes."""
    called = [f"{valve}/*" for valve in valves] + ["recorder/*", "host/*"]
    calls = Access(tuple(f"rq/{name}Request" for name in called), tuple(f"rr/{name}Reply" for name in called))
    return of_viewer(valves) + calls


def _common(node: str) -> Access:
    """Return what a managed node sends, hears and offers as services."""
    return Access(
        (*_ALL_SEND, f"rr/{node}/*Reply", f"rt/{node}/transition_event"),
        (*_ALL_HEAR, f"rq/{node}/*Request"),
    )
