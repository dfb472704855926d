"""Program ``page``."""

from __future__ import annotations

from spool_node.program import start


def main() -> int:
    """Run the node."""
    return start("spool_web.node.page_node", "PageNode")
