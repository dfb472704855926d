"""The monitor on scenarios whose truth is known: is everything found, in time, and nothing else raised?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from spool_tools.commands.bag_commands import write_json

from spool_evaluation.monitor_cases.case import Case
from spool_evaluation.monitor_cases.draw import draw_cases
from spool_evaluation.monitor_cases.run import Outcome, run_case
from spool_evaluation.monitor_cases.table import markdown

from .workers import spread


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[Outcome]:
    """Replay ``cases`` scenarios, every kind in turn; ``out`` gets ``monitor.md`` and ``monitor.json``."""
    return replay_all(draw_cases(cases, seed), "scenarios", out, "monitor", workers)


def replay_all(cases: Sequence[Case], what: str, out: Path, name: str, workers: int | None) -> list[Outcome]:
    """Replay ``cases``; write what is done after each, for a study of hours may be ended at any time."""
    out.mkdir(parents=True, exist_ok=True)
    outcomes: list[Outcome] = []
    numbers = {case.seed: number for number, case in enumerate(cases)}
    for outcome in spread(run_case, cases, what, workers):
        outcomes.append(outcome)
        outcomes.sort(key=lambda one: numbers[one.seed])
        write_json(out / f"{name}.json", [one.to_dict() for one in outcomes])
        (out / f"{name}.md").write_text(markdown(outcomes), encoding="utf-8")
    console = Console(width=160)
    console.print(markdown(outcomes), markup=False)
    for one in outcomes:
        if one.false or any(math.isnan(delay) for delay in one.delays):
            console.print(
                f"{one.kind}, number {numbers[one.seed]}: delays {one.delays}, false {one.false}",
                markup=False,
            )
    return outcomes
