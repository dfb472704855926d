"""Program ``opcua``."""

from __future__ import annotations

from spool_node.program import start


def main() -> int:
    """Run the node."""
    return start("spool_bridge.opcua.opcua_node", "OpcUaNode")
