"""Strokes of a switched valve: recognised by what the body cannot have caused, left out, and measured.

A stroke is a speed of the spool in its body far beyond both what the body makes due and what there was a
moment before. Due is the motion of a lightly damped spring and mass of the valve's natural frequency, a bound
for one with dry friction. Hits at a stop and steps of a sensor make no such speed, or make it for longer than
a stroke takes. What follows is left out until the spool moves in its body again as the body makes it: at a
stop it does not. Each sample is judged by earlier ones, so the split into blocks changes no result.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block, Samples
from spool_core.kernels.compiled import compiled
from spool_core.kernels.samples import STANDING_LEAST
from spool_core.numbers import Array

#: Times the speed that is due, and that just before, beyond which a spool is driven: without strokes 36 of 40
#: runs of 2 min stay below 1.1 and all below 1.2 (6 to 40 Hz, starts, springs x 0.7 to 1.3, drag x 0.4 to 2,
#: seeds 0 to 39). And m/s: 1 mm within 50 ms.
FAR, LEAST = 2.0, 0.02
#: Damping ratio of the motion due: less than that of the shipped valves (0.04, 0.24), so that more is due.
DAMPING = 0.03
#: 1/s, below which a speed is the drift of a sensor (2 Hz); s, by which means, and peaks, follow.
LEAK, MEAN, PEAK = 2.0 * math.pi * 2.0, 5.0, 1.0
#: s before the present that "just before" begins at least; s of samples before a stroke can be known.
LAG, KNOWN = 0.15, 0.5
#: s of rest that end a stroke, that end the gap (five times 1/LEAK), and s that no stroke lasts.
REST, SETTLED, LONGEST = 0.15, 0.4, 1.0
#: Share of the motion due, or of its usual share, from which a spool moves; s over which it is averaged.
MOVES, USUAL, AVERAGED = 0.4, 0.5, 0.1
#: Shares of the highest speed at which the motion begins, and at which it has arrived.
BEGINS, ARRIVED = 0.1, 0.5
#: s kept before a stroke; s that are kept; s from a command to its motion; s after an arrival.
BEFORE, KEPT, ANSWERS, REBOUNDS = 0.05, 3.0, 0.5, 0.01
#: s for which a channel stands still, half of the BOTH_STAND of the samples' kernels, and equal samples from
#: which it shows no speed.
STANDS, STILL = 0.025, 4.0
_DAY = 86_400_000_000_000

(
    _BODY, _RELATIVE, _SPEED, _DUE, _DUE_PLACE, _HELD, _LATER, _NOW, _FILLED, _DUE_PEAK, _SEEN, _QUIET,
    _EPISODE, _AWAY, _POWER, _DUE_POWER, _SHARE, _PLACE, _HIGHEST,
    _MOVING, _FREE, _STOOD, _LAST_BODY, _LAST_SPOOL,
) = range(24)  # fmt: skip


class Stroke(NamedTuple):
    """Stroke that began at ``stamp`` (ns).

    ``out``: it left the position in which the valve is judged. ``side``: 1 or -1, of the spool's motion in
    its body. ``travel_time`` (s) from the first motion to arrival, ``delay`` (s) from the command to the
    first motion (NaN without a command), ``speed`` (m/s) the highest, ``rebound`` the share of it with which
    the spool leaves a stop.
    """

    stamp: int
    out: bool
    side: int
    travel_time: float
    delay: float
    speed: float
    rebound: float


#: Part of a block that is judged, and the pause before it, ns, ``None`` where none was made.
Kept: TypeAlias = tuple[Block, int | None]


class StrokeArrays(NamedTuple):
    """Arrays of a :class:`StrokeWatch`, which kernels move on in place.

    ``ring``: the speed, and 1 where it is far; ``ends``: samples at which strokes ended.
    """

    numbers: Array
    ring: Array
    ends: NDArray[np.int64]


@dataclass(slots=True)
class StrokeWatch:
    """Leaves strokes out of the accepted blocks of one stream, counts and measures them.

    Attributes:
        strokes: those that ended in the newest block.
        count: strokes since the start of the day (UTC) of the data.
        command: the last one, NaN where none has come.
        share: of this day's samples that are judged.

    """

    strokes: list[Stroke] = field(default_factory=list, init=False)
    count: int = field(default=0, init=False)
    command: float = field(default=math.nan, init=False)
    _arrays: StrokeArrays = field(
        default_factory=lambda: StrokeArrays(
            np.zeros(_LAST_SPOOL + 1), np.zeros((2, 0)), np.empty(8, np.int64)
        ),
        init=False,
    )
    _period: float = field(default=0.0, init=False)
    _largest: float = field(default=0.0, init=False)
    _changes: list[tuple[int, bool]] = field(default_factory=list, init=False)
    _answered: deque[int] = field(default_factory=lambda: deque(maxlen=16), init=False)
    _left: int = field(default=0, init=False)
    _in_stretch: int = field(default=0, init=False)
    _day: int = field(default=-1, init=False)
    _samples: list[float] = field(default_factory=lambda: [0.0, 0.0], init=False)
    _was_on: bool = field(default=False, init=False)

    @property
    def away(self) -> bool:
        """Whether the newest sample is left out."""
        return bool(self._arrays.numbers[_AWAY])

    @property
    def share(self) -> float:
        """Share of the day's time that is judged; 1 before any sample."""
        kept, all_of_them = self._samples
        return kept / all_of_them if all_of_them else 1.0

    def take_command(self, stamp: int, value: float) -> None:
        """Take the solenoid's command at ``stamp`` (ns), in any unit; 0 is the position that is judged.

        It is on above half of the largest seen.
        """
        if not math.isfinite(value):
            return
        was = self._on
        self.command, self._largest = value, max(self._largest, abs(value))
        if self._on != was:
            self._changes.append((stamp, self._on))
            self._answered.append(stamp)

    @property
    def _on(self) -> bool:
        return self._largest > 0.0 and abs(self.command) >= 0.5 * self._largest

    def kept(self, block: Block, raw: Block, natural_frequency: float, *, restarts: bool) -> list[Kept]:
        """Return what of ``block`` is judged, ``raw`` being the same with its outliers.

        ``natural_frequency`` (Hz): of the valve; without one, strokes are known by their command alone.
        ``restarts``: it follows the last one behind a gap.
        """
        numbers = self._arrays.numbers
        if block.sample_period != self._period:
            self._period = block.sample_period
            ring = np.zeros((2, max(16, round(KEPT / self._period))))
            self._arrays = StrokeArrays(numbers, ring, self._arrays.ends)
        if restarts:
            numbers[[_SPEED, _DUE, _DUE_PLACE, _SEEN, _QUIET, _EPISODE]] = 0.0
        if block.stamp // _DAY != self._day:
            self._day, self.count, self._samples = block.stamp // _DAY, 0, [0.0, 0.0]
        size, before = block.body.size, numbers[_AWAY]
        on, off = self._energised(block) if self._changes else (0 if self._was_on else size, size)
        keep, ends = np.empty(size, np.bool_), self._arrays.ends
        left, count = follow_strokes(
            (block.body, block.spool), (raw.body, raw.spool), self._period, natural_frequency,
            (on, off, self.command == self.command), self._arrays, keep,
        )  # fmt: skip
        self._samples[0] += size - left
        self._samples[1] += size
        self.strokes, last = [], 0
        if left == 0 and not before:
            self._in_stretch = 0
            return [(block, None)]
        for end in ends[:count].tolist():
            self._in_stretch = 0 if keep[last:end].any() else self._in_stretch
            self.strokes += self._measured(block, end)
            last = end
        self._in_stretch = 0 if keep[last:].any() else self._in_stretch
        self.count += len(self.strokes)
        return list(self._parts(block, keep))

    def _energised(self, block: Block) -> tuple[int, int]:
        """Return from and to which sample of ``block`` a changed command is on; equal if nowhere."""
        size, period = block.body.size, self._period * 1e9
        due = [one for one in self._changes if one[0] < block.end]
        self._changes = [one for one in self._changes if one[0] >= block.end]
        on_before = self._was_on
        places = [(min(size, max(0, round((stamp - block.stamp) / period))), on) for stamp, on in due]
        starts = [place for place, on in places if on]
        first = 0 if on_before else min(starts, default=size)
        now_on = places[-1][1] if places else on_before
        last = size if now_on else max((place for place, on in places if not on), default=first)
        self._was_on = now_on
        return first, max(first, last)

    def _parts(self, block: Block, keep: NDArray[np.bool_]) -> Iterator[Kept]:
        edges = np.flatnonzero(np.diff(keep.astype(np.int8), prepend=0, append=0)).tolist()
        period, at = self._period * 1e9, 0
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            self._left += first - at
            stamp = block.stamp + round(first * period)
            part = Block(
                stamp, block.sequence, block.sample_period, block.body[first:last], block.spool[first:last],
                block.source, block.blocks,
            )  # fmt: skip
            yield part, round(self._left * period) if self._left else None
            self._left, at = 0, last
        self._left += keep.size - at

    def _measured(self, block: Block, end: int) -> Iterator[Stroke]:
        """Measure the stroke whose rest ended before sample ``end`` of ``block``, where it arrived."""
        ring, period = self._arrays.ring, self._period
        place, rest = int(self._arrays.numbers[_PLACE]), round(REST / period)
        # Where the ring is after the block; the stroke began before the samples of the rest.
        behind = block.body.size - end
        length = min(ring.shape[1] - behind, round((LONGEST + REST + BEFORE) / period))
        rows = ring[:, (place - behind - length + np.arange(length)) % ring.shape[1]]
        far = np.flatnonzero(rows[1] != 0.0)
        if not far.size:
            return
        speed = rows[0]
        # The leak is undone: the speed since the window's beginning.
        whole = speed + LEAK * period * np.concatenate(([0.0], np.cumsum(speed[:-1])))
        last_rest = np.flatnonzero(np.diff(far) > rest)
        onset = int(far[last_rest[-1] + 1] if last_rest.size else far[0])
        first = max(0, onset - round(BEFORE / period))
        side = int(math.copysign(1.0, speed[onset]))
        moved = side * (
            whole[first:] - whole[first : max(first + 1, onset - round(0.3 * BEFORE / period))].mean()
        )
        found = travel(moved, onset - first)
        if found is None:
            return
        begin, arrival, highest = found
        stamp = block.stamp + round((end - length + first + begin) * period * 1e9)
        commanded = max((one for one in self._answered if one <= stamp), default=0)
        delay = 1e-9 * (stamp - commanded)
        after = moved[math.ceil(arrival) : math.ceil(arrival) + max(2, round(REBOUNDS / period))]
        rebound = max(0.0, -float(after.min(initial=0.0))) / highest
        self._in_stretch += 1
        yield Stroke(
            stamp, self._in_stretch == 1, side, (arrival - begin) * period,
            delay if commanded and delay <= ANSWERS else math.nan, highest, min(1.0, rebound),
        )  # fmt: skip


