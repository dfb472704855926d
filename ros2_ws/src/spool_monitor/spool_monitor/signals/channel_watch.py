"""Channel watch: the last seconds of both channels, looked at now and then for faults of the channels.

The rules are those for records: :mod:`spool_estimator.identification.signals.channel_faults`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from spool_core.block import Samples
from spool_estimator.identification.signals.channel_faults import (
    ChannelFault,
    PairLook,
    faults_of_rows,
    look_at_pair,
)

from .window import SignalWindow

#: s of samples that are kept, and that the samples themselves are looked at every so often.
KEPT, ROWS = 8.0, 2.0
#: s from one look at the pair to the next: as a rule, where the last one found something, and where the model
#: suddenly leaves more; looks of the latter kind in a row, after which it is as a rule again.
USUALLY, FOUND, URGENT, MOST_URGENT = 60.0, 2.0, 1.0, 10
#: Growth of the estimator's residual over its usual value that makes a look urgent, and its usual pace.
GROWN, PACE = 1.5, 0.02


class ChannelLook(NamedTuple):
    """Look at the channels at ``stamp`` (ns).

    ``rows`` are the faults that the samples themselves show; ``pair`` is what both channels show of each
    other, ``None`` where it was not looked at or cannot be judged; ``paired`` says whether it was looked at.
    """

    stamp: int
    rows: tuple[ChannelFault, ...]
    pair: PairLook | None
    paired: bool

    def fault(self, cause: str) -> ChannelFault | None:
        """Return the fault of this ``cause``, ``None`` where it is not seen."""
        pair = self.pair.fault if self.pair is not None else None
        return next((one for one in (*self.rows, pair) if one is not None and one.cause == cause), None)


@dataclass(slots=True)
class ChannelWatch:
    """Channel watch of one valve: takes its windows, says what the channels show; bounded in memory."""

    _kept: deque[Samples] = field(default_factory=deque, init=False)
    _period: float = field(default=0.0, init=False)
    _hop: int = field(default=0, init=False)
    _count: int = field(default=0, init=False)
    _rows_at: int = field(default=0, init=False)
    _pair_at: int = field(default=0, init=False)
    _due: float = field(default=KEPT, init=False)
    _usual: float = field(default=float("nan"), init=False)
    _urgent: int = field(default=0, init=False)

    def restart(self, period: float) -> None:
        """Forget all samples; the next ones are ``period`` s apart."""
        self._kept.clear()
        self._period, self._count, self._rows_at, self._pair_at, self._due = period, 0, 0, 0, KEPT

    def take_residual(self, residual: float) -> None:
        """Take what the estimator's model leaves, relative; more than usual makes the next look urgent."""
        if not residual > 0.0:
            return
        if not self._usual > 0.0 or residual < self._usual:
            self._usual = residual
        if residual > GROWN * self._usual:
            if self._urgent < MOST_URGENT:
                self._due = min(self._due, URGENT)
        else:
            self._urgent = 0
        self._usual += PACE * (residual - self._usual)

    def update(self, window: SignalWindow, hop: int) -> ChannelLook | None:
        """Take a window, whose newest ``hop`` samples are new; return a look where one is due."""
        # The first window is new as a whole.
        fresh = window.samples[:, -hop:] if self._kept else window.samples
        self._kept.append(fresh.copy())
        self._count += fresh.shape[1]
        while (self._count - self._kept[0].shape[1]) * self._period >= KEPT:
            self._count -= self._kept.popleft().shape[1]
        rows_due = self._rows_at == 0 or window.stamp - self._rows_at >= ROWS * 1e9
        since = 1e-9 * (window.stamp - self._pair_at) if self._pair_at else self._count * self._period
        pair_due = since >= self._due and self._count * self._period >= KEPT - 1e-6
        if not rows_due and not pair_due:
            return None
        body, spool = np.concatenate(self._kept, axis=1).astype(np.float64)
        self._rows_at = window.stamp
        rows = tuple(faults_of_rows(body, spool, self._period))
        pair = None
        paired = pair_due and not rows
        if paired:
            pair = look_at_pair(body, spool, self._period, -self._count * self._period)
            found = pair is not None and pair.fault is not None and pair.fault.cause != "delay"
            self._urgent = self._urgent + 1 if self._due == URGENT else 0
            self._pair_at, self._due = window.stamp, FOUND if found else USUALLY
        return ChannelLook(window.stamp, rows, pair, paired)
