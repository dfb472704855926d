"""An interruption leaves the judgements that would have come without it."""

from __future__ import annotations

import copy
import errno
import math
import os
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import Judgement, MonitorSettings, event_kind
from spool_monitor.estimate_gate import Descriptions
from spool_monitor.event import Condition, Event, EventState, Finding, Severity
from spool_monitor.monitor import HealthLevel, Monitor
from spool_monitor.parameter_drift import CAP, VISCOUS, Outlook
from spool_monitor.state_file import HealthyValue, StateTable
from spool_monitor.valve_state import ValveState
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

VALVE = find_valve("4weh10_soft")
SETTINGS = MonitorSettings(natural_frequency=VALVE.natural_frequency, baseline_time=4.0)
SECOND = 1_000_000_000
#: Blocks of 0.1 s.
RATE, SIZE, STEP = 500.0, 50, SECOND // 10
#: Kinds of events that report the interruption itself.
OWN = ("stale", "data_fault")
#: Blocks from one copy of a story's chain to the next.
APART = 25
#: Few examples as a rule, many where new ones are searched for. A smaller one would not be clearer.
FEW = settings(max_examples=3 if settings().derandomize else 300, phases=(Phase.explicit, Phase.generate))


@dataclass(frozen=True)
class Plot:
    """What happens to a valve: changes of its parameters at blocks, and blocks with a dead accelerometer.

    ``oil``: deg C before and from a block on.
    """

    blocks: int
    changes: dict[int, tuple[str, float]] = field(default_factory=dict)
    dead: range = range(0)
    oil: tuple[int, float, float] = (0, VALVE.oil_temperature, VALVE.oil_temperature)


FAULTS = {
    "contaminated and cleaned": Plot(410, {80: ("coulomb_force", 0.26), 190: ("coulomb_force", 0.1)}),
    "a softer spring": Plot(240, {80: ("spring_stiffness", 0.75 * VALVE.spring_stiffness)}),
    "worn": Plot(280, {80: ("viscous_coefficient", 0.65 * VALVE.viscous_coefficient)}),
    "a dead accelerometer": Plot(260, dead=range(90, 160)),
}
PLOTS = {**FAULTS, "healthy": Plot(190)}
#: Blocks after which the healthy valve is known.
LEARNED = 65


def simulated(plot: Plot, valve: str = VALVE.id, seed: int = 5) -> list[Block]:
    noisy = Sensor(noise=0.03)
    simulator = Simulator(
        find_valve(valve), PRESETS["multisine"], coulomb_force=0.1, seed=seed, sample_rate=RATE,
        block_size=SIZE, body_sensor=noisy, spool_sensor=noisy,
    )  # fmt: skip
    blocks: list[Block] = []
    simulator.set_drift("oil_temperature", plot.oil[1])
    for number in range(plot.blocks):
        if number == plot.oil[0]:
            simulator.set_drift("oil_temperature", plot.oil[2])
        if number in plot.changes:
            simulator.set_drift(*plot.changes[number], 0.5)
        block = simulator.next_block()
        still = np.full_like(block.body, blocks[plot.dead[0] - 1].body[-1]) if number in plot.dead else None
        blocks.append(block if still is None else replace(block, body=still))
    return blocks