def travel(speed: Array, onset: int) -> tuple[float, float, float] | None:
    """Return beginning and arrival (samples, interpolated) and the highest speed of the stroke at ``onset``.

    ``speed`` (m/s, shape (n,)) is counted in the direction of the stroke. ``None`` where it does not arrive.
    """
    highest, arrival = speed[onset], 0
    for i in range(onset, speed.size):
        highest = max(highest, speed[i])
        if speed[i] < ARRIVED * highest:
            arrival = i
            break
    if not arrival:
        return None
    begin = int(np.argmax(speed[onset:arrival])) + onset
    while begin > 0 and speed[begin - 1] > BEGINS * highest:
        begin -= 1
    return (
        _crossing(speed, begin, BEGINS * highest),
        _crossing(speed, arrival, ARRIVED * highest),
        float(highest),
    )


def _crossing(speed: Array, place: int, level: float) -> float:
    """Return where ``speed`` passes ``level`` between the sample before ``place`` and it."""
    if place == 0 or speed[place] == speed[place - 1]:
        return float(place)
    return place - 1 + float((level - speed[place - 1]) / (speed[place] - speed[place - 1]))


@compiled
def follow_strokes(
    clean: tuple[Samples, Samples],
    raw: tuple[Samples, Samples],
    period: float,
    natural_frequency: float,
    command: tuple[int, int, bool],
    watch: StrokeArrays,
    keep: NDArray[np.bool_],
) -> tuple[int, int]:
    """Say in ``keep`` which samples, (n,) each of body and spool, m/s^2, are judged; return how many are not.

    And how many strokes ended. ``command``: the samples from and to which one lasts, and whether it is known.
    The samples with outliers count during a stroke: a hit at a stop looks like one.
    """
    body, spool = clean
    raw_body, raw_spool = raw
    on, off, commanded = command
    numbers, ring, ends = watch
    left = count = 0
    for i in range(body.size):
        if numbers[_AWAY] != 0.0:
            _move(float(raw_body[i]), float(raw_spool[i]), period, natural_frequency, numbers)
        else:
            _move(float(body[i]), float(spool[i]), period, natural_frequency, numbers)
        if _stands(float(raw_body[i]), float(raw_spool[i]), period, numbers):
            # An acquisition that stands still is judged as such, and shows no speed.
            numbers[_AWAY] = numbers[_EPISODE] = numbers[_SEEN] = numbers[_SPEED] = 0.0
        size = abs(numbers[_SPEED])
        limit = max(LEAST, FAR * max(numbers[_HELD], numbers[_DUE_PEAK]))
        changes = numbers[_STOOD] < STILL
        far = natural_frequency > 0.0 and numbers[_SEEN] * period >= KNOWN and size > limit and changes
        place = int(numbers[_PLACE])
        ring[0, place], ring[1, place] = numbers[_SPEED], 1.0 if far else 0.0
        numbers[_PLACE] = float((place + 1) % ring.shape[1])
        if _ended(far, size, period, numbers) and count < ends.size:
            ends[count] = i + 1
            count += 1
        if on <= i < off:
            numbers[_AWAY], numbers[_FREE] = 1.0, 0.0
        elif _settled(period, commanded, numbers):
            numbers[_AWAY] = 0.0
        if numbers[_AWAY] != 0.0:
            keep[i] = False
            left += 1
        else:
            keep[i] = True
            _learn(size, period, numbers)
    return left, count


