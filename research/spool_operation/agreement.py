"""Agreement of the surrogate with the real estimator: the same days, once with each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from spool_core.numbers import Array
from spool_evaluation.results.page import markdown_table, study_command, write_page
from spool_evaluation.studies.workers import spread

from spool_operation.run_day import TRACED, DayOutcome, Trace, outcome_of
from spool_operation.surrogate import load_surrogate
from spool_operation.world import AROUND, BEFORE, ValveDay, draw_day, merged

#: s of each day that are run in full: the first hour of production, with its starts and changes of speed.
FULL = 3600

ABOUT = (
    "The first hour of production of each day, twice: blocks through the real estimator and monitor all the"
    " time, and estimates of the surrogate. A change is that of a parameter against its baseline, over the "
    "change that has to be found; the drift tests judge nothing else. Hourly drift is the largest mean "
    "change over a minute."
)


@dataclass(frozen=True, slots=True)
class DayPair:
    """Day run in full and with the surrogate: what the drift tests compared, shapes (n, 3), and events."""

    seed: int
    full: Array
    surrogate: Array
    outcomes: tuple[DayOutcome, DayOutcome]


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[DayPair]:
    """Run ``cases`` days both ways and compare; write the page into ``out``."""
    pairs: list[DayPair] = []
    for pair in spread(both, range(seed, seed + cases), "days in full", workers):
        pairs.append(pair)
        pairs.sort(key=lambda one: one.seed)
        command = study_command("operation-agreement", cases, seed)
        write_page(out / "operation_agreement.md", "Surrogate and estimator", command, parts(pairs))
    return pairs


def both(seed: int) -> DayPair:
    """Run the day of ``seed`` both ways."""
    day = first_hour(draw_day(seed))
    real = tuple((max(0, hold.begin - AROUND[0]), min(day.seconds, hold.end + 8)) for hold in day.holds)
    made = []
    for stretches in (merged(real, apart=20), ()):
        trace = Trace()
        outcome = outcome_of(replace(day, real=stretches, dense=True), trace)
        made.append((outcome, np.array(trace.shares).reshape(-1, 3)))
    return DayPair(seed, made[0][1], made[1][1], (made[0][0], made[1][0]))


def first_hour(day: ValveDay) -> ValveDay:
    """Return the first hour of production of ``day``, without lost data and restarts."""
    seconds = BEFORE + FULL
    holds = tuple(replace(one, end=min(one.end, seconds)) for one in day.holds if one.begin < seconds - 30)
    return replace(
        day, holds=holds, oil=day.oil[:seconds], reading=day.reading[:seconds], seconds=seconds,
        clock=day.clock[:seconds], gaps=(), restarts=(), real=(),
    )  # fmt: skip


def parts(pairs: list[DayPair]) -> list[str]:
    """Return the parts of the page."""
    rows = []
    for number, name in enumerate(TRACED):
        full, made = ([getattr(pair, which)[:, number] for pair in pairs] for which in ("full", "surrogate"))
        for title, measure in MEASURES.items():
            rows.append((name.replace("_", " "), title, *(f"{measure(days):.3f}" for days in (full, made))))
    false = [sum(len(pair.outcomes[which].false) for pair in pairs) for which in (0, 1)]
    hours = sum(pair.outcomes[0].blocks for pair in pairs) / 3600.0
    cost = [sum(pair.outcomes[which].cost for pair in pairs) for which in (0, 1)]
    return [
        ABOUT,
        f"{len(pairs)} days, {hours:.1f} hours of blocks. Surrogate: {load_surrogate().origin}.",
        markdown_table(("parameter", "measure", "estimator", "surrogate"), rows),
        f"False alarms: {false[0]} with the estimator, {false[1]} with the surrogate. Computing: "
        f"{cost[0]:.0f} s and {cost[1]:.1f} s.",
    ]


def _judged(days: list[Array]) -> float:
    return float(np.mean([np.isfinite(one).mean() for one in days]))


def _scatter(days: list[Array]) -> float:
    """Return the standard deviation of neighbouring changes' differences, median of the days."""
    spreads = [np.nanstd(np.diff(one)) for one in days if np.isfinite(one).sum() > 60]
    return float(np.median(spreads)) if spreads else math.nan


def _size(days: list[Array]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(days) ** 2)))


def _largest(days: list[Array]) -> float:
    drifts = []
    for one in days:
        kept = one[np.isfinite(one)]
        if kept.size >= 60:
            drifts.append(np.abs(np.convolve(kept, np.ones(60) / 60.0, "valid")).max())
    return float(np.median(drifts)) if drifts else math.nan


MEASURES = {
    "share judged": _judged,
    "change, rms": _size,
    "scatter from one estimate to the next": _scatter,
    "largest mean over a minute, median of the days": _largest,
}