@dataclass
class Chain:
    """Estimator, monitor and what is kept, called as their nodes call them."""

    estimator: Estimator = field(
        default_factory=lambda: Estimator(settings_for(VALVE, period=0.5, memory=2.0))
    )
    monitor: Monitor = field(default_factory=lambda: Monitor(SETTINGS))
    state: ValveState = field(init=False)
    celsius: float = VALVE.oil_temperature
    events: list[Event] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._open(None)

    def _open(self, folder: Path | None) -> None:
        self.state = ValveState(self.monitor, folder, self.warnings.append)
        self.state.open()
        self.state.baseline.identify(VALVE.id, VALVE.oil)

    def take(self, block: Block) -> list[Estimate]:
        """Take a block, each second with the oil's temperature if any; return the estimates that fell due."""
        if block.sequence % 10 == 0 and math.isfinite(self.celsius):
            self.estimator.update_temperature(block.stamp, self.celsius)
        estimates = self.estimator.update(block)
        self.tell(self.monitor.update(block))
        for estimate in estimates:
            self.estimate(estimate)
        return estimates

    def estimate(self, estimate: Estimate) -> None:
        self.tell(self.monitor.update_estimate(estimate))
        if self.state.baseline.update(estimate):
            self.state.keep_baseline()

    def tell(self, events: list[Event]) -> None:
        self.events += events
        transitions = [self.state.alarms.update(event) for event in events]
        if any(transition.changed for transition in transitions):
            self.state.keep_alarms()

    def silence(self, seconds: float) -> None:
        """Let nothing come for ``seconds``."""
        latest = self.estimator.stale() if seconds > 1.5 else None
        if latest is not None:
            self.estimator.latest = latest
            self.estimate(latest)
        self.tell(self.monitor.idle(seconds, seconds))

    def keep_in(self, folder: Path) -> None:
        """Keep from now on, and what there is, in ``folder``."""
        former, self.state = self.state, ValveState(self.monitor, folder, self.warnings.append)
        self.state.alarms, self.state.baseline = former.alarms, former.baseline
        self.state.open()
        self.state.keep_alarms()
        self.state.keep_baseline()

    def restart_monitor(self) -> None:
        """End the monitor's process; the next one takes up what was kept."""
        folder = self.state.folder
        self.state.close()
        self.monitor = Monitor(SETTINGS)
        self._open(folder)


