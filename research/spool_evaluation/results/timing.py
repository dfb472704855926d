"""Timing of the same work by us and by a peer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

from spool_core.uncertainty import named


class Row(Protocol):
    """Row of a benchmark's table, a dataclass; its fields are what ``--json`` writes."""

    def cells(self) -> dict[str, str]:
        """Return its cells by their column's name."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Timing of ``work``: ours in ``ours_s``, the ``peer``'s in ``peer_s``; errors where both are comparable.

    ``compiling`` is the factor of the ratio that is owed to the peer's being interpreted: 1 for a compiled
    one, ``None`` where it was not measured.
    """

    JSON_PROPERTIES: ClassVar = ("ratio", "ratio_of_scheme")

    work: str
    peer: str
    ours_s: float
    peer_s: float
    ours_error: float | None = None
    peer_error: float | None = None
    compiling: float | None = field(default=None, metadata=named("ratio_of_compiling"))

    @property
    def ratio(self) -> float:
        """How many times as fast as the peer."""
        return self.peer_s / self.ours_s

    @property
    def ratio_of_scheme(self) -> float | None:
        """The factor of the ratio that is left for the scheme, ``None`` where ``compiling`` is."""
        return None if self.compiling is None else self.ratio / self.compiling

    def cells(self) -> dict[str, str]:
        """Return work, peer, both times and their ratio, and what else was measured."""
        optional = {
            "by compiling": self.compiling,
            "by scheme": self.ratio_of_scheme,
            "our error": self.ours_error,
            "their error": self.peer_error,
        }
        return {
            "work": self.work,
            "peer": self.peer,
            "ours": f"{self.ours_s:.3g} s",
            "theirs": f"{self.peer_s:.3g} s",
            "times as fast": f"{self.ratio:.3g}",
            **{name: "" if value is None else f"{value:.3g}" for name, value in optional.items()},
        }


class Stopwatch:
    """Time since it was made, on the wall and of this process's computing."""

    def __init__(self) -> None:
        self._begin = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        """Return (s on the wall, s of computing); other work on the machine does not change the latter."""
        return time.perf_counter() - self._begin[0], time.process_time() - self._begin[1]


def best_of(count: int, work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the shortest of ``count`` runs of ``work`` by ``clock``, s.

    For work of one thread without waiting ``time.process_time`` leaves out what else the machine does.
    """
    times = []
    for _ in range(count):
        begin = clock()
        work()
        times.append(clock() - begin)
    return min(times)
