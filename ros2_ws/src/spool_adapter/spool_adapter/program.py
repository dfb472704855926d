"""Program ``adapter``."""

from __future__ import annotations

from spool_node.program import start


def main() -> int:
    """Run the node."""
    return start("spool_adapter.adapter_node", "AdapterNode")