@dataclass(frozen=True)
class Story:
    """A plot without an interruption: its blocks, and its chain each APART blocks and at the end."""

    blocks: list[Block]
    estimates: list[list[Estimate]]
    drifts: list[list[float]]
    doubts: list[str]
    copies: list[Chain]

    def until(self, moment: int) -> Chain:
        """Return a chain that has taken the blocks before ``moment``."""
        chain = copy.deepcopy(self.copies[moment // APART])
        for block in self.blocks[moment - moment % APART : moment]:
            chain.take(block)
        return chain


@cache
def told(plot: str) -> Story:
    """Return the story of a plot; nobody may change it."""
    blocks = simulated(PLOTS[plot])
    chain, copies, estimates, drifts, doubts = Chain(), [], [], [], []
    for number, block in enumerate(blocks):
        if number % APART == 0:
            copies.append(copy.deepcopy(chain))
        estimates.append(chain.take(block))
        drifts.append(drifted(chain.monitor))
        doubts.append(chain.monitor.detection.distrust)
    return Story(blocks, estimates, drifts, doubts, [*copies, chain])


def drifted(monitor: Monitor) -> list[float]:
    """Return how far the drift tests have come: sums and smoothed change of each, and what is raised."""
    tests, conditions = monitor.detection.parameters.values(), monitor.detection.conditions
    raised = [float(one.active or 0) for name, one in conditions.items() if name.startswith("friction_drift")]
    return [value for one in tests for value in (one.sum.up, one.sum.down, one.share)] + raised


@cache
def foreign() -> list[Block]:
    """Return what a second source sends: another valve."""
    return simulated(Plot(60), "4weh10_stiff", seed=9)


@dataclass(frozen=True)
class Interruption:
    """What happens between two blocks.

    Attributes:
        seconds: by which the later stamps are ahead; negative for a clock that was set back.
        silent: nothing came meanwhile; otherwise the clock was set.
        sequence: of the later blocks: goes on, counts the time, or begins again with the source.
        monitor, estimator: whether it is restarted.
        rivals: blocks of a second source that come between the next ones.

    """

    seconds: float = 0.0
    silent: bool = True
    sequence: str = "goes on"
    monitor: bool = False
    estimator: bool = False
    rivals: int = 0

    def later(self, block: Block, moment: int) -> Block:
        counted = max(0, round(self.seconds * SECOND / STEP)) if self.sequence == "counts" else 0
        first = moment if self.sequence == "begins again" else 0
        shifted = block.stamp + round(self.seconds * SECOND)
        return replace(block, stamp=shifted, sequence=block.sequence - first + counted)


@st.composite
def interruptions(draw: st.DrawFn) -> Interruption:
    seconds = draw(st.sampled_from([0.0, 1.0, 3600.0, 86400.0, -2.0, -3600.0, -86400.0]))
    return Interruption(
        seconds,
        seconds > 0.0 and draw(st.booleans()),
        draw(st.sampled_from(["goes on", "counts", "begins again"])),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.sampled_from([0, 0, 3, 40])),
    )


def continued(chain: Chain, blocks: list[Block], moment: int, what: Interruption) -> Iterator[Block]:
    """Let ``what`` happen to a chain at ``moment``; yield each of the later blocks once it was taken."""
    if what.silent and not what.monitor:
        chain.silence(what.seconds)
    if what.estimator:
        chain.estimator = Chain().estimator
    if what.monitor:
        chain.restart_monitor()
    for number, block in enumerate(blocks[moment:]):
        later = what.later(block, moment)
        chain.take(later)
        if number < what.rivals:
            chain.take(replace(foreign()[number], stamp=later.stamp + 3_000_000))
        yield later


def episodes(events: list[Event]) -> list[list[str]]:
    """Return what was judged of the valve: name, cause and worst severity of each, and whether it is over."""
    found: list[list[str]] = []
    going_on: dict[tuple[str, str], list[str]] = {}
    for one in events:
        if one.kind in OWN:
            continue
        name = (one.kind, one.source)
        if one.state is EventState.CLEARED:
            going_on.pop(name)[-1] = "over"
            continue
        if name not in going_on:
            going_on[name] = [*name, "", "", "goes on"]
            found.append(going_on[name])
        going_on[name][2:4] = [one.cause, one.severity.name]
    return found


def alarms(chain: Chain) -> list[tuple[object, ...]]:
    return [
        (one.name, one.active, one.latched, one.acknowledged, one.severity, one.cause)
        for one in chain.state.alarms.alarms.values()
        if one.kind not in OWN
    ]


def healthy(chain: Chain) -> dict[str, HealthyValue]:
    """Return what is known of the healthy valve."""
    records = chain.state.baseline.records
    assert len(records) < 2
    return {value.name: value for record in records for value in record.values}


def follow(plot: str, moment: int, what: Interruption) -> tuple[Chain, dict[str, HealthyValue]]:
    """Return the chain at the end of an interrupted story, and what it knew of the healthy valve before."""
    chain = told(plot).until(moment)
    known = healthy(chain)
    with TemporaryDirectory() as folder:
        chain.keep_in(Path(folder))
        for _ in continued(chain, told(plot).blocks, moment, what):
            pass
        chain.state.close()
    return chain, known


@pytest.mark.parametrize("plot", FAULTS)
@FEW
@given(place=st.integers(0, 999), what=interruptions())
@example(place=500, what=Interruption(3600.0))
@example(place=500, what=Interruption(86400.0, silent=False))
def test_an_interruption_changes_no_judgement(plot: str, place: int, what: Interruption) -> None:
    uninterrupted = told(plot).copies[-1]
    moment = LEARNED + place * (len(told(plot).blocks) - LEARNED) // 1000
    chain, known = follow(plot, moment, what)
    assert episodes(chain.events) == episodes(uninterrupted.events)
    assert alarms(chain) == alarms(uninterrupted)
    assert not [one for one in chain.events if one.cause == "not_judged"]
    assert len(known) > 4
    assert {name: repr(value) for name, value in healthy(chain).items() if name in known} == {
        name: repr(value) for name, value in known.items()
    }


@FEW
@given(moment=st.integers(0, LEARNED), what=interruptions())
@example(moment=5, what=Interruption(1.0, sequence="counts"))
def test_what_is_healthy_is_learned_after_an_interruption(moment: int, what: Interruption) -> None:
    chain, _ = follow("healthy", moment, what)
    assert episodes(chain.events) == []
    assert not [one for one in chain.events if one.cause == "not_judged"]
    expected, found = healthy(told("healthy").copies[-1]), healthy(chain)
    assert found.keys() == expected.keys()
    for name, value in found.items():
        uninterrupted = expected[name]
        # A mean of a few windows is no more exact than the baseline states.
        deviation = math.hypot(value.standard_deviation, uninterrupted.standard_deviation)
        limit = max(0.01 * abs(uninterrupted.value) + 0.005, 2.0 * deviation)
        assert abs(value.value - uninterrupted.value) < limit, name


@FEW
@given(before=st.floats(5.0, 60.0), after=st.floats(5.0, 60.0), monitor=st.booleans(), late=st.integers(0, 9))
@example(before=20.0, after=45.0, monitor=True, late=0)
@example(before=20.0, after=25.0, monitor=True, late=5)
@example(before=8.2, after=60.0, monitor=False, late=6)
def test_a_healthy_valve_whose_oil_changed_in_a_pause_is_not_worn(
    before: float, after: float, monitor: bool, late: int
) -> None:
    blocks = simulated(Plot(200, oil=(100, before, after)))
    chain = Chain(estimator=Estimator(settings_for(VALVE)), celsius=before)
    for block in blocks[:100]:
        chain.take(block)
    assert healthy(chain)
    pause = Interruption(43_200.0, sequence="counts", monitor=monitor)
    with TemporaryDirectory() as folder:
        chain.keep_in(Path(folder))
        chain.celsius = after
        for _ in continued(chain, blocks, 100, replace(pause, seconds=pause.seconds + 0.1 * late)):
            pass
        chain.state.close()
    assert episodes(chain.events) == []


def silent(moment: int, blocks: int) -> Chain:
    """Return the chain of a worn valve whose thermometer is silent for some blocks after a pause."""
    story, pause = told("worn"), Interruption(3600.0, sequence="counts")
    chain = story.until(moment)
    with TemporaryDirectory() as folder:
        chain.keep_in(Path(folder))
        chain.celsius = math.nan
        for number, _ in enumerate(continued(chain, story.blocks, moment, pause), 1):
            chain.celsius = VALVE.oil_temperature if number >= blocks else math.nan
        chain.state.close()
    return chain


@FEW
@given(moment=st.integers(LEARNED, 150), blocks=st.integers(1, 50))
def test_wear_is_found_once_a_thermometer_sends_again(moment: int, blocks: int) -> None:
    assert episodes(silent(moment, blocks).events) == episodes(told("worn").copies[-1].events)


def test_wear_is_found_or_not_judged_where_a_thermometer_sends_no_more() -> None:
    chain = silent(75, 1000)
    found = episodes(chain.events) == episodes(told("worn").copies[-1].events)
    drifts = [event for event in chain.events if event.kind == "friction_drift"]
    assert {event.facts.note for event in drifts if event.state is EventState.RAISED} <= {
        "oil_temperature_unknown"
    }
    assert found or chain.monitor.detection.judgements["friction_drift"] is Judgement.NOT_JUDGED


@FEW
@given(place=st.integers(0, 999), what=interruptions())
@example(place=463, what=Interruption(-2.0, silent=False))
@example(place=257, what=Interruption(3600.0))
def test_no_time_passes_for_a_drift_test_while_nothing_comes(place: int, what: Interruption) -> None:
    story = told("contaminated and cleaned")
    moment = place * len(story.blocks) // 1000
    if what.seconds > 0.0:
        what = Interruption(what.seconds, what.silent, "counts")
        exact = slice(None)
    else:  # a clock that is set costs a block: not one in which an estimate falls due, but some delay
        what, moment = Interruption(what.seconds, False), moment - bool(story.estimates[moment])
        exact = slice(-1)
    monitor = story.until(moment).monitor
    expected = zip(story.blocks, story.estimates, story.drifts, strict=True)
    for block, estimates, drifts in list(expected)[moment:]:
        monitor.update(what.later(block, moment))
        for one in estimates:
            monitor.update_estimate(replace(one, stamp=one.stamp + round(what.seconds * SECOND)))
        assert drifted(monitor)[exact] == pytest.approx(drifts[exact], abs=1e-9 * STEP * CAP)


@FEW
@given(place=st.integers(0, 999), full=st.integers(1, 150), restart=st.booleans())
def test_a_disk_that_was_full_loses_nothing_or_says_so(place: int, full: int, restart: bool) -> None:
    """The monitor is restarted at the end, and maybe while the disk is full."""
    story = told("a dead accelerometer")
    moment = LEARNED + place * (len(story.blocks) - LEARNED) // 1000
    chain, no_space = story.until(moment), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with TemporaryDirectory() as folder:
        chain.keep_in(Path(folder))
        for number, block in enumerate(story.blocks[moment:]):
            write = mock.patch.object(StateTable, "write", side_effect=no_space)
            with write if number < full else nullcontext():
                chain.take(block)
                chain.state.retry(block.stamp)
                if restart and number == full - 1:
                    chain.restart_monitor()
        written = chain.state.writable and not restart
        chain.restart_monitor()
        chain.state.close()
    said = any("No space left on device" in line and "lost at a restart" in line for line in chain.warnings)
    kept = (
        alarms(chain) == alarms(story.copies[-1]),
        healthy(chain).keys() == healthy(story.copies[-1]).keys(),
    )
    assert all(kept) or (said and not written)
    # It is tried again every 10 s.
    assert written or restart or len(story.blocks) - moment < full + 110


@FEW
@given(blocks=st.integers(1, 40), what=interruptions())
@example(blocks=20, what=Interruption(3600.0))
def test_a_doubt_lasts_until_the_estimator_has_forgotten(blocks: int, what: Interruption) -> None:
    """The accelerometer lives again; for a while the estimates may still hold what it showed before."""
    story = told("a dead accelerometer")
    moment = max(number for number, doubt in enumerate(story.doubts) if doubt) - blocks
    chain = story.until(moment)
    what = Interruption(what.seconds, what.silent)
    doubted = sum(
        chain.monitor.detection.distrust != "" for _ in continued(chain, story.blocks, moment, what)
    )
    assert doubted in (blocks + 1, blocks + 2)  # one block is refused where the stamps jump


@settings(max_examples=FEW.max_examples)
@given(place=st.integers(0, 60), seconds=st.sampled_from([1.0, 3600.0, 86400.0, -3600.0]))
def test_no_time_passes_for_an_outlook_while_nothing_comes(place: int, seconds: float) -> None:
    usual, interrupted, began = Outlook(), Outlook(), told("healthy").blocks[0].stamp
    for second in range(60):
        usual.take(began, began + second * SECOND, 0.01 * second)
        if second == place:
            interrupted.paused += round(seconds * SECOND)
        ahead = round(seconds * SECOND) if second >= place else 0
        interrupted.take(began, began + second * SECOND + ahead, 0.01 * second)
    assert interrupted.seconds_to(1.0, 4.0) == pytest.approx(usual.seconds_to(1.0, 4.0), rel=1e-12)
    assert 30.0 < usual.seconds_to(1.0, 4.0) < 50.0


#: What a finding says: severity that is indicated, and whether it counts as released.
FINDINGS = st.sampled_from(
    [
        (None, True),
        (None, False),
        (Severity.WARNING, False),
        (Severity.WARNING, False),
        (Severity.ALARM, False),
    ]
)


@settings(max_examples=10 * FEW.max_examples)
@given(
    course=st.lists(FINDINGS, min_size=2, max_size=20),
    place=st.integers(1, 19),
    seconds=st.sampled_from([1.0, 3600.0, 86400.0, -3600.0]),
)
@example(course=[(Severity.WARNING, False)] * 2, place=1, seconds=3600.0)
@example(course=[(Severity.WARNING, False)] * 4, place=3, seconds=-3600.0)
def test_no_delay_passes_while_nothing_comes(
    course: list[tuple[Severity | None, bool]], place: int, seconds: float
) -> None:
    usual, interrupted = (Condition(event_kind("resonance"), 1.0, 2.0) for _ in range(2))
    for number, what in enumerate(course):
        ahead = round(seconds * SECOND) if number >= place else 0
        if number == place:
            interrupted.pause(ahead)
        both = [
            one.judge(Finding((number + 1) * SECOND // 2 + later, *what, "", Quantity("amplification", "1")))
            for one, later in ((usual, 0), (interrupted, ahead))
        ]
        assert [(one.state, one.severity) for one in both[0]] == [
            (one.state, one.severity) for one in both[1]
        ]


#: What can be interrupted, and how.
ACTS = {
    "thermometer": ("silent", "wrong", "stands"),
    "estimator": ("restarted", "silent", "of another valve"),
    "second estimator": ("of the valve", "of another valve", "played from a record"),
    "description": ("of another valve",),
    "source": ("paused", "restarted", "clock set", "a second one"),
    "monitor": ("restarted", "inactive"),
}
OTHER = find_valve("4weh10_stiff")
#: Blocks of the story of a worn valve within which interruptions begin, and that follow at least.
BEGINS, FOLLOWS = (LEARNED, 165), 200


@dataclass(frozen=True)
class Act:
    """One interruption: of what, how, from which block on, for how many, and by how much the stamps jump."""

    what: str
    how: str
    begins: int
    blocks: int
    seconds: float

    @property
    def ends(self) -> int:
        return self.begins + self.blocks


@st.composite
def acts(draw: st.DrawFn) -> list[Act]:
    """Return interruptions, those of one kind one after the other."""
    found: list[Act] = []
    for _ in range(draw(st.integers(1, 4))):
        what = draw(st.sampled_from(sorted(ACTS)))
        act = Act(
            what,
            draw(st.sampled_from(ACTS[what])),
            draw(st.integers(*BEGINS)),
            draw(st.sampled_from([1, 10, 30, 60])),
            draw(st.sampled_from([1.0, 60.0, 3600.0, 86400.0])),
        )
        if all(one.what != what or one.ends < act.begins or act.ends < one.begins for one in found):
            found.append(act)
    return sorted(found, key=lambda one: one.begins)


class Plant:
    """A chain and what happens to it; nodes take descriptions as here."""

    def __init__(self, chain: Chain, folder: Path) -> None:
        self.chain = chain
        chain.keep_in(folder)
        self.shift = self.first = 0
        self.second: Estimator | None = None
        self.silent = self.inactive = self.rival = False
        self.named, self.second_named = VALVE, VALVE
        self.lag = 0
        self.descriptions = Descriptions[Valve]()
        self.describe(VALVE)

    def take(self, block: Block) -> None:
        chain = self.chain
        sent = replace(block, stamp=block.stamp + self.shift, sequence=block.sequence - self.first)
        if block.sequence % 10 == 0 and math.isfinite(chain.celsius):
            chain.estimator.update_temperature(sent.stamp, chain.celsius)
        both = [(one, self.named.id) for one in chain.estimator.update(sent)]
        if self.second is not None:
            for one in self.second.update(block):
                later = replace(one, stamp=one.stamp + self.shift + self.lag)
                both.append((later, self.second_named.id))
        if self.rival:
            chain.estimator.update(replace(foreign()[block.sequence % 60], stamp=sent.stamp + 3_000_000))
        if self.inactive:
            return
        chain.tell(chain.monitor.update(sent))
        if self.rival:
            chain.tell(
                chain.monitor.update(replace(foreign()[block.sequence % 60], stamp=sent.stamp + 3_000_000))
            )
        for one, name in both:
            if name != self.named.id or not self.silent:
                self.hear(replace(one, source=name))

    def hear(self, estimate: Estimate) -> None:
        chain = self.chain
        chain.tell(chain.monitor.update_estimate(estimate))
        if chain.monitor.estimate is not estimate:
            return
        self.identify(self.descriptions.follow(chain.monitor.estimates))
        if chain.state.baseline.update(estimate):
            chain.state.keep_baseline()

    def describe(self, valve: Valve) -> None:
        self.identify(self.descriptions.take(valve.id, valve, self.chain.monitor.estimates.last))

    def identify(self, valve: Valve | None) -> None:
        if valve is not None:
            with suppress(InputError):  # no baseline of it is kept
                self.chain.state.baseline.identify(valve.id, valve.oil)

    def begin(self, act: Act) -> None:
        chain, ahead = self.chain, round(act.seconds * SECOND)
        match act.what, act.how:
            case "thermometer", how:
                chain.celsius = {"silent": math.nan, "wrong": 85.0, "stands": chain.celsius}[how]
            case "estimator", "silent":
                self.silent = True
            case "estimator", how:
                self.named = VALVE if how == "restarted" else OTHER
                chain.estimator = Estimator(settings_for(self.named, period=0.5, memory=2.0))
                self.describe(self.named)
            case "second estimator", how:
                self.second_named = OTHER if how == "of another valve" else VALVE
                self.lag = -30 * 86_400 * SECOND if how == "played from a record" else 0
                self.second = Estimator(settings_for(self.second_named, period=0.5, memory=2.0))
                self.describe(self.second_named)
            case "description", _:
                self.describe(OTHER)
            case "source", "a second one":
                self.rival = True
            case "source", "clock set":
                self.shift -= ahead
            case "source", how:
                self.shift += ahead
                chain.silence(act.seconds)
                self.first = act.begins if how == "restarted" else self.first - ahead // STEP
            case "monitor", "restarted":
                chain.restart_monitor()
                self.descriptions = Descriptions()
                self.describe(self.named)
            case "monitor", _:
                self.inactive = True

    def end(self, act: Act) -> None:
        chain = self.chain
        match act.what, act.how:
            case "thermometer", _:
                chain.celsius = VALVE.oil_temperature
            case "estimator", "silent":
                self.silent = False
            case "estimator", "of another valve":
                self.named = VALVE
                chain.estimator = Estimator(settings_for(VALVE, period=0.5, memory=2.0))
                self.describe(VALVE)
            case "second estimator", _:
                self.second = None
            case "description", _:
                self.describe(VALVE)
            case "source", "a second one":
                self.rival = False
            case "monitor", "inactive":
                self.inactive = False
                chain.monitor.gate.resume()
                chain.monitor.estimates.resume()


def ended(happened: list[Act], *, sound: bool) -> Chain:
    """Return the chain of a worn valve after what ``happened``; ``sound``: the thermometer is, at the end."""
    story = told("worn")
    begin = happened[0].begins
    with TemporaryDirectory() as folder:
        plant = Plant(story.until(begin), Path(folder))
        for block in worn()[begin:]:
            number = block.sequence
            for act in happened:
                if act.begins == number:
                    plant.begin(act)
                if act.ends == number and (sound or act.what != "thermometer"):
                    plant.end(act)
            plant.take(block)
        plant.chain.state.close()
    return plant.chain


@cache
def worn() -> list[Block]:
    """Return the blocks of the worn valve, for longer than its story is."""
    return simulated(replace(FAULTS["worn"], blocks=BEGINS[1] + 60 + FOLLOWS))


@settings(max_examples=8 if settings().derandomize else 1000, phases=(Phase.explicit, Phase.generate))
@given(happened=acts(), sound=st.booleans())
def test_no_interruption_ends_in_ok_without_judgement(happened: list[Act], sound: bool) -> None:
    """The wear is found, or the monitor reports that the drag is not judged; the baseline is kept."""
    chain = ended(happened, sound=sound)
    health, monitor = chain.monitor.health, chain.monitor
    current = chain.state.baseline.current
    assert current is not None
    assert (current.version, current.valve_id) == (1, VALVE.id)
    found = monitor.detection.conditions[f"friction_drift/{VISCOUS}"].active is not None
    drag = dict(health.judgements)["friction_drift/viscous_coefficient"]
    hot = any((one.what, one.how) == ("thermometer", "wrong") for one in happened)
    unfit = not sound and any(one.what == "thermometer" for one in happened)
    # Behind a thermometer that jumps the limit may lie beyond the wear that is seen.
    test = monitor.detection.parameters[VISCOUS]
    wide = hot and test.sum.allowance > abs(test.share)
    assert found or (unfit and drag is Judgement.NOT_JUDGED) or wide
    said = "drag not judged" in health.summary or "drag judged with a wider limit" in health.summary
    assert found or health.level is not HealthLevel.OK or said
    for name, judgement in health.judgements:
        if "/" in name and health.level is HealthLevel.OK:
            assert judgement is Judgement.JUDGED or "not judged" in health.summary, name
