"""Study of false alarms over healthy hours with warming oil, changes of speed and standstills."""

from __future__ import annotations

from pathlib import Path

from spool_evaluation.monitor_cases.run import ScenarioOutcome
from spool_evaluation.monitor_cases.scenario import draw_hours
from spool_evaluation.results.page import study_command

from .monitor import MonitorPage, replay_all


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[ScenarioOutcome]:
    """Replay ``cases`` hours; ``out`` gets ``monitor_hours.md`` and ``monitor_hours.json``."""
    command = study_command("monitor-hours", cases, seed)
    page = MonitorPage(out / "monitor_hours.md", "Healthy hours of the monitor", command)
    return replay_all(draw_hours(cases, seed), "healthy hours", page, workers)
