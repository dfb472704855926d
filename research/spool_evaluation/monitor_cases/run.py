"""Run of a scenario: simulated, and shown to estimator and monitor second by second."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from spool_core.block import Block
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.events.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.sensors import Sensor
from spool_sim.simulator import DEFAULT_START_STAMP, Simulator

from .scenario import ChannelFault, Scenario

#: Blocks a second.
BLOCK_RATE = 10


@dataclass(frozen=True, slots=True)
class ScenarioOutcome:
    """Outcome: what the monitor made of a scenario.

    Attributes:
        delays: s from when each expected event was due to when it was raised, NaN where it was not in time.
        false: what else was raised: (s, kind, cause).
        seconds: length of the case.

    """

    kind: str
    seed: int
    seconds: float
    expected: tuple[str, ...]
    delays: tuple[float, ...]
    false: tuple[tuple[float, str, str], ...]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``--json`` writes."""
        return {
            "kind": self.kind,
            "seed": self.seed,
            "duration_s": self.seconds,
            "expected": list(self.expected),
            "delays_s": list(self.delays),
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


def replay(case: Scenario, *, keep: bool = False, settings: MonitorSettings | None = None) -> Replay:
    """Return the cores after ``case``: those of the live nodes, with their default settings."""
    valve = case.drawn_valve
    chosen = settings or MonitorSettings(natural_frequency=valve.natural_frequency)
    one = Replay(Estimator(settings_for(valve)), Monitor(chosen), keep=keep)
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
    """Compare ``events`` with what ``case`` expects; a severity that grows is no event of its own."""
    raised = [
        ((event.stamp - DEFAULT_START_STAMP) * 1e-9, event.kind, event.cause)
        for event in events
        if event.state is EventState.RAISED
    ]
    delays = []
    right: set[tuple[float, str, str]] = set()
    for one in case.expected:
        fitting = [
            event
            for event in raised
            if event[1] == one.kind and (not one.causes or event[2] in one.causes) and event[0] >= one.begin
        ]
        right.update(fitting)
        first = min((event[0] for event in fitting), default=math.inf)
        delays.append(first - one.reached if first <= one.by else math.nan)
    false = [event for event in raised if event not in right and event[1] not in case.follows]
    return ScenarioOutcome(
        case.kind,
        case.seed,
        case.seconds,
        tuple(one.kind for one in case.expected),
        tuple(delays),
        tuple(false),
    )
