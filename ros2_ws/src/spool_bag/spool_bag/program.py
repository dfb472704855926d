"""Programs ``recorder`` and ``adapter``."""

from __future__ import annotations

from spool_core.node.program import start


def recorder() -> int:
    """Run the recorder's node."""
    return start("spool_bag.recorder_node", "RecorderNode")


def adapter() -> int:
    """Run the adapter's node."""
    return start("spool_bag.adapter_node", "AdapterNode")
