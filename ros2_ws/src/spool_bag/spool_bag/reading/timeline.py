"""Time base of a record: a clock that is set, or a source that starts again, begins a time of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from spool_core.block import Block, BlockRun
from spool_core.block_gate import LONGEST_PERIOD, SHORTEST_PERIOD

#: ns, beyond what lost blocks explain, by which a stamp may be ahead: as the judgement of blocks has it.
AHEAD = 1_000_000_000
#: ns of blocks lost in one piece that a jump in sequence explains: a day.
LONGEST_LOSS = 86_400_000_000_000


class TimeSpan(NamedTuple):
    """Time span: stamps of the first sample and behind the last, what had passed ``before``; in ns."""

    first: int
    end: int
    before: int


class ClockStep(NamedTuple):
    """Clock step: ``at`` s after the record's beginning, by ``by`` s (negative: back)."""

    at: float
    by: float


class _BlockPlace(NamedTuple):
    first: int
    end: int
    sequence: int


@dataclass(slots=True)
class Timeline:
    """Time base of one valve: the spans that its blocks cover, in their order.

    A block that does not follow begins a new span only if the next one follows it: a wrong stamp is none.
    """

    spans: list[TimeSpan] = field(default_factory=list)
    _last: _BlockPlace | None = None
    _unconfirmed: _BlockPlace | None = None

    def take(self, block: Block) -> None:
        """Take a block; malformed ones are left out."""
        usual = SHORTEST_PERIOD <= block.sample_period <= LONGEST_PERIOD
        if not (usual and block.body.size and block.stamp > 0):
            return
        place = _BlockPlace(block.stamp, block.end, block.sequence)
        if self._last is None:
            self.spans.append(TimeSpan(place.first, place.end, 0))
        elif _follows(self._last, place):
            span = self.spans[-1]
            if place.end > span.end:
                self.spans[-1] = span._replace(end=place.end)
        elif self._unconfirmed is not None and _follows(self._unconfirmed, place):
            before = self.spans[-1].before + self.spans[-1].end - self.spans[-1].first
            self.spans.append(TimeSpan(self._unconfirmed.first, place.end, before))
        else:
            self._unconfirmed = place
            return
        self._last, self._unconfirmed = place, None

    def take_run(self, run: BlockRun) -> None:
        """Take the blocks of ``run``, as ``take`` does one by one."""
        for block in run.blocks():
            self.take(block)
            if self._last is not None and self._last.first == block.stamp and self._unconfirmed is None:
                # The others follow it, and only the last one says where the span ends.
                self.take(run.last)
                return

    @property
    def duration(self) -> int:
        """All spans together, ns; never negative."""
        return self.spans[-1].before + self.spans[-1].end - self.spans[-1].first if self.spans else 0

    @property
    def steps(self) -> list[ClockStep]:
        """Where the clock was set, or a source started again."""
        spans = self.spans
        return [
            ClockStep(later.before * 1e-9, (later.first - earlier.end) * 1e-9)
            for earlier, later in pairwise(spans)
        ]

    def since(self, stamp: int, earliest: int = 0) -> int:
        """Return the ns that had passed at ``stamp`` since the first sample; of several spans the last one.

        ``earliest`` is a time that had passed already, for stamps that were told one after the other.
        """
        if not self.spans:
            return 0
        inside = [span for span in self.spans if span.first <= stamp <= span.end]
        if not inside:
            inside = [min(self.spans, key=lambda span: max(span.first - stamp, stamp - span.end))]
        passed = [span.before + stamp - span.first for span in inside]
        return next((one for one in passed if one >= earliest), passed[-1])


def duration_of(timelines: Sequence[Timeline]) -> float | None:
    """Return the time (s) that the valves' spans cover together, at least that of the longest valve."""
    spans = sorted((span.first, span.end) for timeline in timelines for span in timeline.spans)
    if not spans:
        return None
    covered, gaps, reached = 0, 0, spans[0][0]
    for first, end in spans:
        gaps += max(first - reached, 0)
        covered += max(end - max(first, reached), 0)
        reached = max(reached, end)
    # Without a step, what lies between valves that were recorded one after another is time as well.
    whole = all(len(timeline.spans) < 2 for timeline in timelines)
    return max(covered + whole * gaps, *(timeline.duration for timeline in timelines)) / 1e9


def _follows(last: _BlockPlace, place: _BlockPlace) -> bool:
    """Return whether ``place`` lies on the same clock as ``last``, blocks lost in between or not."""
    missing = max(place.sequence - last.sequence - 1, 0)
    ahead = min(2 * missing * (place.end - place.first), LONGEST_LOSS) + AHEAD
    return last.end - AHEAD <= place.first <= last.end + ahead


def step_text(valve: str, step: ClockStep) -> str:
    """Return the line that tells people of a step."""
    way = "back" if step.by < 0.0 else "ahead"
    return (
        f"/{valve}: its time goes {way} by {abs(step.by):.3f} s at {step.at:.1f} s (clock set or source "
        "started again): time is counted on from there"
    )
