"""Program ``page``."""

from __future__ import annotations

from spool_core.node.program import start


def main() -> int:
    """Run the node."""
    return start("spool_view.web.node.page_node", "PageNode")
