"""The times in a record: a clock that is set, or a source that starts again, begins a time of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from spool_stream.block import Block

#: ns, beyond what lost blocks explain, by which a stamp may be ahead: as the judgement of blocks has it.
AHEAD = 1_000_000_000


class Span(NamedTuple):
    """Stamps of the first sample and behind the last one, and what had passed ``before``; all in ns."""

    first: int
    end: int
    before: int


class Step(NamedTuple):
    """A clock's step: ``at`` s after the record's beginning, by ``by`` s (negative: back)."""

    at: float
    by: float


@dataclass(slots=True)
class Timeline:
    """The spans of time that the blocks of one valve cover, in their order."""

    spans: list[Span] = field(default_factory=list)
    _sequence: int = 0

    def take(self, block: Block) -> None:
        """Take a block that can be used."""
        first, end = block.stamp, block.end
        if not self.spans:
            self.spans.append(Span(first, end, 0))
        else:
            last = self.spans[-1]
            missing = max(block.sequence - self._sequence - 1, 0)
            ahead = 2 * missing * (end - first) + AHEAD
            if last.end - AHEAD <= first <= last.end + ahead:
                self.spans[-1] = last._replace(end=max(last.end, end))
            else:
                self.spans.append(Span(first, end, last.before + last.end - last.first))
        self._sequence = block.sequence

    @property
    def duration(self) -> int:
        """All spans together, ns; never negative."""
        return self.spans[-1].before + self.spans[-1].end - self.spans[-1].first if self.spans else 0

    @property
    def steps(self) -> list[Step]:
        """Where the clock was set, or a source started again."""
        spans = self.spans
        return [
            Step(later.before * 1e-9, (later.first - earlier.end) * 1e-9)
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


def step_text(valve: str, step: Step) -> str:
    """Return the line that tells people of a step."""
    way = "back" if step.by < 0.0 else "ahead"
    return (
        f"/{valve}: its time goes {way} by {abs(step.by):.3f} s at {step.at:.1f} s (clock set or source "
        "started again): time is counted on from there"
    )
