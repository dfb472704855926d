"""Program of a node: it starts where ROS can be imported, and stops in order on a signal."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from spool_core.errors import InputError, libraries_reported
from spool_core.node.network import check_middleware
from spool_core.node.stop import STOP
from spool_core.text import keep_standard_streams


def start(module: str, node: str) -> int:
    """Run the node class ``node`` of ``module``; return the exit code. A signal meanwhile ends it with 0."""
    STOP.install()
    keep_standard_streams()
    try:
        check_middleware()
    except InputError as error:
        print(error, file=sys.stderr, flush=True)
        return 2
    with libraries_reported(Path(sys.argv[0]).name):
        run = importlib.import_module("spool_core.node.running").run
        kind = getattr(importlib.import_module(module), node)
    return int(run(kind))
