"""Estimates that a monitor hears not, twice, late or in exchanged order, chosen by a seed."""

from __future__ import annotations

import functools
import random
from dataclasses import dataclass

from spool_estimator.estimate import Estimate
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.detectors import MonitorSettings
from spool_monitor.event import EventState
from spool_monitor.monitor import Monitor

from .story import PLOTS, STEP, VALVE, told

STORIES = tuple(name for name in PLOTS if name != "dead twice")
SETTINGS = MonitorSettings(natural_frequency=VALVE.natural_frequency, baseline_time=4.0)
FAULTS = ("lost", "doubled", "late", "exchanged")
#: Estimates after which the healthy valve is known: nothing can be found to have changed before.
LEARNED = 13
#: Estimates of which one fault takes at most.
LONGEST = 12
#: s after which a silence is one, with what the fault itself may add.
STALE = 1.5
#: Kinds of events that report the interruption itself.
OWN = ("stale", "data_fault")

#: Alarms of a run by name: whether they stand at the end.
Alarms = dict[str, bool]


@dataclass(frozen=True, slots=True)
class Run:
    """Run of one seed: the story, faults as text, every transition of an alarm, and the alarms.

    ``silent``: s since the last estimate came, at the end. ``heard``: longest time in s after the valve's
    change in which no silence was reported. ``first``: s from that change to the first alarm.
    """

    seed: int
    story: str
    faults: tuple[str, ...]
    transitions: tuple[str, ...]
    alarms: Alarms
    silent: float
    heard: float
    first: float

    @property
    def invented(self) -> list[str]:
        """Alarms of the valve that it does not have without faults, and a silence that is over.

        That estimates come twice or exchanged is reported as a second source, for a minute.
        """
        usual = undisturbed(self.story).alarms
        return [
            name
            for name, stands in self.alarms.items()
            if name not in usual
            and (not name.startswith(OWN) or (stands and name.startswith("stale") and self.silent < STALE))
        ]

    @property
    def lost(self) -> list[str]:
        """Alarms that the valve has without faults, if the monitor hears it for as long as it needs."""
        usual = undisturbed(self.story)
        if self.heard < usual.first:
            return []
        return [
            name
            for name, stands in usual.alarms.items()
            if name not in self.alarms or self.alarms[name] != stands
        ]


def arrivals(seed: int, story: str) -> tuple[list[list[Estimate]], tuple[str, ...]]:
    """Return the estimates that arrive after each block, and the faults that were put on them."""
    chance = random.Random(seed)
    sent = [(number, one) for number, some in enumerate(told(story).estimates) for one in some]
    heard: list[list[Estimate]] = [[] for _ in told(story).blocks]
    marks = ["" for _ in sent]
    said = []
    for _ in range(chance.randint(1, 4)):
        fault, begin, count = (
            chance.choice(FAULTS),
            chance.randrange(LEARNED, len(sent)),
            chance.randint(1, LONGEST),
        )
        marks[begin : begin + count] = [fault] * len(marks[begin : begin + count])
        said.append(f"{count} {fault} from estimate {begin}")
    held: list[Estimate] = []
    for place, (number, one) in enumerate(sent):
        after = marks[place + 1] if place + 1 < len(marks) else ""
        if marks[place] in ("late", "exchanged"):
            held.append(one)
            if marks[place] == "exchanged" and len(held) == 2:
                held.reverse()
            elif after == marks[place]:
                continue
            heard[number] += held
            held = []
        elif marks[place] != "lost":
            heard[number] += [one] * (2 if marks[place] == "doubled" else 1)
    return heard, tuple(said)


def run(seed: int, *, faults: bool = True) -> Run:
    """Return what the monitor makes of the story and the faults of ``seed``."""
    story = STORIES[seed % len(STORIES)]
    heard, said = arrivals(seed, story) if faults else ([list(one) for one in told(story).estimates], ())
    monitor, store = Monitor(SETTINGS), AlarmStore()
    transitions: list[str] = []
    alarms: Alarms = {}
    begin = last = told(story).blocks[0].stamp
    changed = STEP * min((*PLOTS[story].changes, *PLOTS[story].dead), default=0)
    stretch, longest, first = 0.0, 0.0, 0.0
    for block, estimates in zip(told(story).blocks, heard, strict=True):
        events = monitor.update(block)
        for one in estimates:
            events += monitor.update_estimate(one)
            last = block.end
        events += monitor.idle(0.0, max(0.0, 1e-9 * (block.end - last) - STEP), block.end)
        now = 1e-9 * (block.end - begin)
        stretch = stretch + STEP if now > changed and 1e-9 * (block.end - last) - STEP < STALE else 0.0
        longest = max(longest, stretch)
        first = first or (now - changed if events else 0.0)
        for event in events:
            after = store.update(event).after
            transitions.append(f"{event.stamp - begin} {after.name} {after.state.name} {event}")
            alarms[after.name] = event.state is EventState.RAISED
    silent = 1e-9 * (told(story).blocks[-1].end - last)
    return Run(seed, story, said, tuple(transitions), alarms, silent, longest, first)


@functools.cache
def undisturbed(story: str) -> Run:
    """Return the run of ``story`` without faults."""
    return run(STORIES.index(story), faults=False)
