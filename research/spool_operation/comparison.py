"""Detectors compared at the same false-alarm rate, on the same faults.

Each peer sees, for one parameter, what the monitor's drift test compares. Its thresholds are set on other
healthy days so that one of the three is passed once a valve-year, as the monitor's parameters share one
interval: the largest statistic of each day, with an exponential tail beyond the highest tenth of the days.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from typing import Any

import numpy as np
from spool_core.numbers import Array
from spool_evaluation.results.page import markdown_table
from spool_evaluation.studies.workers import spread
from spool_monitor.parameter_drift import VISCOUS

from spool_operation.faults import SPEEDS
from spool_operation.peers import PEERS, first_alarm, median, soonest
from spool_operation.run_day import TRACED, Trace, outcome_of, severity_of
from spool_operation.world import ValveDay, draw_day

#: Seeds of the days that thresholds are set on lie this far from those that are reported.
APART = 10_000_000
#: Days in a valve-year, the rate of false alarms that every threshold is set to.
YEAR = 365.25
#: Share of the days whose largest statistics make the tail.
TAIL = 0.1
#: The shipped detector, as a row of the table.
MONITOR = "monitor"
#: The viscous coefficient of a day whose oil temperature nobody measures.
UNREFERRED = "viscous_coefficient, no thermometer"

#: Days without a thermometer that thresholds are set on, at least.
BARE = 10

#: Detector and setting.
Setting = tuple[str, str]


@dataclass(frozen=True, slots=True)
class HealthyMaxima:
    """Largest statistics of a healthy day by detector, setting and parameter; and alarms of the monitor."""

    seed: int
    largest: dict[tuple[str, str, str], float]
    alarms: int


@dataclass(frozen=True, slots=True)
class FaultTimes:
    """When each detector found a fault, s after it was as large as it has to be found; NaN where it did not.

    Before the fault began any alarm is false; then the day is counted as missed with infinity.
    """

    seed: int
    parameter: str
    speed: str
    delays: dict[Setting, float]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of detectors: thresholds from ``calibrated`` days, tried on ``tried`` others."""

    thresholds: dict[tuple[str, str, str], float]
    calibrated: int
    tried: Sequence[HealthyMaxima]
    faults: Sequence[FaultTimes]

    def to_dict(self) -> dict[str, Any]:
        """Return what the JSON file holds."""
        return {
            "calibrated_days": self.calibrated,
            "tried_days": len(self.tried),
            "thresholds": [[*key, value] for key, value in self.thresholds.items()],
            "faults": [
                {
                    "seed": one.seed,
                    "parameter": one.parameter,
                    "speed": one.speed,
                    "delays_s": [[*key, value] for key, value in one.delays.items()],
                }
                for one in self.faults
            ],
        }

    def false_alarms(self, setting: Setting) -> int:
        """Return how many of the tried healthy days raise an alarm."""
        if setting[0] == MONITOR:
            return sum(one.alarms > 0 for one in self.tried)
        return sum(
            any(value > self.thresholds[key] for key, value in one.largest.items() if key[:2] == setting)
            for one in self.tried
        )

    def best(self, detector: str, parameter: str, speed: str) -> tuple[Setting, Array]:
        """Return the setting that misses least and is soonest on these faults, and its delays."""
        some = [one for one in self.faults if (one.parameter, one.speed) == (parameter, speed)]
        settings = [(detector, name) for name in _settings(detector)]
        return soonest({setting: np.array([one.delays[setting] for one in some]) for setting in settings})

    def parts(self) -> list[str]:
        """Return the parts of the page."""
        detectors = [MONITOR, *PEERS]
        rows, lost = [], []
        for parameter in (*TRACED, UNREFERRED):
            for speed in SPEEDS:
                if not any((one.parameter, one.speed) == (parameter, speed) for one in self.faults):
                    continue
                found = {name: self.best(name, parameter, speed)[1] for name in detectors}
                rows.append((
                    parameter.replace("_", " "), speed, str(found[MONITOR].size),
                    *(_cell(found[name]) for name in detectors),
                ))  # fmt: skip
                if median(found[MONITOR]) > min(median(found[name]) for name in PEERS) + 1.0:
                    lost.append(f"{parameter.replace('_', ' ')} {speed}")
        behind = ", ".join(lost) if lost else "none"
        false = [
            (name, str(min(alarms)), str(max(alarms)))
            for name in detectors
            for alarms in ([self.false_alarms((name, setting)) for setting in _settings(name)],)
        ]
        return [
            ABOUT.format(calibrated=self.calibrated, tried=len(self.tried)),
            markdown_table(("parameter", "grows", "days", *detectors), rows),
            f"Where the monitor's median is later than the best peer's by more than a second: {behind}.",
            f"Days with an alarm of any of the three parameters among {len(self.tried)} healthy ones that no "
            "threshold was set on, over a detector's settings:",
            markdown_table(("detector", "fewest", "most"), false),
        ]


