"""Two sensor streams on one clock: resampled and joined into blocks of both channels."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spool_core.block import Block
from spool_core.numbers import Array
from spool_core.sensor_clock import LEAST_STEP
from spool_core.sensor_stream import SensorStream
from spool_core.stamps import Indices, unpaired

#: Relative difference of the rates above which the sensors have different rates, and the grid is the slower
#: one's; quartz clocks of one nominal rate differ by 1e-4, resonators on chips by up to 1e-2.
SAME_RATE = 0.03

#: Times by which the faster sensor may be faster: beyond, the filter before it is thinned out would take
#: longer than what is kept.
MOST_RATIO = 8.0

#: s by which the lag between the sensors may wander before it is reported, and before blocks stop: clocks
#: that nobody synchronises drift apart by up to 0.2 ms a second. Times its noise that it must exceed.
WANDERS, APART, CERTAIN = 0.001, 0.004, 8.0

#: s: moves of both sensors' stamps that are so near are one; a lasting step is seen four chunks later.
TOGETHER = 0.5

#: Cause of a fault: one sensor's clock was set, or has run away from the other's.
CLOCK_STEP = "clock_step"

#: Samples on both sides together, and the shape of the Kaiser window for 80 dB: 0.1102 (80 - 8.7). The gain
#: is then within 1e-4 up to 0.42 of the sample rate (Oppenheim and Schafer, Discrete-Time Signal Processing,
#: 3rd edition, section 7.5.3).
TAPS, SHAPE = 32, 0.1102 * (80.0 - 8.7)

#: Share of a period up to which a time is that of the sample itself: the phase error at the highest frequency
#: is 3e-4, as small as the filter's own; two sensors sampled together are passed on as they are.
ON_SAMPLE = 1.0e-4


class Channel(enum.Enum):
    """Which of the two sensors."""

    BODY = "body"
    SPOOL = "spool"

    @property
    def other(self) -> Channel:
        """The other sensor."""
        return Channel.SPOOL if self is Channel.BODY else Channel.BODY


@dataclass(frozen=True, slots=True)
class AlignerSettings:
    """Rates, times and source of the blocks that an aligner makes.

    ``block_rate`` (Hz) of the blocks; ``sample_rate`` (Hz) of the sensors, 0 where the stamps tell it;
    ``settle`` (s) of stamps before the first block; ``longest_wait`` (s of data) for the slower sensor;
    ``spool_delay`` (s) by which the spool's stamps are late; ``source``: the blocks' ``frame_id``.
    """

    block_rate: float = 50.0
    sample_rate: float = 0.0
    settle: float = 1.0
    longest_wait: float = 1.0
    spool_delay: float = 0.0
    source: str = ""

    @property
    def capacity(self) -> int:
        """Samples of each sensor that are kept, the rate being ``sample_rate`` or 20 kHz at most."""
        rate = self.sample_rate if self.sample_rate > 0.0 else 20_000.0
        return max(4096, math.ceil((self.settle + self.longest_wait + 1.0) * rate))


@dataclass(frozen=True, slots=True)
class PairFault:
    """Why the samples of two sensors cannot be brought together.

    ``cause`` is that of a ``data_fault``: ``clock_step`` or ``rate``. ``text``: what is wrong and what to do.
    """

    cause: str
    text: str


@dataclass(slots=True)
class Grid:
    """The samples of the ``reference`` sensor; ``start`` is the first block's first one.

    ``due``: time of the next block's first sample, ns; 0 before it is asked for.
    """

    reference: Channel
    generations: tuple[int, int]
    start: int
    size: int
    period: float
    ratio: float
    block: int = 0
    due: int = 0


class Aligner:
    """Takes samples of body and spool, gives blocks in which both belong to the same instants.

    The grid is the body's samples, or the slower sensor's where the rates differ. Where the other sensor was
    sampled at the same instants its samples are passed on as they are, else they are interpolated
    (:func:`resampled`). A block in which a sample of either is missing is left out, as its sequence number
    shows. Times are those of the sensors' clocks (:mod:`.sensor_clock`), not single stamps. While the sensors
    do not belong together (:attr:`fault`) there are no blocks. Never raises.

    Attributes:
        streams: the two sensors. sent, dropped: blocks. late: samples whose block had been given up.

    """

    def __init__(self, settings: AlignerSettings) -> None:
        self.settings = settings
        self.streams = {channel: SensorStream(settings.settle, settings.capacity) for channel in Channel}
        self.sent = 0
        self.dropped = 0
        self.late = 0
        self._sequence = 0
        self._grid: Grid | None = None
        self._lag = math.nan
        self._rhythms: tuple[tuple[int, int], PairFault | None] = (-1, -1), None

    @property
    def settled(self) -> bool:
        """Whether both sensors' clocks are known."""
        body, spool = self.streams.values()
        return body.clock is not None and spool.clock is not None

    @property
    def sample_rate(self) -> float:
        """Hz, of the blocks; NaN before the first."""
        return math.nan if self._grid is None else 1.0 / self._grid.period

    @property
    def drift(self) -> float:
        """By how much the spool's clock is slow against the body's, relative; NaN for different rates."""
        body, spool = (stream.clock for stream in self.streams.values())
        if body is None or spool is None:
            return math.nan
        drift = spool.period / body.period - 1.0
        return drift if abs(drift) <= SAME_RATE else math.nan

    @property
    def offset(self) -> float:
        """s from a sample of the body to the nearest one of the spool; NaN for different rates."""
        body, spool = (stream.clock for stream in self.streams.values())
        if body is None or spool is None or math.isnan(self.drift):
            return math.nan
        place = float(spool.indices(np.array([body.time]), body.base)[0])
        return 1e-9 * (round(place) - place) * spool.period

    @property
    def apart(self) -> float:
        """s by which the newest stamp of the spool is before the body's; NaN before both have come."""
        body, spool = (stream.newest for stream in self.streams.values())
        return 1e-9 * (body - spool) if body and spool else math.nan

    @property
    def too_different(self) -> bool:
        """Whether one sensor is more than ``MOST_RATIO`` times faster than the other: no grid serves both."""
        body, spool = (stream.clock for stream in self.streams.values())
        return bool(body and spool and not 1.0 / MOST_RATIO <= body.rate / spool.rate <= MOST_RATIO)

    @property
    def clock_step(self) -> float:
        """s by which the body's clock was set against the spool's since the node listens; 0 for no step."""
        body, spool = (stream.stepped for stream in self.streams.values())
        return 1e-9 * (body - spool) if abs(body - spool) > LEAST_STEP else 0.0

    @property
    def wandered(self) -> float:
        """s by which the body's stamps gained on the spool's, by the order of arrival; 0 if not certain."""
        watch = self.streams[Channel.BODY].watch
        if watch is None:
            return 0.0
        if math.isnan(self._lag) and watch.lag_unrest <= 1e9 * WANDERS:
            self._lag = watch.steady_lag
        gained = watch.lag - self._lag
        if not abs(gained) > 1e9 * WANDERS or abs(gained) <= CERTAIN * watch.lag_unrest:
            return 0.0
        return 1e-9 * gained

    @property
    def fault(self) -> PairFault | None:
        """Why there are no blocks although both sensors' clocks are known; ``None`` where there are."""
        if not self.settled:
            return None
        step = self.clock_step
        if step:
            body, spool = (stream.steps for stream in self.streams.values())
            name, other, by = ("spool", "body", -step) if spool > body else ("body", "spool", step)
            return PairFault(
                CLOCK_STEP,
                f"the {name}'s clock was set by {by:+.4g} s against the {other}'s: samples cannot be "
                "paired until it is set back; synchronise both clocks and restart the adapter",
            )
        if self.too_different:
            return PairFault(
                "rate", "one sensor is more than 8 times faster than the other: choose nearer rates"
            )
        if self._rhythms[0] != self._generations:
            self._rhythms = self._generations, self._mismatch()
        if self._rhythms[1] is not None:
            return self._rhythms[1]
        wandered = self.wandered
        if abs(wandered) > APART:
            return PairFault(
                CLOCK_STEP,
                f"the sensors' clocks have drifted apart by {abs(wandered):.3g} s: synchronise them and "
                "restart the adapter",
            )
        return None

    def _mismatch(self) -> PairFault | None:
        """Return why the stamps of both sensors, for what they are, do not show one time."""
        body, spool = (stream.found for stream in self.streams.values())
        assert body is not None
        assert spool is not None
        first, second = (stream.opening for stream in self.streams.values())
        reason = unpaired(("body", "spool"), (body, spool), (first, second))
        return PairFault("rate", reason) if reason else None

    def update(self, channel: Channel, stamp: int, value: float) -> Block | None:
        """Take a sample of ``channel``, its stamp in ns and value in m/s^2; return a block that is complete.

        One at a time: those that come together once the clocks are known must not flood their consumers.
        """
        if channel is Channel.SPOOL and stamp > 0:
            stamp -= round(self.settings.spool_delay * 1e9)
        stream = self.streams[channel]
        other = self.streams[channel.other]
        before = stream.newest
        other.met = other.heard
        alive = 0 <= stamp - stream.met <= other.silence and not other.unconfirmed
        stream.update(stamp, value, other.heard - other.stepped if alive else 0)
        self._compare_moves()
        grid, later = self._grid, stream.newest != before
        if later and grid is not None and grid.generations == self._generations:
            reference = self.streams[grid.reference]
            forgotten = reference.clock is None  # its stamps stopped making sense
            complete = forgotten or grid.start + (grid.block + 1) * grid.size - 1 <= reference.sure
            if not complete and (stream is reference or not self._is_late(grid, stream)):
                return None  # as nearly always: the rest need not be looked at for each sample
        if not later or not self.settled or self.fault is not None:
            return None
        if grid is None or grid.generations != self._generations:
            grid = self._grid = self._begin()
            if grid is None:
                return None
        elif channel is not grid.reference and self._is_late(grid, stream):
            self.late += 1
        return self._complete(grid)

    def notice(self) -> Block:
        """Return the block that tells consumers of a step of one clock: it holds no sample of the spool."""
        stamp = self.streams[Channel.BODY].heard
        rate = self.settings.sample_rate or self.sample_rate
        period = 1.0 / rate if rate > 0.0 else 1.0 / self.settings.block_rate
        body, spool = np.zeros(1, np.float32), np.empty(0, np.float32)
        return Block(stamp, self._sequence, period, body, spool, self.settings.source)

    def _compare_moves(self) -> None:
        """Settle moves that the stamps of both sensors show together: no clock was set against the other.

        The stamps against each other are surer than the order of arrival, by which each was judged alone.
        """
        body, spool = self.streams.values()
        first, second = body.move, spool.move
        if first is None or second is None:
            return
        if abs(first.at - second.at) <= TOGETHER * 1e9 and abs(first.by - second.by) <= max(
            LEAST_STEP, first.error + second.error
        ):
            off = second.stepped - first.stepped
            spool.settle_move(first.stepped)
            body.settle_move(first.stepped)
            for stream, by in ((body, -off), (spool, off)):
                if stream.watch is not None:
                    stream.watch.lag += by

    @property
    def _generations(self) -> tuple[int, int]:
        body, spool = (stream.generation for stream in self.streams.values())
        return body, spool

    def _begin(self) -> Grid | None:
        """Lay the grid from the first instant that both sensors know; ``None`` where there is none yet."""
        body, spool = (stream.clock for stream in self.streams.values())
        assert body is not None
        assert spool is not None
        slower = rate_ratio(spool.period, body.period) > 1.0
        name = Channel.SPOOL if slower else Channel.BODY
        reference, second = self.streams[name], self.streams[name.other]
        clock, follower = (spool, body) if slower else (body, spool)
        rate = self.settings.sample_rate
        period = 1.0 / rate if rate > 0.0 else round(1e-9 * clock.period, 12)
        ratio = rate_ratio(clock.period, follower.period)
        place = follower.indices(clock.times(np.array([reference.oldest]), clock.base), clock.base)
        need = 0 if ratio == 1.0 and on_samples(place) else margin(ratio) - 1
        missing = second.oldest + need - float(place[0])
        start = reference.oldest + max(0, math.ceil(missing * follower.period / clock.period - 1e-6))
        if (start - clock.index) * clock.period > 1e9 * self.settings.longest_wait:
            return None
        size = max(1, round(1.0 / (period * self.settings.block_rate)))
        return Grid(name, self._generations, start, size, period, ratio)

    def _is_late(self, grid: Grid, stream: SensorStream) -> bool:
        """Return whether the newest sample of ``stream`` is due ahead of the next block."""
        if not grid.due:
            clock = self.streams[grid.reference].clock
            assert clock is not None
            index = np.array([grid.start + grid.block * grid.size])
            grid.due = clock.base + round(float(clock.times(index, clock.base)[0]))
        return grid.due - stream.newest > 1e9 * grid.period

    def _complete(self, grid: Grid) -> Block | None:
        """Return the next block of which all samples are there; give up those one sensor is too late for."""
        reference = self.streams[grid.reference]
        other = self.streams[grid.reference.other]
        clock, follower = reference.clock, other.clock
        assert clock is not None
        assert follower is not None
        while (last := grid.start + (grid.block + 1) * grid.size - 1) <= reference.sure:
            first = last - grid.size + 1
            if first < reference.oldest:  # after a long silence: what nobody holds any more
                skipped = max(1, (reference.oldest - first) // grid.size)
                self._give_up(grid, skipped)
                continue
            indices = np.arange(first, last + 1)
            times = clock.times(indices, clock.base)
            places = follower.indices(times, clock.base)
            exact = grid.ratio == 1.0 and on_samples(places)
            needed = round(places[-1]) if exact else math.floor(places[-1]) + margin(grid.ratio)
            if needed > other.sure:
                if clock.time - follower.time + (clock.base - follower.base) <= (
                    1e9 * self.settings.longest_wait
                ):
                    return None
                self._give_up(grid, 1)
                continue
            pair = {
                grid.reference: reference.values(indices),
                grid.reference.other: resampled(other.values, places, grid.ratio),
            }
            if not all(np.isfinite(values).all() for values in pair.values()):
                self._give_up(grid, 1)
                continue
            body, spool = (pair[channel].astype(np.float32) for channel in Channel)
            stamp = clock.base + round(float(times[0]))
            block = Block(stamp, self._sequence, grid.period, body, spool, self.settings.source)
            self.sent += 1
            self._advance(grid, 1)
            return block
        return None

    def _give_up(self, grid: Grid, blocks: int) -> None:
        self.dropped += blocks
        self._advance(grid, blocks)

    def _advance(self, grid: Grid, blocks: int) -> None:
        grid.block += blocks
        grid.due = 0
        self._sequence += blocks


def rate_ratio(period: float, other: float) -> float:
    """Return the rate of a series with the period ``other`` over that of one with ``period``.

    1 where both have one nominal rate; above 1 ``period`` makes the grid of both.
    """
    ratio = period / other
    return 1.0 if abs(ratio - 1.0) <= SAME_RATE else ratio


def margin(ratio: float = 1.0) -> int:
    """Return the samples that are needed on each side; ``ratio``: the series' rate over the result's."""
    return int(np.ceil(TAPS / 2 * max(1.0, ratio)))


def on_samples(places: Array) -> bool:
    """Return whether all ``places`` (sample numbers as real numbers) are those of samples."""
    return bool((np.abs(places - np.rint(places)) <= ON_SAMPLE).all())


def resampled(values: Callable[[Indices], Array], places: Array, ratio: float = 1.0) -> Array:
    """Return the series at ``places``, shape (n,); NaN where a sample that is needed is missing.

    Args:
        values: gives the series' samples by number.
        places: sample numbers as real numbers, shape (n,).
        ratio: the series' rate over that of the result; above 1 the series is limited to half of the result's
            rate first, with a transition from 0.42 to 0.58 of it.

    """
    if ratio <= 1.01 and on_samples(places):
        return values(np.rint(places).astype(np.int64))
    cut = min(1.0, 1.0 / ratio)
    half = margin(ratio)
    base = np.floor(places).astype(np.int64)
    offsets = np.arange(1 - half, half + 1)
    distances = offsets - (places - base)[:, None]
    inside = np.clip(1.0 - (distances / half) ** 2, 0.0, None)
    weights = np.sinc(cut * distances) * np.i0(SHAPE * np.sqrt(inside))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray((weights * values(base[:, None] + offsets)).sum(axis=1), dtype=np.float64)
