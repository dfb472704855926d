"""Start a node's program: signals are looked after before the libraries are loaded, which takes seconds."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from spool_core.libraries import libraries_reported
from spool_core.text.standard_streams import keep_standard_streams

from .stopping import STOP


def start(module: str, node: str) -> int:
    """Run the node class ``node`` of ``module``; return the exit code. A signal meanwhile ends it with 0."""
    STOP.install()
    keep_standard_streams()
    with libraries_reported(Path(sys.argv[0]).name):
        run = importlib.import_module("spool_core.node.running").run
        kind = getattr(importlib.import_module(module), node)
    return int(run(kind))