ABOUT = (
    "Every detector sees the same changes of one parameter, one a second. A peer's thresholds are set on "
    "{calibrated} healthy days so that one of the three parameters passes once a valve-year (exponential "
    "tail of the days' largest values), as the monitor's parameters share one interval; the monitor's "
    "limits follow from `false_alarm_interval` and the estimates' covariance. Of "
    "each peer the setting counts that does best on these faults, which favours it. Cells: median delay "
    "from when the change is as large as it has to be found, with the 95 % interval of the median, and how "
    "many were missed. river's ADWIN and KSWIN have no threshold to set to a rate, so they are left out. "
    "Warm oil looks like wear where no thermometer corrects for it, so the viscous coefficient of such days "
    "has separate thresholds and rows."
)


def compare(healthy: int, faulty: int, seed: int, workers: int | None) -> Comparison:
    """Set thresholds on ``healthy`` days, try them on as many others and on ``faulty`` days with a drift."""
    days = [seed + APART + number for number in range(healthy)]
    # Days without a thermometer are few, and have thresholds by parameter.
    bare = (day for day in count(seed + APART) if not draw_day(day).thermometer)
    days = sorted({*days, *islice(bare, BARE)})
    calibrated = list(spread(healthy_maxima, days, "days that thresholds are set on", workers))
    thresholds = {
        key: threshold_of([one.largest[key] for one in calibrated if key in one.largest])
        for key in sorted({key for one in calibrated for key in one.largest})
    }
    others = [seed + 2 * APART + number for number in range(healthy)]
    tried = list(spread(healthy_maxima, others, "healthy days", workers))
    drifting = drift_days(faulty, seed + 3 * APART)
    found = spread(partial(fault_times, thresholds), drifting, "days with a drift", workers)
    return Comparison(thresholds, len(calibrated), tried, sorted(found, key=lambda one: one.seed))


def drift_days(wanted: int, seed: int) -> list[int]:
    """Return seeds of ``wanted`` days whose fault is the drift of a parameter, from ``seed`` on."""
    found: list[int] = []
    while len(found) < wanted:
        day = draw_day(seed, faulty=True)
        if day.fault is not None and day.fault.quantity and severity_of(day) >= 1.0:
            found.append(seed)
        seed += 1
    return found


def healthy_maxima(seed: int) -> HealthyMaxima:
    """Live a healthy day and return what each detector showed at most."""
    trace, day = Trace(), draw_day(seed)
    outcome = outcome_of(day, trace)
    largest = {}
    for number, quantity in enumerate(TRACED):
        name, values = _watched(quantity, day), _judged(trace, number)[1]
        for detector, settings in PEERS.items():
            for setting, statistic in settings.items():
                largest[(detector, setting, name)] = float(statistic(values).max()) if values.size else 0.0
    kinds = ("friction_drift", "spring_change")
    return HealthyMaxima(seed, largest, sum(event.kind in kinds for event in outcome.false))


def threshold_of(largest: Sequence[float]) -> float:
    """Return what the largest value of a day passes once in as many valve-years as there are parameters."""
    ordered = np.sort(np.asarray(largest))
    tail = ordered[ordered.size - max(2, round(TAIL * ordered.size)) :]
    beyond = float((tail - tail[0]).mean())
    return float(tail[0]) + beyond * math.log(len(TRACED) * YEAR * tail.size / ordered.size)


def fault_times(thresholds: dict[tuple[str, str, str], float], seed: int) -> FaultTimes:
    """Live a day with a drift and return when each detector found it."""
    day = draw_day(seed, faulty=True)
    fault = day.fault
    assert fault is not None
    trace = Trace()
    outcome = outcome_of(day, trace)
    times, values = _judged(trace, TRACED.index(fault.quantity))
    at, name = day.operated(times), _watched(fault.quantity, day)
    delays: dict[Setting, float] = {(MONITOR, ""): outcome.delay}
    for detector, settings in PEERS.items():
        for setting, statistic in settings.items():
            first = first_alarm(statistic(values), thresholds[(detector, setting, name)], at)
            delays[(detector, setting)] = math.nan if first < fault.begin else first - fault.reached
    return FaultTimes(seed, name, fault.speed, delays)


def _watched(quantity: str, day: ValveDay) -> str:
    """Return the name under which ``quantity`` of ``day`` is compared."""
    return UNREFERRED if quantity == VISCOUS and not day.thermometer else quantity


def _judged(trace: Trace, number: int) -> tuple[Array, Array]:
    values = np.array([row[number] for row in trace.shares])
    kept = np.isfinite(values)
    return np.array(trace.times)[kept], values[kept]


def _settings(detector: str) -> list[str]:
    return [""] if detector == MONITOR else list(PEERS[detector])


def _cell(delays: Array) -> str:
    found = np.sort(delays[np.isfinite(delays)])
    missed = delays.size - found.size
    if not found.size:
        return f"{missed} missed"
    # Order statistics around the median: normal approximation of the binomial, as usual for a median.
    half = 0.98 * math.sqrt(found.size)
    low, high = (
        max(0, math.floor(found.size / 2 - half)),
        min(found.size - 1, math.ceil(found.size / 2 + half)),
    )
    text = f"{span(float(np.median(found)))} ({span(found[low])} to {span(found[high])})"
    return text + (f", {missed} missed" if missed else "")


def span(seconds: float) -> str:
    """Return a time with its sign in the unit that suits its size."""
    size = abs(seconds)
    for limit, unit, length in ((120.0, "s", 1.0), (7200.0, "min", 60.0), (172_800.0, "h", 3600.0)):
        if size < limit:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds / 86_400.0:.1f} d"
