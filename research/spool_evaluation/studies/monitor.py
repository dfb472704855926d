"""Study of the monitor on scenarios whose truth is known: events in time, and nothing else raised."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.block import Block
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.sensors import Sensor
from spool_sim.simulator import DEFAULT_START_STAMP, Simulator

from spool_evaluation.results.page import (
    interval,
    markdown_table,
    poisson_interval,
    renew_json,
    study_command,
    write_page,
)
from spool_evaluation.studies.scenarios import ChannelFault, Expected, Scenario, draw_cases
from spool_evaluation.studies.workers import spread

ABOUT = (
    "Scenarios of known truth, shown to estimator and monitor as the live nodes would see them. "
    "Delays count from when the change is as large as it has to be found; one that is found earlier has a "
    "negative one. An event may leave the right cause and another one open: such a one is found, and counted "
    "where no event of one cause followed in time. What is drawn, required and missed: "
    "[how well](../methods/monitoring.md#how-well)."
)


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[ScenarioOutcome]:
    """Replay ``cases`` scenarios, every kind in turn; ``out`` gets ``monitor_study.md`` and ``.json``."""
    scenarios = draw_cases(cases, seed)
    numbers = {case.seed: number for number, case in enumerate(scenarios)}
    done = spread(run_case, scenarios, "scenarios", workers)
    outcomes = sorted(done, key=lambda one: numbers[one.seed])
    print(write_study(outcomes, out, study_command("monitor", cases, seed)).read_text("utf-8"))
    for one in outcomes:
        if one.false or any(math.isnan(delay) for delay in one.delays):
            print(f"{one.kind}, number {numbers[one.seed]}: delays {one.delays}, false {one.false}")
    return outcomes


def write_study(outcomes: Sequence[ScenarioOutcome], out: Path, command: str) -> Path:
    """Write page and JSON file into ``out``; return the page."""
    renew_json(out / "monitor_study.json", [one.to_dict() for one in outcomes])
    page = out / "monitor_study.md"
    return write_page(page, "Scenarios of the monitor", command, [ABOUT, table(outcomes)])


#: Blocks a second.
BLOCK_RATE = 10


@dataclass(frozen=True, slots=True)
class ScenarioOutcome:
    """What the monitor made of a scenario.

    Attributes:
        delays: s from when each expected event was due to when it was raised, NaN where it was not in time.
        left_open: which of them named the right cause and another one until ``by``.
        false: what else was raised: (s, kind, cause).
        seconds: length of the case.

    """

    kind: str
    seed: int
    seconds: float
    expected: tuple[str, ...]
    delays: tuple[float, ...]
    false: tuple[tuple[float, str, str], ...]
    left_open: tuple[bool, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return what ``--json`` writes."""
        return {
            "kind": self.kind,
            "seed": self.seed,
            "duration_s": self.seconds,
            "expected": list(self.expected),
            "delays_s": list(self.delays),
            "left_open": list(self.left_open),
            "false": [{"t_s": t, "kind": kind, "cause": cause} for t, kind, cause in self.false],
        }


def stream(case: Scenario) -> Iterator[Block | tuple[int, float]]:
    """Yield the blocks of ``case`` and, once a second, (stamp in ns, oil temperature in deg C)."""
    simulator = Simulator(
        case.drawn_valve,
        case.machine,
        coulomb_force=case.coulomb_force,
        sample_rate=case.sample_rate,
        block_size=round(case.sample_rate / BLOCK_RATE),
        seed=case.seed,
        body_sensor=Sensor(noise=case.noise),
        spool_sensor=Sensor(noise=case.noise, gain_error=case.gain_error),
    )
    waiting = sorted(case.changes, key=lambda change: change.at)
    levels = {"body": 0.0, "spool": 0.0}
    noise = np.random.default_rng(case.seed + 1)
    for second in range(round(case.seconds)):
        while waiting and waiting[0].at < second + 1:
            change = waiting.pop(0)
            simulator.set_drift(change.quantity, change.target, change.duration)
        yield simulator.stamp, simulator.truth.oil_temperature
        for block in simulator.records(1.0):
            time = (block.stamp - DEFAULT_START_STAMP) * 1e-9
            if any(begin <= time < end for begin, end in case.gaps):
                continue
            hurt = block
            for fault in case.faults:
                if time >= fault.at:
                    hurt = _hurt(hurt, fault, levels, case.noise, noise)
            if hurt is block and time > 5.0:
                for name, level in levels.items():
                    rms = float(np.sqrt(np.mean(getattr(block, name) ** 2)))
                    levels[name] = max(level, rms)
            yield hurt


def replay(case: Scenario) -> Replay:
    """Return the cores after ``case``: those of the live nodes, with their default settings."""
    valve = case.drawn_valve
    settings = MonitorSettings(natural_frequency=valve.natural_frequency)
    one = Replay(Estimator(settings_for(valve)), Monitor(settings))
    for item in stream(case):
        if isinstance(item, Block):
            one.update(item)
        else:
            one.update_temperature(*item)
    return one


