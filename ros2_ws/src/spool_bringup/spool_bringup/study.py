"""Studies over many simulated scenarios whose truth is known."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from rich.console import Console
from spool_monitor.study.case import Case
from spool_monitor.study.draw import draw_cases, draw_hours
from spool_monitor.study.run import Outcome, run_case
from spool_monitor.study.table import markdown
from spool_stream.errors import InputError

from .commands import write_json
from .progress import progress

STUDIES = ("monitor",)


def run_study(what: str, cases: int, hours: int, seed: int, out: Path) -> None:
    """Run ``cases`` scenarios and ``hours`` healthy hours; ``out`` gets ``table.md`` and ``outcomes.json``.

    Raises:
        InputError: there is no such study, or nothing to run.

    """
    if what not in STUDIES:
        raise InputError(f"study {what}: there is no such study; there are {', '.join(STUDIES)}")
    if cases < 0 or hours < 0 or cases + hours == 0:
        raise InputError(f"study {what}: --cases {cases} --hours {hours}: use at least one of either")
    out.mkdir(parents=True, exist_ok=True)
    drawn = [*draw_cases(cases, seed), *draw_hours(hours, seed)]
    outcomes = []
    with progress("scenarios", len(drawn)) as advance:
        for outcome in _outcomes(drawn):
            outcomes.append(outcome)
            advance(1)
            # What is done is kept: a study of hours may be ended at any time.
            write_json(out / "outcomes.json", [one.to_dict() for one in outcomes])
            (out / "table.md").write_text(markdown(outcomes), encoding="utf-8")
    console = Console(width=160)
    console.print(markdown(outcomes), markup=False)
    for one in outcomes:
        if one.false or any(math.isnan(delay) for delay in one.delays):
            console.print(
                f"{one.kind}, seed {one.seed}: delays {one.delays}, false {one.false}", markup=False
            )


def _outcomes(cases: Sequence[Case]) -> Iterator[Outcome]:
    with ProcessPoolExecutor(initializer=os.nice, initargs=(10,)) as pool:
        yield from pool.map(run_case, cases)