@compiled
def _stands(body: float, spool: float, period: float, numbers: Array) -> bool:
    """Return whether a channel has shown the same for longer than a coarse converter does at its tops."""
    same = body == numbers[_LAST_BODY] or spool == numbers[_LAST_SPOOL]
    numbers[_STOOD] = numbers[_STOOD] + 1.0 if same else 0.0
    numbers[_LAST_BODY], numbers[_LAST_SPOOL] = body, spool
    return bool(numbers[_STOOD] >= STANDING_LEAST and numbers[_STOOD] * period >= STANDS)


@compiled
def _move(body: float, spool: float, period: float, natural_frequency: float, numbers: Array) -> None:
    """Move on the speed of the spool in its body, and the one that is due."""
    relative = spool - body
    if numbers[_AWAY] == 0.0:
        share = max(period / MEAN, 1.0 / (1.0 + numbers[_SEEN]))
        numbers[_BODY] += share * (body - numbers[_BODY])
        numbers[_RELATIVE] += share * (relative - numbers[_RELATIVE])
    numbers[_SEEN] += 1.0
    numbers[_SPEED] += (relative - numbers[_RELATIVE] - LEAK * numbers[_SPEED]) * period
    natural = 2.0 * math.pi * natural_frequency
    pushed = -natural * (natural * numbers[_DUE_PLACE] + 2.0 * DAMPING * numbers[_DUE]) - (
        body - numbers[_BODY]
    )
    numbers[_DUE] += pushed * period
    numbers[_DUE_PLACE] += numbers[_DUE] * period
    numbers[_DUE_PEAK] = max(abs(numbers[_DUE]), numbers[_DUE_PEAK] * (1.0 - period / PEAK))
    share = period / AVERAGED
    if numbers[_AWAY] != 0.0 and numbers[_QUIET] * period < 0.5 * SETTLED:
        numbers[_POWER] = numbers[_DUE_POWER] = 0.0  # the rest of a stroke is no motion
    else:
        numbers[_POWER] += share * (numbers[_SPEED] ** 2 - numbers[_POWER])
        numbers[_DUE_POWER] += share * (numbers[_DUE] ** 2 - numbers[_DUE_POWER])


