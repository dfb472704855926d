"""Programs ``page`` and ``opcua``."""

from __future__ import annotations

from spool_core.node.program import start


def page() -> int:
    """Run the page's node."""
    return start("spool_view.page_node", "PageNode")


def opcua() -> int:
    """Run the OPC UA server's node."""
    return start("spool_view.opcua_node", "OpcUaNode")
