"""Study of operation: false alarms a valve-year, missed faults, delays, causes and cost, with intervals."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from spool_evaluation.results.page import interval, markdown_table, poisson_interval, renew_json, write_page
from spool_evaluation.studies.workers import resumed
from spool_report.outputs import suite_version

from spool_operation.comparison import YEAR, Comparison, compare, span
from spool_operation.faults import SPEEDS
from spool_operation.run_day import DayOutcome, RaisedEvent, run_day
from spool_operation.surrogate import load_surrogate

ROWS = "operation_days.jsonl"
#: Severity from which a fault is of the size of an alarm.
ALARM = 2.0
#: Failing days that the page lists.
LISTED = 40
#: Most days of each kind that detectors are compared on; more would change no median by its interval.
COMPARED = 500


def run(
    cases: int, seed: int, out: Path, workers: int | None = None, *, faulty: int = 0, day: int | None = None
) -> None:
    """Live ``cases`` healthy valve-days and ``faulty`` ones with a fault; write the page into ``out``.

    Days that ``out`` already holds are not simulated again; the comparison of detectors comes last.
    ``day`` replays the one day of that seed instead, healthy unless ``faulty`` is not 0.
    """
    if day is not None:
        outcome = run_day(day, faulty=faulty > 0)
        for line in _story(outcome):
            print(line)
        return
    command = f"./spool study operation --days {cases} --faulty {faulty} --seed {seed} --out DIR"
    write = partial(_write, out, command)
    found: list[DayOutcome] = []
    wanted = [(seed + number, False) for number in range(cases)]
    wanted += [(seed + number, True) for number in range(faulty)]
    # Faults are spread among healthy days: a study that is ended early has some of both.
    order = [wanted[int(one)] for one in np.random.default_rng(seed).permutation(len(wanted))]
    for outcome in resumed(
        out / ROWS, DayOutcome, lambda one: (one.seed, one.faulty), _live, order, "valve-days", workers
    ):
        found.append(outcome)
        if len(found) % 500 == 0:
            write(found, None)
    write(found, None)
    healthy, drifting = min(max(10, cases // 4), COMPARED), min(max(10, faulty // 2), COMPARED)
    write(found, compare(healthy, drifting, seed, workers))


def _live(which: tuple[int, bool]) -> DayOutcome:
    seed, faulty = which
    return run_day(seed, faulty=faulty)


def _write(out: Path, command: str, outcomes: Sequence[DayOutcome], comparison: Comparison | None) -> None:
    kept: dict[str, Any] = {"days": [asdict(one) for one in sorted(outcomes, key=lambda one: one.seed)]}
    if comparison is not None:
        kept["comparison"] = comparison.to_dict()
    renew_json(out / "operation.json", kept)
    write_page(out / "operation.md", "Operation", command, parts(outcomes, comparison))


def parts(outcomes: Sequence[DayOutcome], comparison: Comparison | None = None) -> list[str]:
    """Return the parts of the page."""
    healthy = [one for one in outcomes if not one.faulty]
    # Production may end before a slow drift is as large as it has to be found.
    faulty = [one for one in outcomes if one.faulty and (not one.speed or one.severity >= 1.0)]
    drifts = [one for one in faulty if one.speed]
    made = [
        ABOUT,
        f"Surrogate: {load_surrogate().origin}.",
        "## False alarms on healthy valves",
        f"{len(healthy)} valve-days, {sum(one.running for one in healthy) / 3600.0:.0f} hours of production, "
        f"{sum(one.blocks for one in healthy) / 3600.0:.1f} hours of real blocks around events.",
        false_table(healthy),
        "## Faults",
        f"{len(faulty)} days with a fault of the size that has to be found. Delays count from when the "
        "change is that large; an earlier one is negative. Brackets: 95 % intervals.",
        fault_table(faulty),
        summary(faulty),
        "## Delay and severity",
        severity_table(drifts),
        "## Cost",
        *_cost(healthy),
    ]
    if comparison is not None:
        made += ["## Compared with other detectors", *comparison.parts()]
    else:
        made += ["The run is not complete: the comparison with other detectors comes last."]
    return [*made, "## Days to look at", *_failing([*healthy, *faulty])]


ABOUT = (
    "Each valve-day follows from its seed: shifts, pauses, weekends, speeds through the resonance, oil that"
    " warms and cools with day and season, sensor noise, lost blocks, restarts of the software through the "
    "state files, and on the days with a fault one fault. The monitor, its state files, the watch for a "
    "model gap and all detectors are the ones that ship. Around one event of a healthy day, and around each"
    " fault that only samples show, real blocks go through the real estimator and the monitor. In between "
    "the monitor gets estimates of a surrogate of the estimator, so detectors that need samples (resonance,"
    " stuck spool, sensors) are counted for the hours of real blocks only. Faults of months are lapses of "
    "40 stretches of 4 minutes. How it works: [monitoring](../methods/monitoring.md#over-many-days)."
)


def false_table(healthy: Sequence[DayOutcome]) -> str:
    """Return false alarms by kind and cause, a valve-year."""
    years = len(healthy) / YEAR
    counts = Counter((event.kind, event.cause) for one in healthy for event in one.false)
    rows = [_rate(f"{kind} {cause}".strip(), count, years) for (kind, cause), count in sorted(counts.items())]
    days = sum(bool(one.false) for one in healthy)
    rows += [_rate("all kinds", sum(counts.values()), years), _rate("days with any", days, years)]
    return markdown_table(("kind, cause", "false alarms", "a valve-year", "95 % interval"), rows)


def _rate(name: str, count: int, years: float) -> tuple[str, str, str, str]:
    low, high = poisson_interval(count)
    if years == 0.0:
        return name, str(count), "-", "-"
    return name, str(count), f"{count / years:.2f}", f"{low / years:.2f} to {high / years:.2f}"


def fault_table(faulty: Sequence[DayOutcome]) -> str:
    """Return a row per fault and speed."""
    rows = []
    for name, speed in _groups(faulty):
        some = [one for one in faulty if (one.name, one.speed) == (name, speed)]
        found = [one for one in some if one.found is not None]
        rows.append((
            name, speed or "-", str(len(some)), _share(len(found), len(some)),
            _share(sum(one.right for one in found), len(found)),
            _delays([one.delay for one in found]), _delays([one.since_begin for one in found]),
        ))  # fmt: skip
    return markdown_table(
        ("fault", "grows", "days", "found", "cause right", "delay, median (quartiles)", "since it began"),
        rows,
    )


def summary(faulty: Sequence[DayOutcome]) -> str:
    """Return the shares that count over all faults."""
    large = [one for one in faulty if one.severity >= ALARM or not one.speed]
    measured = [one for one in large if one.thermometer]
    found = [one for one in faulty if one.found is not None]
    false = sum(len(one.false) for one in faulty)
    return (
        "Of alarm size (twice the change that has to be found, and all faults of sensors and sticking): "
        f"found {_share(sum(one.found is not None for one in large), len(large))}; where the oil's "
        f"temperature is measured {_share(sum(one.found is not None for one in measured), len(measured))}. "
        f"Of all: found {_share(len(found), len(faulty))}; cause right "
        f"{_share(sum(one.right for one in found), len(found))}. Other false alarms on these days: {false}."
    )


def severity_table(drifts: Sequence[DayOutcome]) -> str:
    """Return delays by severity and speed of drifts."""
    rows = []
    for name in sorted({one.name for one in drifts}):
        for low, high in ((1.0, 1.5), (1.5, 2.0), (2.0, 10.0)):
            some = [one for one in drifts if one.name == name and low <= one.severity < high]
            cells = []
            for speed in SPEEDS:
                delays = [one.delay for one in some if one.speed == speed and one.found is not None]
                missed = sum(one.speed == speed and one.found is None for one in some)
                cells.append(_delays(delays) + (f", {missed} missed" if missed else ""))
            rows.append((name, f"{low:g} to {high:g}", *cells))
    return markdown_table(("fault", "severity", *SPEEDS), rows)


def _cost(healthy: Sequence[DayOutcome]) -> list[str]:
    if not healthy:
        return []
    cost = np.array([one.cost for one in healthy])
    state = max(one.state for one in healthy)
    return [
        f"A valve-day takes {np.median(cost):.2f} s of computing (median; longest {cost.max():.1f} s). "
        f"State files at the end of a day: {state / 1000.0:.1f} kB at most."
    ]


def _failing(outcomes: Sequence[DayOutcome]) -> list[str]:
    failing = [
        one
        for one in sorted(outcomes, key=lambda one: (one.faulty, one.seed))
        if one.false or (one.faulty and (one.found is None or not one.right))
    ]
    if not failing:
        return ["None."]
    rows = [
        (str(one.seed), f"{one.name} {one.speed}".strip() or "healthy", _what(one))
        for one in failing[:LISTED]
    ]
    shown = "" if len(rows) == len(failing) else f", the first {len(rows)} of them"
    return [
        f"{len(failing)} days{shown}. Replay: `./spool study operation --day "
        f"SEED --out DIR` (with `--faulty 1` for a day with a fault), version {suite_version()}.",
        markdown_table(("seed", "day", "what happened"), rows),
    ]


def _what(one: DayOutcome) -> str:
    told = [f"false {_name(event)} at {event.at:.0f} s" for event in one.false[:3]]
    if one.faulty and one.found is None:
        told.insert(0, f"missed, severity {one.severity:.2f}")
    elif one.faulty and not one.right and one.found is not None:
        told.insert(0, f"called {_name(one.found)}")
    return "; ".join(told)


def _story(one: DayOutcome) -> list[str]:
    kind = f"{one.name} {one.speed}, severity {one.severity:.2f}" if one.faulty else "healthy"
    found = (
        ""
        if one.found is None
        else f"found as {_name(one.found)} at {one.found.at:.1f} s, delay {one.delay:.1f} s"
    )
    return [
        f"valve-day {one.seed}: {kind}",
        found or ("missed" if one.faulty else "nothing to find"),
        *(f"false: {_name(event)} at {event.at:.1f} s" for event in one.false),
        f"{one.running / 3600.0:.1f} h of production, {one.blocks:.0f} s of real blocks, {one.cost:.1f} "
        "s of computing",
    ]


def _name(event: RaisedEvent) -> str:
    return f"{event.kind} {event.cause}".strip().replace("_", " ")


def _groups(faulty: Sequence[DayOutcome]) -> list[tuple[str, str]]:
    speeds, found = ["", *SPEEDS], {(one.name, one.speed) for one in faulty}
    return sorted(found, key=lambda one: (not one[1], one[0], speeds.index(one[1])))


def _share(count: int, of: int) -> str:
    if not of:
        return "-"
    low, high = interval(count, of, "exact")
    return f"{count}/{of} = {100.0 * count / of:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"


def _delays(delays: Sequence[float]) -> str:
    kept = [one for one in delays if math.isfinite(one)]
    if not kept:
        return "-"
    low, middle, high = np.quantile(kept, [0.25, 0.5, 0.75])
    return f"{span(middle)} ({span(low)} to {span(high)})"
