"""Trend writer: a valve's history and its spool's travel, written in a thread beside the messages."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block, Samples
from spool_core.errors import InputError
from spool_core.kernels.compiled import compiled
from spool_core.kernels.strokes import Stroke
from spool_estimator.estimate import Estimate

from spool_monitor.state_database import PATIENCE, opened
from spool_monitor.trend import Sums, TrendStore

#: s of data between two writings: what a power loss costs.
INTERVAL = 10.0

#: Hz, below it the displacement is not known from accelerations; at twice that 3 % are missing.
LOW_CUT = 4.0

#: s, what the integrators take to forget their start after a gap.
SETTLING = 0.5

_DAMPING = math.sqrt(0.5)

# Places in the state of the kernel.
_DISPLACEMENT, _VELOCITY, _TURN, _EXTREME, _DIRECTION, _TRAVEL, _REVERSALS, _SETTLING = range(8)


class TrendWriter:
    """Trend writer of one valve, fed from its accepted blocks and its estimates.

    What can't be written, since another program holds the file or the disk is full, is held (a day of minutes
    at most) and written as soon as that is possible; :attr:`trouble` says so meanwhile. ``warn`` is called
    with one line for people when that begins and when it ends. A damaged file is put aside under
    ``NAME.damaged`` and a new one begun; one of a later version is left alone, and another kept next to it.
    Nothing is written while ``allowed`` says no: the folder may be another monitor's.
    """

    def __init__(
        self,
        path: Path,
        warn: Callable[[str], None],
        allowed: Callable[[], bool] = lambda: True,
        patience: float = PATIENCE,
    ) -> None:
        self.travel = TravelCounter()
        self.trouble = ""
        self._path, self._warn, self._allowed, self._patience = (path, warn, allowed, patience)
        self._sums = Sums()
        # Of the worker: what was not tried yet, and a writing that failed, which may be there all the same.
        self._held = Sums()
        self._failed: tuple[str, Sums] | None = None
        self._written = 0
        self._counted = (0.0, 0)
        self._store: TrendStore | None = None
        self._worker = ThreadPoolExecutor(1, "trends")
        self._writing: Future[None] | None = None

    def update(self, block: Block) -> None:
        """Take an accepted block."""
        self.travel.update(block)

    def update_strokes(self, strokes: Sequence[Stroke]) -> None:
        """Take the strokes that ended."""
        for stroke in strokes:
            self._sums.add_stroke(stroke)

    def update_estimate(self, estimate: Estimate) -> None:
        """Take an estimate; what was gathered is written where it is time for it."""
        self._sums.add_estimate(estimate)
        if not 0 <= estimate.stamp - self._written < round(INTERVAL * 1e9):
            self._written = estimate.stamp
            self.flush(estimate.stamp)

    def flush(self, stamp: int = 0) -> None:
        """Write what was gathered, unless the last writing still runs: it goes with the next one then."""
        runs = self._writing is not None and not self._writing.done()
        if runs or not self._allowed():
            return
        way, turns = self.travel.travel, self.travel.reversals
        self._sums.count("travel", "m", way - self._counted[0])
        self._sums.count("reversals", "1", float(turns - self._counted[1]))
        self._counted = (way, turns)
        taken, self._sums = self._sums, Sums()
        self._writing = self._worker.submit(self._write, taken, stamp)

    def close(self) -> None:
        """Write the rest and close the file; what can't be written now is lost, which is logged."""
        self._worker.shutdown()
        self._writing = None
        for _ in range(2):  # what fails once costs nothing
            if self.trouble:  # the process that holds the file must not hold up the end of the node again
                self._patience = 0.0
            self._worker = ThreadPoolExecutor(1, "trends")
            self.flush(self._written)
            self._worker.shutdown()
            self._writing = None
            if not self.trouble:
                break
        if self.trouble:
            self._warn(f"trends: unwritten data in memory are lost: {self.trouble}")
        self._let_go()

    def _write(self, sums: Sums, stamp: int) -> None:
        self._held.merge(sums)
        try:
            try:
                self._put(stamp)
            except InputError:  # damaged while it was in use: opening it again puts it aside
                self._let_go()
                self._put(stamp)
        except (InputError, OSError) as error:
            self._let_go()
            if not self.trouble:
                self._warn(f"trends can't be written; the monitor keeps a day of them in memory: {error}")
            self.trouble = str(error)
            return
        if self.trouble:
            self.trouble = ""
            self._warn("trends are written again, including those kept in memory")

    def _put(self, stamp: int) -> None:
        """Write what is held, and what failed before where the file does not have it.

        Raises:
            InputError: the file is damaged.
            OSError: it can't be written.

        """
        if self._store is None:
            self._store = opened(TrendStore, self._path, self._warn, self._patience)
            name = self._store.path.name
            if name != self._path.name:
                self._warn(f"{self._path}: a later version of the suite wrote it: trends now go to {name}")
        store = self._store
        if self._failed is not None:
            name, sums = self._failed
            if store.newest() != name:
                sums.merge(self._held)  # the many first
                self._held = sums
        name, sums = secrets.token_hex(8), self._held
        self._failed, self._held = (name, sums), Sums()
        store.write(sums, stamp, name)
        self._failed = None

    def _let_go(self) -> None:
        if self._store is not None:
            self._store.close()
            self._store = None


