"""After an interruption the estimator holds what it knows until it follows the valve again."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.events.event import EventState
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.gap_watch import LEARNED, GapWatch
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
DRY = 0.1
TRUTH = {
    "spring_stiffness": VALVE.spring_stiffness,
    "viscous_coefficient": VALVE.viscous_coefficient,
    "coulomb_force": DRY,
}
SECOND = 1_000_000_000
#: Blocks of 0.1 s.
RATE, SIZE, STEP = 500.0, 50, SECOND // 10
#: Few examples as a rule, many where new ones are searched for. A smaller one would not be clearer.
FEW = settings(max_examples=8 if settings().derandomize else 300, phases=(Phase.explicit, Phase.generate))
#: s by which stamps jump: a pause, or a clock that is set.
JUMPS = st.sampled_from([0.0, 1.0, 3600.0, 86400.0, -2.0, -3600.0, -86400.0])


def simulator(valve: str = VALVE.id, seed: int = 5) -> Simulator:
    noisy = Sensor(noise=0.03)
    return Simulator(
        find_valve(valve), PRESETS["multisine"], coulomb_force=DRY, seed=seed, sample_rate=RATE,
        block_size=SIZE, body_sensor=noisy, spool_sensor=noisy,
    )  # fmt: skip


@dataclass(frozen=True)
class Stream:
    """Blocks of 14 s, and the estimator before each of those of the first 6 s."""

    blocks: list[Block]
    estimators: list[Estimator]
    estimates: list[Estimate]


@cache
def healthy() -> Stream:
    blocks = list(simulator().records(14.0))
    estimator = Estimator(settings_for(VALVE, period=0.2, memory=2.0))
    estimators, estimates = [], []
    for number, block in enumerate(blocks):
        if number < 60:
            estimators.append(copy.deepcopy(estimator))
        estimates += estimator.update(block)
    return Stream(blocks, estimators, estimates)


@cache
def foreign() -> list[Block]:
    """Return what a second source sends: another valve."""
    return list(simulator("4weh10_stiff", seed=9).records(5.0))


@dataclass(frozen=True)
class Interruption:
    """What happens between two blocks.

    Attributes:
        seconds: by which the later stamps are ahead; negative for a clock that was set back.
        sequence: of the later blocks: goes on, counts the time, or begins again with the source.
        lost: blocks that never come.
        rivals: blocks of a second source that come between the next ones.

    """

    seconds: float = 0.0
    sequence: str = "goes on"
    lost: int = 0
    rivals: int = 0

    def later(self, blocks: list[Block], moment: int) -> Iterator[Block]:
        """Yield what comes from ``moment`` on."""
        counted = max(0, round(self.seconds * SECOND / STEP)) if self.sequence == "counts" else 0
        first = moment if self.sequence == "begins again" else 0
        for number, block in enumerate(blocks[moment + self.lost :]):
            stamp = block.stamp + round(self.seconds * SECOND)
            yield replace(block, stamp=stamp, sequence=block.sequence - first + counted)
            if number < self.rivals:
                yield replace(foreign()[number], stamp=stamp + 3_000_000)


INTERRUPTIONS = st.builds(
    Interruption,
    JUMPS,
    st.sampled_from(["goes on", "counts", "begins again"]),
    st.integers(0, 10),
    st.sampled_from([0, 3, 40]),
)


def check(estimate: Estimate) -> None:
    """Make sure that the parameters are known, and right."""
    for name, true in TRUTH.items():
        found = estimate.parameter(name)
        assert found.known
        assert abs(found.value - true) < 0.01 * true + 5.0 * found.standard_deviation, name


@FEW
@given(moment=st.integers(30, 59), what=INTERRUPTIONS)
def test_no_interruption_makes_it_forget_or_err(moment: int, what: Interruption) -> None:
    estimator = copy.deepcopy(healthy().estimators[moment])
    estimates = [one for block in what.later(healthy().blocks, moment) for one in estimator.update(block)]
    assert estimates[-1].state is State.TRACKING
    for estimate in estimates:
        assert estimate.state in (State.TRACKING, State.SETTLING)
        check(estimate)


@FEW
@given(moment=st.integers(30, 59), what=INTERRUPTIONS, after=st.integers(1, 20), blocks=st.integers(3, 20))
@example(moment=56, what=Interruption(-86400.0, lost=1), after=11, blocks=19)
def test_what_stands_still_after_an_interruption_makes_it_forget_nothing(
    moment: int, what: Interruption, after: int, blocks: int
) -> None:
    estimator = copy.deepcopy(healthy().estimators[moment])
    for number, block in enumerate(replace(what, rivals=0).later(healthy().blocks, moment)):
        stands = after <= number < after + blocks
        body = np.full_like(block.body, healthy().blocks[0].body[0]) if stands else block.body
        for estimate in estimator.update(replace(block, body=body)):
            check(estimate)


CELSIUS = st.floats(5.0, 60.0)


@FEW
@given(before=CELSIUS, after=CELSIUS, late=st.integers(0, 20), memory=st.sampled_from([2.0, 4.0]))
@example(before=20.0, after=45.0, late=0, memory=4.0)
@example(before=20.0, after=25.0, late=5, memory=4.0)
def test_the_drag_is_referred_to_oil_that_cooled_or_warmed_in_a_pause(
    before: float, after: float, late: int, memory: float
) -> None:
    """The thermometer sends each second, and again ``late`` blocks after the pause."""
    machine, estimator = simulator(), Estimator(settings_for(VALVE, period=0.5, memory=memory))
    errors: list[float] = []
    for celsius, pause, silent in ((before, 0, 0), (after, 43_200 * SECOND, late)):
        machine.set_drift("oil_temperature", celsius)
        errors.clear()
        for number, block in enumerate(machine.records(8.0)):
            later = replace(block, stamp=block.stamp + pause)
            if number >= silent and (number - silent) % 10 == 0:
                estimator.update_temperature(later.stamp, celsius)
            for estimate in estimator.update(later):
                drag = estimate.referred_viscous_coefficient
                if estimate.state is State.TRACKING and drag.validity is Validity.VALID:
                    errors.append(abs(drag.value / VALVE.viscous_coefficient - 1.0))
    # A fit to the first samples may be on its way for a second; what is wrong for 3 s can make an event.
    assert sum(error > 0.05 for error in errors) < 3
    assert drag.value == pytest.approx(VALVE.viscous_coefficient, rel=0.01)


@FEW
@given(before=st.integers(1, 15), jump=JUMPS)
@example(before=3, jump=3600.0)
@example(before=3, jump=-3600.0)
def test_no_time_passes_for_a_gap_of_the_model_in_a_pause(before: int, jump: float) -> None:
    """The residual is up from some estimate on; a gap opens once it stayed up for some memories."""
    watch, seconds = GapWatch(), 0.0
    tracked = [estimate for estimate in healthy().estimates if estimate.state is State.TRACKING]
    sequence = iter(healthy().blocks)
    opened: list[int] = []
    for number, estimate in enumerate(tracked):
        if number == LEARNED + before:
            seconds = jump
        for block in sequence:
            watch.take(replace(block, stamp=block.stamp + round(seconds * SECOND)))
            if block.end > estimate.stamp:
                break
        up = replace(
            estimate,
            stamp=estimate.stamp + round(seconds * SECOND),
            residual=replace(estimate.residual, value=0.3),
            residual_force=replace(estimate.residual_force, value=3.0),
        )
        event = watch.update(up if number >= LEARNED else estimate)
        if event is not None:
            assert event.state is EventState.RAISED
            opened.append(number - LEARNED)
    # Estimates come each 0.2 s, patience is 5 s; what was up before the pause does not count.
    assert opened == [25 if jump == 0.0 else before + 25]
