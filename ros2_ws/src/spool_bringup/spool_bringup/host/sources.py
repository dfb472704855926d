"""Sources of blocks that a host may run in its own processes: nodes that packages offer by entry points."""

from __future__ import annotations

from importlib.metadata import entry_points

from spool_core.errors import InputError
from spool_core.node.managed_node import ManagedNode

#: Group of entry points, as ``simulator = spool_sim.simulator_node:SimulatorNode``. A driver joins by one of
#: its own: a managed node that sends by :class:`~spool_core.node.block_hub.BlockPublisher`.
SOURCES = "spool.sources"
NONE = "none"


def load_source(name: str) -> type[ManagedNode] | None:
    """Return the class of the source ``name``, ``None`` for none.

    Raises:
        InputError: no package offers it.
    """
    if name == NONE:
        return None
    offered = {one.name: one for one in entry_points(group=SOURCES)}
    if name not in offered:
        known = ", ".join([NONE, *sorted(offered)])
        raise InputError(f"source: no package offers {name!r}; there are {known}")
    kind = offered[name].load()
    if not (isinstance(kind, type) and issubclass(kind, ManagedNode)):
        raise InputError(f"source: {offered[name].value} of {name!r} is no managed node")
    return kind