def run_case(case: Scenario) -> ScenarioOutcome:
    """Replay ``case`` and compare the events with what was expected."""
    return judge(case, replay(case).events)


def judge(case: Scenario, events: list[Event]) -> ScenarioOutcome:
    """Compare ``events`` with what ``case`` expects; a severity that grows is not counted again.

    An event that leaves open which of several causes it is counts where the right one is among them.
    """
    raised = [
        ((event.stamp - DEFAULT_START_STAMP) * 1e-9, event.kind, event.cause)
        for event in events
        if event.state is EventState.RAISED
    ]
    delays, left_open = [], []
    right: set[tuple[float, str, str]] = set()
    for one in case.expected:
        fitting = [
            event
            for event in raised
            if event[1] == one.kind and (not one.causes or _named(event[2], one)) and event[0] >= one.begin
        ]
        right.update(fitting)
        first = min((event[0] for event in fitting), default=math.inf)
        delays.append(first - one.reached if first <= one.by else math.nan)
        known = any(event[0] <= one.by and event[2] not in LEAVES_OPEN for event in fitting)
        left_open.append(first <= one.by and not known)
    false = [event for event in raised if event not in right and event[1] not in case.follows]
    return ScenarioOutcome(
        case.kind,
        case.seed,
        case.seconds,
        tuple(one.kind for one in case.expected),
        tuple(delays),
        tuple(false),
        tuple(left_open),
    )


#: Causes that each open one leaves.
LEAVES_OPEN = {
    "oil_or_wear": ("wear",),
    "sensor_or_friction": ("wear", "oil_contamination", "oil_viscosity"),
    "sensor_or_spring": ("softer", "stiffer"),
}


def _named(cause: str, expected: Expected) -> bool:
    return bool({cause, *LEAVES_OPEN.get(cause, ())} & set(expected.causes))


@dataclass(frozen=True, slots=True)
class ScenarioCounts:
    """Counts over the scenarios of one kind.

    So many events were ``expected`` and ``found`` in time, ``left_open`` of them with several causes; delays
    in s;
    ``false_alarms`` in ``hours``; ``lowest_rate`` is the lower end of the two-sided 95 % interval of the
    detection rate (Clopper and Pearson), ``highest_false`` the upper end of that of the false alarms per hour
    (Poisson).
    """

    kind: str
    cases: int
    expected: int
    found: int
    left_open: int
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
        return poisson_interval(self.false_alarms)[1] / self.hours


def counts(outcomes: Sequence[ScenarioOutcome]) -> list[ScenarioCounts]:
    """Return a row per kind in the order in which they come, and one of all."""
    kinds = list(dict.fromkeys(outcome.kind for outcome in outcomes))
    found = [_counted(kind, [outcome for outcome in outcomes if outcome.kind == kind]) for kind in kinds]
    return [*found, _counted("all", list(outcomes))]


def table(outcomes: Sequence[ScenarioOutcome]) -> str:
    """Return the counts as a table in Markdown."""
    body = []
    for row in counts(outcomes):
        wanted = row.expected > 0
        body.append((
            row.kind,
            str(row.cases),
            f"{row.found}/{row.expected}" if wanted else "-",
            str(row.left_open) if wanted else "-",
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
        "cause left open",
        "at least (95 %)",
        "delay, median / longest",
        "false alarms",
    )
    return markdown_table((*head, "hours", "false per hour, at most (95 %)"), body)


def _hurt(
    block: Block, fault: ChannelFault, levels: dict[str, float], noise: float, draw: np.random.Generator
) -> Block:
    body, spool = block.body, block.spool
    if fault.kind == "swapped":
        return replace(block, body=spool, spool=body)
    if fault.kind == "stuck":
        fresh = noise * draw.standard_normal(body.size)
        return replace(block, spool=(body + fresh).astype(np.float32))
    samples = np.asarray(body if fault.channel == "body" else spool, dtype=np.float64)
    if fault.kind == "dead":
        samples = fault.value * draw.standard_normal(samples.size)
    elif fault.kind == "clipping":
        full_scale = fault.value * levels[fault.channel]
        samples = np.clip(samples, -full_scale, full_scale)
    elif fault.kind == "offset":
        samples = samples + fault.value
    else:
        samples = samples * fault.value
    changed = samples.astype(np.float32)
    return replace(block, body=changed) if fault.channel == "body" else replace(block, spool=changed)


def _counted(kind: str, outcomes: list[ScenarioOutcome]) -> ScenarioCounts:
    delays = np.array([delay for outcome in outcomes for delay in outcome.delays])
    found = delays[np.isfinite(delays)]
    return ScenarioCounts(
        kind,
        len(outcomes),
        delays.size,
        found.size,
        sum(sum(outcome.left_open) for outcome in outcomes),
        float(np.median(found)) if found.size else math.nan,
        float(found.max()) if found.size else math.nan,
        sum(len(outcome.false) for outcome in outcomes),
        sum(outcome.seconds for outcome in outcomes) / 3600.0,
    )
