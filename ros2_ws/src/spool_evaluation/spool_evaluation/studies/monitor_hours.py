"""The monitor over healthy hours with warming oil, changes of speed and standstills: does it keep quiet?"""

from __future__ import annotations

from pathlib import Path

from spool_evaluation.monitor_cases.draw import draw_hours
from spool_evaluation.monitor_cases.run import Outcome

from .monitor import replay_all


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[Outcome]:
    """Replay ``cases`` hours; ``out`` gets ``monitor_hours.md`` and ``monitor_hours.json``."""
    return replay_all(draw_hours(cases, seed), "healthy hours", out, "monitor_hours", workers)
