"""Study of the monitor on scenarios whose truth is known: events in time, and nothing else raised."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from spool_evaluation.monitor_cases.run import ScenarioOutcome, run_case, table
from spool_evaluation.monitor_cases.scenario import Scenario, draw_cases
from spool_evaluation.results.page import renew_json, study_command, write_page

from .workers import spread

ABOUT = (
    "Scenarios of known truth, shown to estimator and monitor as the live nodes would see them. "
    "Delays count from when the change is as large as it has to be found; one that is found earlier has a "
    "negative one. What is drawn, required and missed: "
    "[how well](../methods/monitoring.md#how-well)."
)


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[ScenarioOutcome]:
    """Replay ``cases`` scenarios, every kind in turn; ``out`` gets ``monitor_study.md`` and ``.json``."""
    page = MonitorPage(
        out / "monitor_study.md", "Scenarios of the monitor", study_command("monitor", cases, seed)
    )
    return replay_all(draw_cases(cases, seed), "scenarios", page, workers)


@dataclass(frozen=True, slots=True)
class MonitorPage:
    """Result page of a study of the monitor; the outcomes go into a JSON file of the same name."""

    path: Path
    title: str
    command: str

    def write(self, outcomes: Sequence[ScenarioOutcome]) -> None:
        """Write the page and the file."""
        renew_json(self.path.with_suffix(".json"), [one.to_dict() for one in outcomes])
        write_page(self.path, self.title, self.command, [ABOUT, table(outcomes)])


def replay_all(
    cases: Sequence[Scenario], what: str, page: MonitorPage, workers: int | None
) -> list[ScenarioOutcome]:
    """Replay ``cases``; write what is done after each, for a study of hours may be ended at any time."""
    page.path.parent.mkdir(parents=True, exist_ok=True)
    outcomes: list[ScenarioOutcome] = []
    numbers = {case.seed: number for number, case in enumerate(cases)}
    for outcome in spread(run_case, cases, what, workers):
        outcomes.append(outcome)
        outcomes.sort(key=lambda one: numbers[one.seed])
        page.write(outcomes)
    console = Console(width=160)
    console.print(table(outcomes), markup=False)
    for one in outcomes:
        if one.false or any(math.isnan(delay) for delay in one.delays):
            console.print(
                f"{one.kind}, number {numbers[one.seed]}: delays {one.delays}, false {one.false}",
                markup=False,
            )
    return outcomes
