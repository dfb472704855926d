"""What a study found, as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, chi2

from .run import Outcome

#: Of every interval.
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Row:
    """The cases of one kind: how many events were ``expected`` and ``found`` in time, delays in s.

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
        missed = self.expected - self.found
        return float(beta.ppf(0.5 - 0.5 * CONFIDENCE, self.found, missed + 1)) if self.found else 0.0

    @property
    def highest_false(self) -> float:
        """Upper end of the false alarms per hour."""
        return float(chi2.ppf(0.5 + 0.5 * CONFIDENCE, 2 * self.false_alarms + 2)) / 2.0 / self.hours


def rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return a row per kind in the order in which they come, and one of all."""
    kinds = list(dict.fromkeys(outcome.kind for outcome in outcomes))
    table = [_row(kind, [outcome for outcome in outcomes if outcome.kind == kind]) for kind in kinds]
    return [*table, _row("all", list(outcomes))]


def _row(kind: str, outcomes: list[Outcome]) -> Row:
    delays = np.array([delay for outcome in outcomes for delay in outcome.delays])
    found = delays[np.isfinite(delays)]
    return Row(
        kind,
        len(outcomes),
        delays.size,
        found.size,
        float(np.median(found)) if found.size else math.nan,
        float(found.max()) if found.size else math.nan,
        sum(len(outcome.false) for outcome in outcomes),
        sum(outcome.seconds for outcome in outcomes) / 3600.0,
    )


def markdown(outcomes: Sequence[Outcome]) -> str:
    """Return the table as Markdown."""
    lines = [
        "| scenario | cases | found in time | at least (95 %) | delay, median / longest | false alarms "
        "| hours | false per hour, at most (95 %) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows(outcomes):
        wanted = row.expected > 0
        found = f"{row.found}/{row.expected}" if wanted else "-"
        rate = f"{100.0 * row.lowest_rate:.0f} %" if wanted else "-"
        delay = f"{row.median_delay:.1f} / {row.longest_delay:.1f} s" if row.found else "-"
        lines.append(
            f"| {row.kind} | {row.cases} | {found} | {rate} | {delay} | {row.false_alarms} | {row.hours:.2f} "
            f"| {row.highest_false:.2g} |"
        )
    return "\n".join(lines) + "\n"
