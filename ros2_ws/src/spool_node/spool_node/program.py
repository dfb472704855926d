"""Start a node's program: signals are looked after before the libraries are loaded, which takes seconds."""

from __future__ import annotations

import importlib

from spool_stream.text.standard_streams import keep_standard_streams

from .stopping import STOP


def start(module: str, node: str) -> int:
    """Run the node class ``node`` of ``module``; return the exit code. A signal meanwhile ends it with 0."""
    STOP.install()
    keep_standard_streams()
    run = importlib.import_module("spool_node.running").run
    return int(run(getattr(importlib.import_module(module), node)))
