"""Sensor stream: the samples of one sensor in order, with what was lost, refused and in what rhythm."""

from __future__ import annotations

import enum
import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from spool_core.block_gate import LARGEST_SAMPLE
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_core.sensor_clock import LEAST_STEP, Change, Line, SampleClock, Step, StepWatch
from spool_core.stamps import Indices, Rhythm, Stamps, judge_stamps, line_through, repeated

#: Hz, far above what single messages can bring.
HIGHEST_RATE = 1.0e5

#: s; a stamp further ahead is taken for a wrong one until CONFIRM follow it. Below, two prove a loss.
LONGEST_GAP, CONFIRM, PROVE_LOSS = 1.0, 10, 2

#: Periods, and times the jitter's standard deviation, by which a stamp may differ from what was due.
HALF, SURE = 0.5, 5.0

#: s of samples that are held at most until deliveries in lumps show whether a clock was set; samples held at
#: most where nothing explains their stamps.
HOLD, MOST_HELD = 0.5, 64

#: Samples that make a clock at least, and that it waits for at most, whatever the rate; times ``settle`` that
#: stamps are gathered for where the first ones show no clock.
FEWEST, MOST, PATIENCE = 8, 200_000, 4.0

#: s of phase error that a rate of 1e-5 leaves over this gap at most is 1 us; over longer ones the phase is
#: taken from the first stamp after it.
KEEPS_PHASE = 0.1

#: s within which a sensor that is alive sends: later, its newest stamp says nothing of the present. The
#: second one holds while its rate is unknown.
QUIET, QUIET_WITHOUT_CLOCK = 0.02, 0.25

#: s by which the lag behind the other sensor may change over a silence before it counts as a clock that was
#: set: a driver that starts again delivers as before to within that.
SAME_LAG = 0.004

#: Least steps that single stamps of little jitter show. With more jitter samples wait until averages show it.
SHOWN = 4.0

#: Relative change of the rate up to which a clock made again continues the one before.
SAME_RATE = 1e-3

#: Wrong stamps that are the reason for which there is no clock.
MANY_WRONG = 500

#: Losses in a window of ``settle`` that are looked at: more lost than received is another rate.
MANY_LOSSES = 8


class Refusal(enum.Enum):
    """Reason for which a sample is not used; the value is the text people read."""

    NO_TIME = "stamp is 0, negative or no number"
    NOT_FINITE = "the value is NaN, infinite or beyond 1e6 m/s^2"
    DUPLICATE = "stamp and value repeated"
    STRAY = "stamp that the next ones do not confirm"
    RATE = f"sampled slower than {LIMITS.rate:g} Hz or faster than {1e-3 * HIGHEST_RATE:g} kHz"
    RHYTHM = "stamps that show no sample rate"


@dataclass(frozen=True, slots=True)
class Move:
    """Stamps that went on elsewhere.

    ``at`` (ns): the last stamp before. ``by`` (ns, with its ``error``): from where the next one was due.
    ``stepped`` (ns): what of it counts as a clock that was set; the rest are samples that were lost.
    """

    at: int
    by: float
    error: float
    stepped: int


