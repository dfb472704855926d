"""Program ``adapter``: run by the package that offers the node of that name, as this one imports no other."""

from __future__ import annotations

import sys
from importlib.metadata import entry_points

#: Group of entry points in which packages offer nodes: ``adapter = spool_adapter.program:main``.
NODES = "spool.nodes"


def adapter() -> int:
    """Run the node; return its exit code, 2 where no package offers it."""
    offered = next(iter(entry_points(group=NODES, name="adapter")), None)
    if offered is None:
        print(
            "spool_stream adapter: spool_adapter is not installed: build and source the workspace",
            file=sys.stderr,
        )
        return 2
    return int(offered.load()())
