"""Records of displacement and force: as files hold them, and what derivatives and low-passes make of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import signal
from scipy.ndimage import gaussian_filter1d
from spool_bag import DISPLACEMENT, FORCE
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import percent
from spool_report.records.record_sources import is_table, record_of_table
from spool_report.requests import Selection

#: Polynomial that velocity and acceleration are taken from, and how much of the fastest motion it spans.
DEGREE = 3
#: Deviations at which the low-pass ends: the kernel of its second derivative must add up to 0, or it reads a
#: spring out of a displacement. At 4 it adds up to 1e-3 of its peak, at 6 to 1e-7.
TRUNCATED = 6.0
#: Scatter of the sampling steps of a force record, over their median, from which a warning speaks of
#: resampling: a step's worth of motion is then off by a hundredth.
UNEVEN = 0.01
#: Samples of a stretch at least.
LEAST = 30


@dataclass(frozen=True, slots=True)
class ForceRecord:
    """Evenly spaced samples without gaps.

    Attributes:
        name: of the file.
        start: s, time of the first sample.
        period: s between samples.
        displacement: m, shape (n,).
        force: N, shape (n,).
    """

    name: str
    start: float
    period: float
    displacement: Array
    force: Array

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            InputError: the rows differ in length or hold what is not a number.
        """
        if self.displacement.shape != self.force.shape or self.force.ndim != 1:
            raise InputError(f"{self.name}: displacement and force must be rows of one length")
        if not (np.isfinite(self.displacement).all() and np.isfinite(self.force).all()):
            raise InputError(f"{self.name}: displacement or force contains values that are not numbers")

    @property
    def duration(self) -> float:
        """s."""
        return self.force.size * self.period

    @property
    def time(self) -> Array:
        """s, shape (n,)."""
        return np.asarray(self.start + self.period * np.arange(self.force.size), dtype=np.float64)

    def smoothing(self) -> int:
        """Return the odd number of samples over which velocity and acceleration are taken.

        An eighth of the period of the fastest motion that matters, so that the slopes lose about 1 %.
        """
        lines = np.abs(
            np.fft.rfft((self.displacement - self.displacement.mean()) * np.hanning(self.force.size))
        )
        frequency = np.fft.rfftfreq(self.force.size, self.period)
        power = np.cumsum((lines * frequency) ** 2)
        if power[-1] <= 0.0:
            return 5
        fastest = float(frequency[min(np.searchsorted(power, 0.9 * power[-1]), frequency.size - 1)])
        wanted = round(0.125 / max(fastest, 1e-9) / self.period)
        return int(np.clip(wanted | 1, 5, max(5, (self.force.size // 8) | 1)))

    def low_passed(self, row: Array, order: int = 0) -> Array:
        """Return ``row`` (shape (n,), in its unit) through a Gaussian low-pass, or its derivative over time.

        Its deviation is a 32nd of the fastest motion's period: 2 % are lost there. All orders share one
        operator, so a balance of forces that holds for the rows holds for what this makes of them.
        """
        width = max(1.0, 0.25 * self.smoothing())
        passed = gaussian_filter1d(row, width, order=order, mode="nearest", truncate=TRUNCATED)
        return np.asarray(passed) / self.period**order

    def answer(self, order: int = 0) -> Array:
        """Return what :meth:`low_passed` makes of a single sample of 1, over its whole reach."""
        pulse = np.zeros(8 * self.smoothing() + 1)
        pulse[pulse.size // 2] = 1.0
        return self.low_passed(pulse, order)

    def cut(self, count: int) -> list[ForceRecord]:
        """Return ``count`` parts in their order, which differ by a sample at most."""
        edges = (self.force.size * np.arange(count + 1)) // count
        return [
            ForceRecord(
                self.name, self.start + low * self.period, self.period, self.displacement[low:high],
                self.force[low:high],
            )
            for low, high in pairwise(edges.tolist())
        ]  # fmt: skip

    @property
    def inner(self) -> Array:
        """1 where ``low_passed`` knows both sides, else 0, shape (n,)."""
        reach = min(self.force.size // 3, int(np.ceil(0.25 * TRUNCATED * self.smoothing())))
        known = np.ones(self.force.size)
        known[:reach] = known[-reach:] = 0.0
        return known

    def derivative(self, order: int) -> Array:
        """Return the displacement's derivative over time, m/s or m/s^2, shape (n,)."""
        return np.asarray(
            signal.savgol_filter(
                self.displacement, self.smoothing(), DEGREE, deriv=order, delta=self.period, mode="interp"
            )
        )


def white_power(row: Array) -> float:
    """Return the power of the white noise in ``row``, from its third differences' quieter half."""
    differences = np.diff(row, 3) ** 2 / 20.0
    return float(np.median(differences) / 0.455)


def force_records(
    paths: Sequence[Path], kind: str, selection: Selection, notes: list[str]
) -> list[ForceRecord]:
    """Return the stretches of ``paths`` without a gap, evenly sampled; ``notes`` gets what was resampled."""
    found = []
    for path in paths:
        if not is_table(path):
            raise InputError(f"{path}: a record of kind {kind} is a file with displacement_m and force_N")
        table = record_of_table(path, kind, selection.columns, how=selection.how, regular=False)
        inside = (table.time - table.time[0] >= selection.start) & (
            table.time - table.time[0] < selection.stop
        )
        for begin, end in pairwise([0, *table.gaps.tolist(), table.time.size]):
            own = np.arange(begin, end)[inside[begin:end]]
            if own.size < LEAST:
                continue
            time = table.time[own]
            uneven = float(np.std(np.diff(time)) / table.period)
            if uneven > UNEVEN:
                notes.append(
                    f"{path}: unevenly sampled (steps of {1e3 * table.period:.4g} ms scatter by "
                    f"{percent(uneven)}): resampled by straight lines"
                )
            even = np.arange(time[0], time[-1] + 0.5 * table.period, table.period)
            rows = (np.interp(even, time, table.columns[name][own]) for name in (DISPLACEMENT, FORCE))
            found.append(ForceRecord(str(path), float(time[0]), table.period, *rows))
    if paths and not found:
        raise InputError(f"{paths[0]}: no stretch of {LEAST} samples without a gap in it")
    return found
