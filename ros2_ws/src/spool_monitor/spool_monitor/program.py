"""Program ``monitor``."""

from __future__ import annotations

from spool_core.node.program import start


def main() -> int:
    """Run the node."""
    return start("spool_monitor.monitor_node", "MonitorNode")
