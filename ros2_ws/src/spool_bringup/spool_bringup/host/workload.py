"""Workload of a host process: whether it keeps up with its blocks, and what to say where it does not."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from spool_core.node.block_hub import TopicTimes
from spool_core.node.diagnostics import Level

#: s that blocks wait, or that were dropped of a valve in the last SPAN s: a warning, an error.
WARNS, FAILS = 0.5, 2.0
#: s of the clock that losses are looked back on.
SPAN = 10.0


@dataclass(slots=True)
class Workload:
    """Workload of the valves of a process.

    Attributes:
        level: what it is now.
        wait: s, longest that blocks of a valve waited since the last :meth:`take`.
    """

    level: Level = Level.OK
    wait: float = 0.0
    _text: str = ""
    _before: deque[tuple[float, dict[str, tuple[int, int, float]]]] = field(default_factory=deque)

    def take(self, now: float, times: Mapping[str, TopicTimes], behind: float) -> str:
        """Judge waits and losses at ``now`` (s, steady); return what to log where that became worse, else "".

        ``behind``: s of samples that wait now.
        """
        counts = {name: (one.messages, one.dropped, one.seconds_dropped) for name, one in times.items()}
        self._before.append((now, counts))
        while self._before[0][0] < now - SPAN:
            self._before.popleft()
        first = self._before[0][1]
        new = [
            tuple(count - before for count, before in zip(count, first.get(name, count), strict=True))
            for name, count in counts.items()
        ]
        self.wait = max([behind, *(one.longest_wait for one in times.values())])
        worst = max([self.wait, *(one[2] for one in new)])
        before, self.level = self.level, Level.ERROR if worst >= FAILS else Level.WARNING
        if worst < WARNS:
            self.level = Level.OK
        waited = [
            (one[1] > 0, held.longest_wait >= WARNS) for one, held in zip(new, times.values(), strict=True)
        ]
        judged, dropped = (sum(one[place] for one in new) for place in (0, 1))
        late = max([1, *map(sum, zip(*waited, strict=True))])
        self._text = (
            f"the controller is too busy: {judged:.0f} of {judged + dropped:.0f} blocks judged in the last "
            f"{SPAN:g} s, {late} of {len(times)} valves behind by up to {worst:.1f} s: use more processes or "
            "fewer valves"
        )
        return self.text if self.level is not Level.OK and before is Level.OK else ""

    @property
    def text(self) -> str:
        """What operators read, empty where the process keeps up."""
        return "" if self.level is Level.OK else self._text
