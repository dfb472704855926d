"""Processors: how many this process may use."""

from __future__ import annotations

import os


def processors() -> int:
    """Return the number of processors that the system lets this process run on, at least 1."""
    allowed = getattr(os, "sched_getaffinity", None)  # Linux only
    return len(allowed(0)) if allowed else os.cpu_count() or 1