@compiled
def _ended(far: bool, size: float, period: float, numbers: Array) -> bool:
    """Follow the stroke that goes on or begins; return whether it ends with this sample."""
    if far:
        # The beginning of a stroke is not how the spool moves as a rule.
        numbers[_NOW] = numbers[_FILLED] = 0.0
        numbers[_AWAY], numbers[_QUIET] = 1.0, 0.0
        numbers[_EPISODE] += 1.0
        numbers[_HIGHEST] = max(numbers[_HIGHEST], size)
        if numbers[_EPISODE] * period > LONGEST:
            # No stroke lasts: the level of a channel is another one.
            numbers[_HELD] = numbers[_LATER] = numbers[_HIGHEST]
            numbers[_AWAY] = numbers[_EPISODE] = numbers[_HIGHEST] = numbers[_SEEN] = 0.0
        return False
    numbers[_QUIET] += 1.0
    if numbers[_EPISODE] > 0.0:
        numbers[_EPISODE] += 1.0
        if numbers[_QUIET] * period >= REST:
            numbers[_EPISODE] = numbers[_HIGHEST] = 0.0
            return True
    return False


@compiled
def _settled(period: float, commanded: bool, numbers: Array) -> bool:
    """Return whether a stroke is over: the spool moves in its body again, or its command is known."""
    if numbers[_AWAY] == 0.0:
        return False
    least = min(MOVES**2, USUAL**2 * numbers[_SHARE])
    shaken = numbers[_DUE_POWER] > (0.1 * LEAST) ** 2
    moves = commanded or (shaken and numbers[_POWER] >= least * numbers[_DUE_POWER])
    # A stroke that begins looks like motion for a moment.
    numbers[_MOVING] = numbers[_MOVING] + 1.0 if moves else 0.0
    numbers[_FREE] += 1.0
    rests = min(numbers[_QUIET], numbers[_FREE]) * period
    return bool(rests >= SETTLED and numbers[_MOVING] * period >= AVERAGED)


@compiled
def _learn(size: float, period: float, numbers: Array) -> None:
    """Learn from a sample that is judged how fast the spool moves, and which share of what is due."""
    if numbers[_DUE_POWER] > (0.1 * LEAST) ** 2:
        ratio = min(1.0, numbers[_POWER] / numbers[_DUE_POWER])
        numbers[_SHARE] += 0.5 * period * (ratio - numbers[_SHARE])
    numbers[_NOW] = max(numbers[_NOW], size)
    numbers[_FILLED] += 1.0
    if numbers[_SEEN] * period < KNOWN:
        numbers[_HELD] = max(numbers[_HELD], size)
    if numbers[_FILLED] * period >= LAG:
        numbers[_HELD] = max(numbers[_LATER], numbers[_HELD] * (1.0 - LAG / PEAK))
        numbers[_LATER], numbers[_NOW], numbers[_FILLED] = numbers[_NOW], 0.0, 0.0
