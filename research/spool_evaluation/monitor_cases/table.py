"""Counts of a study of the monitor, with their intervals, as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from spool_evaluation.results.page import markdown_table
from spool_evaluation.results.proportion import CONFIDENCE, interval

from .run import ScenarioOutcome


@dataclass(frozen=True, slots=True)
class ScenarioCounts:
    """Counts over the scenarios of one kind.

    So many events were ``expected`` and ``found`` in time, delays in s;
    ``false_alarms`` in ``hours``; ``lowest_rate`` is the lower end of the two-sided 95 % interval of the
    detection rate (Clopper and Pearson), ``highest_false`` the upper end of that of the false alarms per hour
    (Poisson).
    """

    kind: str
    cases: int
    expected: int
    found: int
    median_delay: float
    longest_delay: float
    false_alarms: int
    hours: float

    @property
    def lowest_rate(self) -> float:
        """Lower end of the detection rate's interval, NaN where nothing was expected."""
        if self.expected == 0:
            return math.nan
        return interval(self.found, self.expected, "exact")[0]

    @property
    def highest_false(self) -> float:
        """Upper end of the false alarms per hour."""
        return float(chi2.ppf(0.5 + 0.5 * CONFIDENCE, 2 * self.false_alarms + 2)) / 2.0 / self.hours


def counts(outcomes: Sequence[ScenarioOutcome]) -> list[ScenarioCounts]:
    """Return a row per kind in the order in which they come, and one of all."""
    kinds = list(dict.fromkeys(outcome.kind for outcome in outcomes))
    found = [_counted(kind, [outcome for outcome in outcomes if outcome.kind == kind]) for kind in kinds]
    return [*found, _counted("all", list(outcomes))]


def _counted(kind: str, outcomes: list[ScenarioOutcome]) -> ScenarioCounts:
    delays = np.array([delay for outcome in outcomes for delay in outcome.delays])
    found = delays[np.isfinite(delays)]
    return ScenarioCounts(
        kind,
        len(outcomes),
        delays.size,
        found.size,
        float(np.median(found)) if found.size else math.nan,
        float(found.max()) if found.size else math.nan,
        sum(len(outcome.false) for outcome in outcomes),
        sum(outcome.seconds for outcome in outcomes) / 3600.0,
    )


def table(outcomes: Sequence[ScenarioOutcome]) -> str:
    """Return the counts as a table in Markdown."""
    body = []
    for row in counts(outcomes):
        wanted = row.expected > 0
        body.append((
            row.kind,
            str(row.cases),
            f"{row.found}/{row.expected}" if wanted else "-",
            f"{100.0 * row.lowest_rate:.0f} %" if wanted else "-",
            f"{row.median_delay:.1f} / {row.longest_delay:.1f} s" if row.found else "-",
            str(row.false_alarms),
            f"{row.hours:.2f}",
            f"{row.highest_false:.2g}",
        ))  # fmt: skip
    head = (
        "scenario",
        "cases",
        "found in time",
        "at least (95 %)",
        "delay, median / longest",
        "false alarms",
    )
    return markdown_table((*head, "hours", "false per hour, at most (95 %)"), body)