@dataclass(slots=True)
class SensorStream:
    """Numbers the samples of one sensor and keeps the newest ``capacity`` of them.

    The stamps of the first ``settle`` s make the clock (:func:`spool_core.stamps.judge_stamps`); from then
    on each sample has its number. One that is not finite keeps its number, with NaN for its value.
    ``update`` never raises.

    Attributes:
        settle: s of stamps that make the clock.
        capacity: samples kept.
        clock: ``None`` before it is made.
        found: what the stamps showed when the clock was made; ``None`` before.
        opening: ns, the stamps that made the clock.
        doubt: why the newest stamps make no clock; empty where they do, and while the first ones come.
        generation: counts the clocks made and the steps: with a new one earlier samples are forgotten.
        restarts: how often the stamps went on elsewhere: a clock was set, or silence above ``LONGEST_GAP``.
        stepped: ns by which the clock was set against the other sensor's, in all. steps: how often.
        move: the newest one; ``None`` before the first, and once it is settled.
        received: messages so far. lost: samples that never came. refused: how many were, by reason.
        newest: ns, stamp of the newest sample taken; 0 before the first. heard: of the newest message.
        met: ns, ``heard`` when the other sensor sent its newest message.
        watch: what tells a step of the clock; ``None`` before the first clock.

    """

    settle: float
    capacity: int
    clock: SampleClock | None = None
    found: Stamps | None = None
    opening: Indices = field(default_factory=lambda: np.empty(0, np.int64))
    doubt: str = ""
    generation: int = 0
    restarts: int = 0
    stepped: int = 0
    steps: int = 0
    move: Move | None = None
    received: int = 0
    lost: int = 0
    refused: Counter[Refusal] = field(default_factory=Counter)
    newest: int = 0
    heard: int = 0
    met: int = 0
    watch: StepWatch | None = None
    _first: list[tuple[int, float, float]] = field(default_factory=list)
    _held: list[tuple[int, float, float]] = field(default_factory=list)
    _floor: int = 0
    _reach: float = 0.0
    _before: SampleClock | None = None
    _wanted: float = 0.0
    _window: tuple[int, int, int] = (0, 0, 0)
    _ring: Array = field(init=False)

    def __post_init__(self) -> None:
        self._ring = np.full(self.capacity, np.nan)
        self._wanted = self.settle

    @property
    def oldest(self) -> int:
        """Number of the oldest sample kept."""
        return 0 if self.clock is None else max(self._floor, self.clock.index - self.capacity + 1)

    @property
    def silence(self) -> float:
        """ns without a message from which on its newest stamp says nothing of the present."""
        return 1e9 * QUIET_WITHOUT_CLOCK if self.clock is None else max(1e9 * QUIET, 3.0 * self.clock.period)

    @property
    def unconfirmed(self) -> bool:
        """Whether its newest message may be a stray: its stamp says nothing of its clock yet."""
        return len(self._held) == 1

    @property
    def sure(self) -> int:
        """Number of the newest sample whose number a step of the clock can no longer change."""
        if self.clock is None or self.watch is None:
            return -1
        steps_show = self._even and SURE * self.watch.spread <= SHOWN * LEAST_STEP
        return self.clock.index - (0 if steps_show else self.watch.unsure)

    @property
    def step_limit(self) -> float:
        """Least step (ns) of the clock that the stamps show through their jitter; NaN before it is known."""
        return self.watch.limit if self.watch is not None and math.isfinite(self.watch.limit) else math.nan

    @property
    def _even(self) -> bool:
        return self.found is not None and self.found.rhythm is Rhythm.EVEN

    def update(self, stamp: int, value: float, other: int = 0) -> None:
        """Take a sample: its acquisition time (ns) and its value (m/s^2).

        ``other``: ns, the newest stamp of the other sensor when it came, less the steps of that clock; 0
        where that sensor is silent.
        """
        self.received += 1
        if stamp <= 0:
            self.refused[Refusal.NO_TIME] += 1
            self._doubt_stamps(self.refused[Refusal.NO_TIME], Refusal.NO_TIME.value)
            return
        if not abs(value) <= LARGEST_SAMPLE:
            self.refused[Refusal.NOT_FINITE] += 1
            value = math.nan
        self.heard = stamp
        lag = float(stamp - self.stepped - other) if other else math.nan
        if self.clock is None:
            self._settle(stamp, value, lag)
        elif self._even and stamp == self.newest and value == self._ring[self.clock.index % self.capacity]:
            self.refused[Refusal.DUPLICATE] += 1
        else:
            self._place(stamp, value, lag)

    def values(self, indices: Indices) -> Array:
        """Return samples by number, NaN where one is missing or not kept; any shape."""
        clock = self.clock
        if clock is None:
            return np.full(indices.shape, np.nan)
        kept = (indices >= self.oldest) & (indices <= clock.index)
        return np.where(kept, self._ring[indices % self.capacity], np.nan)

    def _place(self, stamp: int, value: float, lag: float) -> None:
        clock, near = self.clock, self._near
        assert clock is not None
        recent = self._recent
        if not self._held and abs(clock.ahead(stamp) - recent) <= near:
            self._accept(stamp, value, lag)
            return
        self._held.append((stamp, value, lag))
        off = [
            clock.ahead(one) - recent - place * clock.period for place, (one, _, _) in enumerate(self._held)
        ]
        held, last = self._held, off[-1]
        if abs(last) <= near:  # stamps that were late: each message is the next sample
            self._held = []
            for _, late, _ in held[:-1]:
                clock.skip()
                self._put(clock.index, late, 1)
            self._accept(*held[-1])
        elif abs(last + (len(held) - 1) * clock.period) <= near < 0.5 * max(abs(one - last) for one in off):
            self._held = []  # messages that are no samples: the last one is due ahead of them
            self.refused[Refusal.STRAY] += len(held) - 1
            self._accept(*held[-1])
        elif self._loses(off) and self._judged(last) in (Change.COUNT, Change.UNCERTAIN):
            self._go_on()
        elif len(off) >= CONFIRM and max(abs(one - last) for one in off[-CONFIRM:]) <= 2.0 * near:
            self._went_on_elsewhere(float(np.mean(off[-CONFIRM:])))
        elif len(held) > MOST_HELD + round(HOLD * clock.rate):
            self._restart(contradicted=True)

    @property
    def _near(self) -> float:
        """ns by which a stamp may be off what was due."""
        clock = self.clock
        assert clock is not None
        least = self._reach if not self._even else min(HALF * clock.period, LEAST_STEP)
        return max(least, SURE * clock.jitter)

    @property
    def _recent(self) -> float:
        return self.watch.recent if self.watch is not None else 0.0

    def _loses(self, off: list[float]) -> bool:
        """Return whether the stamps that are held are those of samples after a loss."""
        clock, near = self.clock, self._near
        assert clock is not None
        if len(off) < PROVE_LOSS or not self._even or self._held[0][0] - self.newest > LONGEST_GAP * 1e9:
            return False
        steps = np.rint(np.array(off) / clock.period)
        left = np.array(off) - steps * clock.period
        # Together they are nearer to whole periods than each alone.
        exact = abs(float(left.mean())) <= LEAST_STEP + SURE * clock.jitter / math.sqrt(left.size)
        exact = exact and bool((np.abs(left) <= near).all())
        return exact and bool(steps[0] >= 1.0 and (np.diff(steps) >= 0.0).all())

    def _judged(self, step: float) -> Change | None:
        """Return what a step of the held stamps is, ``None`` while more of them can show it."""
        clock, watch = self.clock, self.watch
        assert clock is not None
        assert watch is not None
        last = len(self._held) >= max(CONFIRM, round(HOLD * clock.rate))
        found = watch.judge(step, [lag for _, _, lag in self._held], last=last)
        return None if found is Change.UNCERTAIN and not last else found

    def _go_on(self) -> None:
        """Take the samples that were held, after a loss."""
        held, self._held = self._held, []
        clock = self.clock
        assert clock is not None
        self._note(
            (clock.ahead(held[-1][0]) - self._recent) - (len(held) - 1) * clock.period, 0.0, self._near
        )
        for stamp, value, lag in held:
            steps = max(1, 1 + round((clock.ahead(stamp) - self._recent) / clock.period))
            self.lost += steps - 1
            if steps > 1:
                self._window = self._window[0], self._window[1] + steps - 1, self._window[2] + 1
            self._accept(stamp, value, lag, steps)
        received, lost, losses = self._window
        if losses >= MANY_LOSSES and lost > received:
            self._held = held
            self._restart(contradicted=True)

    def _went_on_elsewhere(self, step: float) -> None:
        """Say what stamps are that go on regularly, ``step`` ns from where they were due."""
        clock = self.clock
        assert clock is not None
        change = self._judged(step)
        if change is None:
            return
        if change is Change.CLOCK or (change is Change.UNCERTAIN and abs(step) <= LONGEST_GAP * 1e9):
            held, self._held = self._held, []  # the clock was set, and goes on at the same rate
            self._note(step, step, LEAST_STEP + SURE * clock.jitter / math.sqrt(min(len(held), CONFIRM)))
            self._renew(step)
            for stamp, value, lag in held:
                self._accept(stamp, value, lag - step)
        elif self._even and abs(step + clock.period) <= self._near:
            held, self._held = self._held, []  # one message too many
            self.refused[Refusal.STRAY] += 1
            self._note(step, 0.0, self._near)
            self._renew(0.0)  # or both clocks were set back by a period: no block may reach across
            for one in held[1:]:
                self._accept(*one)
        else:
            self._restart()

    def _renew(self, step: float) -> None:
        """Begin a generation at the next sample, whose stamp is due ``step`` ns later."""
        clock, watch = self.clock, self.watch
        assert clock is not None
        assert watch is not None
        clock.time += step + self._recent
        watch.restart()
        self.generation += 1
        self._floor = clock.index + 1

    def _accept(self, stamp: int, value: float, lag: float, steps: int = 1) -> None:
        clock, watch = self.clock, self.watch
        assert clock is not None
        assert watch is not None
        off = clock.ahead(stamp) - (steps - 1) * clock.period
        if steps * clock.period > KEEPS_PHASE * 1e9:
            clock.resume(stamp, steps)
        else:
            clock.take(stamp, steps)
        self.newest = stamp
        self._put(clock.index, value, steps)
        line = Line(clock.index, clock.time, clock.period)
        step = watch.take(off, lag, float(stamp - clock.base), line)
        if step is not None:
            self._judge_step(step)

    def _judge_step(self, step: Step) -> None:
        """Say what a lasting step is that single stamps do not show for their jitter."""
        clock, watch = self.clock, self.watch
        assert clock is not None
        assert watch is not None
        index, time, period = step.line
        lost = round(step.by / period)
        # The step is one of averages over a chunk, which jitter moves less than single stamps.
        near = max(LEAST_STEP, SURE * clock.jitter / math.sqrt(watch.size))
        whole = lost >= 1 and abs(step.by - lost * period) <= near
        change = watch.judge_chunks(step.by)
        count = change is Change.COUNT or (whole and change is Change.UNCERTAIN)
        self._note(step.by, 0.0 if count else step.by, watch.limit)
        clock.time, clock.period = time + (clock.index - index) * period + step.by, period
        if not self._even:  # only a clock made again is as good as the one before
            self._restart()
            return
        if whole and change is not Change.CLOCK:
            self.lost += lost
        clock.index += lost if whole and change is not Change.CLOCK else 0
        watch.recent = 0.0
        self._renew(0.0)

    def _put(self, index: int, value: float, steps: int) -> None:
        for hole in range(max(index - steps + 1, index - self.capacity + 1), index):
            self._ring[hole % self.capacity] = np.nan
        self._ring[index % self.capacity] = value
        received, lost, losses = self._window
        full = self.clock is not None and received >= self.settle * self.clock.rate
        self._window = (0, 0, 0) if full else (received + 1, lost, losses)

    def _settle(self, stamp: int, value: float, lag: float) -> None:
        """Gather the first stamps; one that goes back or far ahead counts once others follow it."""
        if self._first and not 0 <= stamp - self._first[-1][0] <= LONGEST_GAP * 1e9:
            if self._held and not 0 <= stamp - self._held[-1][0] <= LONGEST_GAP * 1e9:
                self._drop_held()
            self._held.append((stamp, value, lag))
            if len(self._held) >= CONFIRM:
                self.refused[Refusal.STRAY] += len(self._first)
                self._first, self._held = self._held, []
                self.newest = stamp
            return
        self._drop_held()
        if self._first and stamp == self._first[0][0]:
            self._doubt_stamps(len(self._first), "all stamps are equal")
        self._first.append((stamp, value, lag))
        self.newest = stamp
        span = 1e-9 * (stamp - self._first[0][0])
        if (span >= self._wanted and len(self._first) >= FEWEST) or len(self._first) >= MOST:
            self._begin()

    def _begin(self) -> None:
        """Make the clock from the first stamps, and number their samples."""
        self._leave_out_repeats()
        first = self._first
        stamps = np.array([stamp for stamp, _, _ in first], dtype=np.int64)
        found, left_out = _without_a_stray(stamps)
        if found.rhythm is Rhythm.EVEN:
            found = _without_late_ones(stamps, found)
        if found.rhythm is Rhythm.UNEVEN:
            self.doubt = found.reason
            if self._wanted < PATIENCE * self.settle and len(first) < MOST:
                self._wanted *= 2.0
                return
            half = len(first) // 2
            self.refused[Refusal.RHYTHM] += half
            self._first = first[half:]
            return
        if found.rhythm is not Rhythm.EVEN and found.gaps.size:
            self.lost += found.lost
            self._first = first[int(found.gaps[-1]) :]  # a clock that is seen through its errors wants all
            self.doubt = f"samples are lost in each {self._wanted:g} s, and stamps are not even"
            return
        if left_out is not None:
            self.refused[Refusal.STRAY] += 1
            first, stamps = first[:left_out] + first[left_out + 1 :], np.delete(stamps, left_out)
        self._first, self._wanted = [], self.settle
        indices = _numbers(stamps, found)
        known = found.rhythm in (Rhythm.COARSE, Rhythm.BURSTS)
        clock = SampleClock.through(stamps, indices, 1e9 / found.rate if known else None)
        if not LIMITS.rate <= clock.rate <= HIGHEST_RATE:
            self.refused[Refusal.RATE] += len(first)
            self.doubt = f"{clock.rate:.3g} Hz: {Refusal.RATE.value}"
            return
        self.lost += int(indices[-1]) + 1 - indices.size
        before = self.watch
        self.clock, self.found, self.opening, self.doubt = clock, found, stamps, ""
        self.generation += 1
        self._floor, self._window = 0, (0, 0, 0)
        off = (stamps - stamps[0]) - clock.times(indices, int(stamps[0]))
        self._reach = 1.5 * float(np.abs(off).max()) + HALF * clock.period
        self._ring[:] = np.nan
        watch = self.watch = StepWatch(clock.rate, float(off.std()))
        for (stamp, value, lag), index, residual in zip(first, indices, off, strict=True):
            self._ring[index % self.capacity] = value
            time = float(clock.times(index, clock.base))
            watch.take(float(residual), lag, float(stamp - clock.base), Line(int(index), time, clock.period))
        newest = np.array([lag for _, _, lag in first[len(first) // 2 :] if math.isfinite(lag)])
        if before is None or math.isnan(before.lag) or not newest.size:
            return
        lag = float(newest.mean())
        before.lag_deviation = max(before.lag_deviation, float(newest.std()))
        error = before.lag_error(newest.size) + before.lag_error(max(FEWEST, round(before.rate)))
        watch.lag = lag - self._stepped_by(lag - before.lag, error)

    def _note(self, by: float, step: float, error: float, at: int | None = None) -> None:
        """Note stamps that moved by ``by`` (ns), of which ``step`` is that of a clock that was set."""
        self.move = Move(self.newest if at is None else at, by, error, round(step))
        if step:
            self.stepped += round(step)
            self.steps += 1

    def settle_move(self, step: int) -> None:
        """Take ``step`` (ns) for what of the newest move is a clock that was set."""
        assert self.move is not None
        self.steps += bool(step) - bool(self.move.stepped)
        self.stepped += step - self.move.stepped
        self.move = None

    def _stepped_by(self, change: float, error: float) -> float:
        """Return by how much (ns) the clock was set since the one before it; 0 where it was not.

        The stamps show a step to whole periods. How many of these are in it shows the ``change`` (ns) of the
        lag, whose ``error`` is known: arrivals alone make no step.
        """
        clock, old = self.clock, self._before
        assert clock is not None
        assert old is not None
        first = np.array([clock.index - self.opening.size + 1])
        by = (
            float(old.indices(clock.times(first, clock.base), clock.base)[0]) - old.index - 1.0
        ) * old.period
        step = by - round(by / old.period) * old.period
        # Twice the standard error of a line's mean is that of its end.
        ends = clock.jitter / math.sqrt(self.opening.size), old.jitter / math.sqrt(old.phase_count)
        noise = max(LEAST_STEP, 2.0 * SURE * math.hypot(*ends))
        goes_on = by <= LONGEST_GAP * 1e9 and abs(clock.period / old.period - 1.0) <= SAME_RATE
        if noise > 0.5 * HALF * old.period or not goes_on:
            # Lumps that beat with the samples shift the mean lag by up to a period, for seconds.
            least = max(2.0 * LEAST_STEP, old.period) if goes_on else SAME_LAG * 1e9
            step = change if abs(change) > max(least, error) else 0.0
        else:
            if abs(change - step) > error:
                step += round((change - step) / old.period) * old.period
            together = abs(change) < abs(change - step) and error <= 0.5 * abs(step)
            step = 0.0 if together or abs(step) <= noise else step
        if step or abs(by) > noise:
            self._note(by, step, noise, at=round(old.base + old.time))
        return step

    def _doubt_stamps(self, count: int, why: str) -> None:
        """Give the reason for which there is no clock once ``count`` stamps are wrong."""
        if self.clock is None and count >= MANY_WRONG:
            self.doubt = why

    def _leave_out_repeats(self) -> None:
        """Leave out messages that came twice: stamp and value are those of the one before."""
        stamps = np.array([stamp for stamp, _, _ in self._first], dtype=np.float64)
        values = np.array([value for _, value, _ in self._first])
        again, sure = repeated(stamps - stamps[:1], (values,))
        if again.any() and sure:
            self.refused[Refusal.DUPLICATE] += int(np.count_nonzero(again))
            self._first = [one for one, left_out in zip(self._first, again, strict=True) if not left_out]

    def _restart(self, *, contradicted: bool = False) -> None:
        """Make a clock again, from the samples that are held; ``contradicted``: they show another rate."""
        clock = self.clock
        assert clock is not None
        lasted = 1e-9 * (self.newest - int(self.opening[-1]))
        if lasted < PATIENCE * self.settle and (contradicted or not self._even):
            self.doubt = (
                f"the next stamps contradict the rate found, {clock.rate:.6g} Hz, after {lasted:.1f} s"
            )
        self._first, self._held = self._held, []
        self._before, self.clock = clock, None
        self.restarts += 1
        self.newest = self._first[-1][0] if self._first else self.newest

    def _drop_held(self) -> None:
        self.refused[Refusal.STRAY] += len(self._held)
        self._doubt_stamps(self.refused[Refusal.STRAY], Refusal.STRAY.value)
        self._held.clear()


def _without_a_stray(stamps: Indices) -> tuple[Stamps, int | None]:
    """Return what the stamps show, without one that alone shows no clock or has the first sample's stamp."""
    found = judge_stamps(stamps)
    if (found.rhythm is Rhythm.UNEVEN or stamps[0] == stamps[1]) and stamps.size > FEWEST:
        for place in (found.at, found.at - 1):
            rest = judge_stamps(np.delete(stamps, place))
            if rest.rhythm is Rhythm.EVEN:
                return rest, place
    return found, None


def _without_late_ones(stamps: Indices, even: Stamps) -> Stamps:
    """Return even stamps as jittering ones where a late stamp looks like a lost sample."""
    times = 1e-9 * (stamps - stamps[0])
    fits = []
    for indices in (_numbers(stamps, even), np.arange(stamps.size)):
        period, level = line_through(indices, times)
        fits.append((float(np.std(times - period * indices - level)), period))
    (scatter, _), (alone, period) = fits
    if SURE * scatter <= HALF * even.period:
        return even
    if even.gaps.size and alone <= scatter:  # nothing was lost
        return replace(even, rhythm=Rhythm.JITTER, rate=1.0 / period, lost=0, gaps=even.gaps[:0])
    return replace(even, rhythm=Rhythm.JITTER)


def _numbers(stamps: Indices, found: Stamps) -> Indices:
    """Return the number of each sample, from 0; what is missing is left out."""
    if found.times is not None:
        return np.asarray(np.rint((found.times - found.times[0]) * found.rate), dtype=np.int64)
    steps = np.ones(stamps.size, dtype=np.int64)
    steps[0] = 0
    at = found.gaps
    steps[at] = np.maximum(1, np.rint(1e-9 * (stamps[at] - stamps[at - 1]) * found.rate).astype(np.int64))
    return np.asarray(np.cumsum(steps), dtype=np.int64)
