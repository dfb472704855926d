"""Memory of the monitor over a simulated year of one valve."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from spool_core.numbers import Array

from .run_day import DayRun
from .world import draw_day, stretches_of

#: Days of the year, s of production that are simulated of each.
DAYS, EACH = 365, 120
#: Days from which the slope counts: until then the bounded histories fill.
FILLED = 60


@dataclass(frozen=True, slots=True)
class YearMemory:
    """Size of the monitor's whole state and of its state files, bytes at the end of each day, shapes (n,)."""

    monitor: Array
    files: Array

    @property
    def slope(self) -> float:
        """Growth of the monitor's state, bytes a day."""
        days = np.arange(self.monitor.size)[FILLED:]
        return float(np.polyfit(days, self.monitor[FILLED:], 1)[0]) if days.size > 2 else 0.0

    def text(self) -> str:
        """Return what the page states."""
        return (
            f"One valve over a simulated year ({self.monitor.size} days, {EACH} s of production of "
            "each): the "
            f"monitor's state grows by {self.slope:.1f} bytes a day and is "
            f"{self.monitor.max() / 1000.0:.0f} kB at "
            f"most (serialised size of all its objects); state files are {self.files.max() / 1000.0:.1f} "
            "kB at most."
        )


class _YearRun(DayRun):
    """Run of stretches of a year; sizes are taken at the end of each."""

    sizes: list[tuple[int, int]]

    def run(self) -> None:
        """Live the stretches."""
        self.sizes = []
        super().run()

    def _ended(self) -> None:
        self.sizes.append((len(pickle.dumps(self.monitor)), self.state_size))


def simulated_year(seed: int, days: int = DAYS) -> YearMemory:
    """Live ``days`` of one valve, without a restart, and take the size of what is kept."""
    day = draw_day(seed)
    draw = np.random.default_rng([seed, 31])
    year = replace(stretches_of(draw, day, days, EACH, 86_400), weekend=0.0, fault=None, dense=True)
    with TemporaryDirectory() as folder:
        one = _YearRun(year, Path(folder))
        one.run()
        one.close()
    monitor, files = np.array(one.sizes, dtype=float).T
    return YearMemory(monitor, files)
