"""One source: which of several streams of a topic is used, and when another one takes its place."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

#: s after which the first source is stale where another one sends, as for the nodes' ``stale_after``; and
#: streams besides the first one that are followed.
STALE, MOST_RIVALS = 1.5, 4

#: Lengths of an item after which a single one that departed is known to be wrong: a second source would have
#: sent its next one.
SETTLES = 2.0

FaultType = TypeVar("FaultType")


class Place(NamedTuple):
    """When an item comes in its stream, and from whom.

    ``stamp`` and ``end``, when the next one is due, are in ns, ``period`` of its samples in s; ``source`` is
    who the item says it is of.
    """

    stamp: int
    end: int
    sequence: int
    period: float
    source: str = ""


class Standing(enum.Enum):
    """What an item of another stream than the first source's is."""

    OPEN = "of a source that was restarted, or of a second one: not known yet"
    SECOND = "of a second source: the first one sends as well"
    MOVED = "of the first source, which goes on at another time"
    RESTARTED = "of the source that is used from now on: the first one is silent"


@dataclass(slots=True)
class Rival:
    """A stream that does not continue the first one: its newest item, and its items since the first sent.

    ``since`` is the stamp (ns) of the oldest of them; ``direct``: they take the first one's sequence up;
    ``beside``: the first one has sent since this began.
    """

    place: Place
    since: int
    items: int
    direct: bool
    beside: bool = False


@dataclass(slots=True)
class OneSource(Generic[FaultType]):
    """Rule of one source: the first one keeps its place as long as it sends.

    An item that departs from the first stream may be wrong, of a second source, or the first one of a source
    that was restarted; the items that follow tell. Another stream takes the place where it sent for ``STALE``
    s while the first one was silent, or where it takes the first one's sequence up.

    Attributes:
        departure: how the second place departs from what was due after the first one, ``None``: it continues.
        lengths: lengths of an item that a stream sends, at least, before it takes the place.
    """

    departure: Callable[[Place, Place], FaultType | None]
    lengths: float = 0.0
    rivals: list[Rival] = field(default_factory=list)
    _odd: tuple[FaultType, Place, int] | None = None
    _settled: FaultType | None = None

    @property
    def open(self) -> bool:
        """Whether what departed last is not known to be wrong or of another source."""
        return self._odd is not None

    def take_settled(self) -> FaultType | None:
        """Return the fault of an item that departed by itself, once, as soon as that is known."""
        settled, self._settled = self._settled, None
        return settled

    def rival(self, last: Place, place: Place, fault: FaultType | None) -> Rival | None:
        """Return the stream that ``place`` continues rather than that of ``last``.

        ``fault``: how it departs from the latter.
        """
        found = next((one for one in self.rivals if self.departure(one.place, place) is None), None)
        if found is None or (
            fault is None and abs(place.stamp - last.end) <= abs(place.stamp - found.place.end)
        ):
            return None
        return found

    def follow(self, rival: Rival, place: Place) -> Standing:
        """Take the next item of another stream, which takes the first one's place once that is stale."""
        length, rival.place, self._odd = rival.place.end - rival.place.stamp, place, None
        rival.items += 1
        if rival.items == 1:
            rival.since = place.stamp
        if rival.direct and rival.items == 2:
            return Standing.MOVED
        if place.stamp - rival.since >= max(STALE * 1e9, self.lengths * length):
            return Standing.RESTARTED
        return Standing.SECOND if rival.beside else Standing.OPEN

    def depart(self, last: Place, place: Place, fault: FaultType, *, direct: bool = False) -> None:
        """Take an item that continues no stream; ``direct``: it takes the first one's sequence up."""
        if self._odd is not None:
            self._settled = self._odd[0]
        self._odd = fault, place, last.stamp
        self.rivals = [*self.rivals[1 - MOST_RIVALS :], Rival(place, place.stamp, 1, direct)]

    def still_there(self, last: Place) -> bool:
        """Record that the first source has sent ``last``: the others begin to wait again.

        Return whether that shows another stream to be a second source.
        """
        second = False
        for rival in self.rivals:
            second = second or (rival.items > 1 and not rival.beside)
            rival.beside = rival.beside or rival.items > 0
            rival.items, rival.direct = 0, False
        if self._odd is not None:
            fault, place, since = self._odd
            if not 0 <= last.stamp - since < SETTLES * (place.end - place.stamp):
                self._settled, self._odd = fault, None
        return second

    def begin(self) -> None:
        """Forget the other streams: the next item is the first one of the source that is used."""
        self.rivals, self._odd = [], None