@dataclass(slots=True)
class TravelCounter:
    """Adds up the spool's way in the body, from turn to turn.

    The difference of both accelerations is integrated twice above :data:`LOW_CUT`. A turn counts when the
    spool has come back by ``threshold`` (m), so that noise does not travel: 0.05 m/s^2 rms on both sensors
    make 8 um. Way that is not finished by a turn is not counted yet.
    """

    threshold: float = 50.0e-6
    _state: NDArray[np.float64] = field(default_factory=lambda: np.zeros(8), init=False)
    _law: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6), init=False)
    _period: float = field(default=0.0, init=False)
    _due: int = field(default=0, init=False)

    @property
    def travel(self) -> float:
        """Way since the start, m."""
        return float(self._state[_TRAVEL])

    @property
    def reversals(self) -> int:
        """Turns since the start."""
        return int(self._state[_REVERSALS])

    def update(self, block: Block) -> None:
        """Take an accepted block; after a gap the integrators start again."""
        gap = abs(block.stamp - self._due) > 0.5 * (block.end - block.stamp) + 2e9 * block.sample_period
        if gap or block.sample_period != self._period:
            self._period = block.sample_period
            self._state[:_TRAVEL] = 0.0
            self._state[_SETTLING] = max(1.0, round(SETTLING / block.sample_period))
            self._law = integration_law(block.sample_period)
        self._due = block.end
        count_travel(block.body, block.spool, self._law, self.threshold, self._state)


def integration_law(period: float) -> NDArray[np.float64]:
    """Return the exact step of displacement and velocity over ``period`` s, shape (6,).

    Of ``z'' + 2 d w z' + w^2 z = a`` with ``a`` held over the step: four factors of the state, two of ``a``.
    """
    cut = 2.0 * math.pi * LOW_CUT
    damped = cut * math.sqrt(1.0 - _DAMPING**2)
    fade = math.exp(-_DAMPING * cut * period)
    cosine, sine = math.cos(damped * period), math.sin(damped * period)
    ratio = _DAMPING * cut / damped
    stay, pass_on = fade * (cosine + ratio * sine), fade * sine / damped
    return np.array(
        [stay, pass_on, -(cut**2) * pass_on, fade * (cosine - ratio * sine), (1.0 - stay) / cut**2, pass_on]
    )


@compiled
def count_travel(
    body: Samples, spool: Samples, law: NDArray[np.float64], threshold: float, state: NDArray[np.float64]
) -> None:
    """Integrate the samples (m/s^2, shape (n,)) and add way and turns to ``state``, shape (8,)."""
    for i in range(body.size):
        driving = float(spool[i]) - float(body[i])
        displacement, velocity = state[_DISPLACEMENT], state[_VELOCITY]
        now = law[0] * displacement + law[1] * velocity + law[4] * driving
        state[_DISPLACEMENT] = now
        state[_VELOCITY] = law[2] * displacement + law[3] * velocity + law[5] * driving
        if state[_SETTLING] > 0.0:
            state[_SETTLING] -= 1.0
            state[_TURN] = state[_EXTREME] = now
            continue
        direction = state[_DIRECTION]
        if direction == 0.0:
            if abs(now - state[_TURN]) > threshold:
                state[_DIRECTION] = 1.0 if now > state[_TURN] else -1.0
                state[_EXTREME] = now
        elif (now - state[_EXTREME]) * direction > 0.0:
            state[_EXTREME] = now
        elif (state[_EXTREME] - now) * direction > threshold:
            state[_TRAVEL] += abs(state[_EXTREME] - state[_TURN])
            state[_REVERSALS] += 1.0
            state[_TURN] = state[_EXTREME]
            state[_EXTREME] = now
            state[_DIRECTION] = -direction
