"""Processors: how many this process may use."""

from __future__ import annotations

import os

_limit: int | None = None


def processors() -> int:
    """Return the number of processors that the system lets this process run on, at least 1."""
    allowed = getattr(os, "sched_getaffinity", None)  # Linux only
    found = len(allowed(0)) if allowed else os.cpu_count() or 1
    return found if _limit is None else min(found, _limit)


def limit_processors(most: int) -> None:
    """Let this process use ``most`` processors at most: one of several workers that share them."""
    global _limit  # noqa: PLW0603 - it is of the process
    _limit = most
