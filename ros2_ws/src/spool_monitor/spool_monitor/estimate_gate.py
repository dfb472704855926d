"""Estimate gate, which estimates may be used: those of one estimator, by the rule that blocks have."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from spool_core.one_source import OneSource, Place, Standing
from spool_estimator.estimate import Estimate, State

#: Estimates that another estimator sends, at least, before it takes the place of one that is silent; and the
#: share of the time between two estimates before which the same estimator sends no further one.
LENGTHS, SOONEST = 2.5, 0.5
#: s between two estimates of an estimator, the shortest and the longest that its parameter takes.
SHORTEST, LONGEST = 0.1, 60.0
#: s of samples that an estimate may have used beyond the time since the one before, as stamps jitter by half
#: a block, and the share of that time, as sample rates are not exact.
AHEAD, RATE_ERROR = 0.3, 0.02
#: Valves whose descriptions are kept at most: chosen, a topic has one, others are mistakes.
MOST_DESCRIBED = 4

Description = TypeVar("Description")


@dataclass(slots=True)
class EstimateGate:
    """Judges the estimates of one valve in the order of their arrival.

    An estimator counts the samples that it used since its start, never faster than time goes: an estimate
    that does not go on so, or names another valve, is of another one. A second one is never used; one that
    was restarted is, as :class:`OneSource` describes.

    Attributes:
        standing: what the newest estimate is, or shows to be there; ``None``: of the estimator that is used.
        last: place of the last one that is used, whose ``sequence`` is the number of samples.
        replaced: whether the newest one is the first that is used of another valve.
        other: valve that the last one names which was not used, or replaced the one before.
        second: how many were of a second estimator.
        interval: s between two estimates.

    """

    standing: Standing | None = None
    last: Place | None = None
    other: str = ""
    replaced: bool = False
    second: int = 0
    interval: float = math.nan
    _tracks: bool = False
    _sources: OneSource[str] = field(default_factory=lambda: OneSource(_departure, LENGTHS))
    _resumes: bool = False

    def resume(self) -> None:
        """Take the next estimate of the same estimator at any stamp: after a pause, or a clock was set."""
        self._resumes = True

    def admit(self, estimate: Estimate, period: float) -> bool:
        """Return whether ``estimate`` may be used; ``period``: of the samples (s), 0 where not known."""
        self.standing, self.replaced = None, False
        due = SHORTEST if math.isnan(self.interval) else self.interval
        last, end = self.last, estimate.stamp + round(1e9 * due)
        place = Place(estimate.stamp, end, estimate.samples, period, estimate.source)
        if last is None:
            return self._accept(place, estimate)
        same = estimate.source == last.source and estimate.samples >= last.sequence
        if estimate.state is State.STALE:  # it sends the last one again, as no data come
            return same and (self._resumes or estimate.stamp == last.stamp)
        if self._resumes and same:
            return self._accept(place, estimate)
        fault = _departure(last, place)
        if fault is None and self._tracks and estimate.state is State.TRACKING and last.sequence > 0:
            fault = None if estimate.samples > last.sequence else "it reports tracking without new samples"
        rival = self._sources.rival(last, place, fault)
        if rival is not None:
            self.standing = self._sources.follow(rival, place)
            if self.standing is Standing.RESTARTED:
                self._sources.begin()
                self.interval, self.replaced = math.nan, place.source != last.source
                self.other = place.source
                return self._accept(place, estimate)
        elif fault is None:
            seconds = 1e-9 * (place.stamp - last.stamp)
            self.interval = min(seconds, LONGEST, *([] if math.isnan(self.interval) else [self.interval]))
            if self._sources.still_there(place):
                self.standing = Standing.SECOND
            return self._accept(place, estimate)
        else:
            self._sources.depart(last, place, fault)
            self.standing = Standing.OPEN
        self.other = estimate.source
        self.second += self.standing is Standing.SECOND
        return False

    def _accept(self, place: Place, estimate: Estimate) -> bool:
        self.last, self._tracks, self._resumes = place, estimate.state is State.TRACKING, False
        return True


def _departure(last: Place, place: Place) -> str | None:
    """Return why ``place`` is not of the estimator that sent ``last``, ``None`` where it may be."""
    seconds, interval = 1e-9 * (place.stamp - last.stamp), 1e-9 * (last.end - last.stamp)
    if place.source != last.source:
        return "it names another valve"
    if seconds < SOONEST * interval:
        return "it comes too soon"
    if place.sequence < last.sequence:
        return "it has used fewer samples"
    used = (place.sequence - last.sequence) * place.period
    return None if used <= seconds * (1.0 + RATE_ERROR) + AHEAD else "it has used more samples"


@dataclass(slots=True)
class Descriptions(Generic[Description]):
    """Which description of the valve is used: that of the estimator whose estimates are.

    Another one waits for its own estimates; a new one of the same valve, until its estimator was restarted.

    Attributes:
        used: the valve that is described, empty before any is.

    """

    used: str = ""
    _known: dict[str, Description] = field(default_factory=dict)
    _new: set[str] = field(default_factory=set)

    def take(self, name: str, description: Description, last: Place | None) -> Description | None:
        """Take the description of the valve ``name``; return it where it is used from now on.

        ``last``: place of the last estimate that was used.
        """
        self._known.pop(name, None)
        self._known = {**dict(list(self._known.items())[1 - MOST_DESCRIBED :]), name: description}
        self._new.add(name)
        at_once = not self.used or last is None or (last.source == name != self.used)
        return self._use(name) if at_once else None

    def follow(self, gate: EstimateGate) -> Description | None:
        """Return the description that is used from the newest estimate of ``gate`` on, if another one is."""
        source = "" if gate.last is None else gate.last.source
        again = gate.standing is Standing.RESTARTED and source in self._new
        return self._use(source) if source in self._known and (source != self.used or again) else None

    def _use(self, name: str) -> Description:
        self.used = name
        self._new.discard(name)
        return self._known[name]
