"""Programs ``page`` and ``opcua``."""

from __future__ import annotations

from spool_core.node.program import start


def page() -> int:
    """Run the page's node."""
    return start("spool_view.page_node", "PageNode")


def opcua() -> int:
    """Run the node of the OPC UA server, which is an add-on."""
    return start("spool_opcua.opcua_node", "OpcUaNode")
