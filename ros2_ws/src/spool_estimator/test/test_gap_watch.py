"""When the model gap counts as open, and what an analysis while a stream is live looks at."""

from __future__ import annotations

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.events.event import Event, EventState, Urgency
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.gap_watch import LEARNED, MATTERS, GapWatch, RecentBlocks
from spool_sim.excitation import MachineOrders
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

SECOND = 1_000_000_000


class Machine:
    """Says estimates, one a second."""

    def __init__(self) -> None:
        self.watch = GapWatch()
        self.time = 0

    def say(
        self, residual: float, *, state: State = State.TRACKING, stiffness: float = 1632.0,
        coulomb: float = 0.05, inertia: float = 0.5,
    ) -> Event | None:  # fmt: skip
        def known(name: str, value: float, deviation: float = 0.0) -> Quantity:
            unit = {"coulomb_force": "N", "spring_stiffness": "N/m"}.get(name, "1")
            return Quantity(name, unit, value, deviation, Validity.VALID)

        parameters = (known("spring_stiffness", stiffness, 0.5), known("coulomb_force", coulomb, 1e-3))
        self.time += SECOND
        return self.watch.update(
            Estimate(
                self.time, "coulomb", state, 0, 0, 0.0, 4.0, parameters, known("natural_frequency", 15.0),
                known("damping_ratio", 0.2), known("residual", residual), known("excitation", 2.0),
                known("relative_displacement", 3e-4),
                residual_force=known("residual_force", residual * inertia),
            )
        )  # fmt: skip


def taught(level: float = 0.02) -> Machine:
    machine = Machine()
    generator = np.random.default_rng(0)
    for _ in range(LEARNED):
        assert machine.say(level * (1.0 + 0.02 * generator.normal())) is None
    return machine


def test_noise_about_the_median_opens_nothing() -> None:
    machine = taught()
    generator = np.random.default_rng(1)
    assert not any(machine.say(0.02 * (1.0 + 0.05 * generator.normal())) for _ in range(2000))


def test_a_sensor_that_is_known_to_be_at_fault_is_no_gap_of_the_model() -> None:
    machine = taught()
    machine.watch.hear("sensor_fault", "spool", raised=True)
    assert not any(machine.say(0.06) for _ in range(60))
    machine.watch.hear("sensor_fault", "spool", raised=False)
    opened = [change for change in (machine.say(0.06) for _ in range(30)) if change is not None]
    assert [event.state for event in opened] == [EventState.RAISED]


def test_a_residual_that_stays_up_opens_the_gap_once_and_closes_it_once() -> None:
    machine = taught()
    changes = [machine.say(0.06) for _ in range(30)]
    changes += [machine.say(0.02) for _ in range(10)]
    found = [change for change in changes if change is not None]
    assert [event.state for event in found] == [EventState.RAISED, EventState.CLEARED]
    opened, closed = found[0].facts, found[1].facts
    assert (opened.parameter, opened.value, opened.urgency) == ("residual", 0.06, Urgency.SOON)
    assert opened.baseline == pytest.approx(0.02, rel=0.05)
    assert MATTERS <= opened.limit < 0.06
    assert (opened.advice, closed.advice) == (500, 0)
    assert (closed.value, closed.began) == (0.02, found[0].stamp)
    assert found[0].quantity.value == 0.06
    # Two and a half memories of 4 s after the first estimate that was up.
    assert found[0].stamp == (LEARNED + 11) * SECOND


def test_what_does_not_last_opens_nothing() -> None:
    machine = taught()
    assert not any(machine.say(value) for value in [0.2, 0.02, 0.02, *[0.2] * 10, 0.02, 0.2])


@pytest.mark.parametrize(
    ("before", "residual", "given"),
    [
        pytest.param(0.02, 0.1, {"inertia": 0.08}, id="a weaker drive leaves more noise over the force"),
        pytest.param(0.02, 0.021, {"inertia": 5.0}, id="a stronger one leaves more force at the same share"),
        pytest.param(0.007, 0.03, {}, id="what worries nobody"),
        pytest.param(0.02, 0.3, {"coulomb": 1.6}, id="a spool that sticks most of the time"),
        pytest.param(0.02, 0.6, {"stiffness": 3e4}, id="channels without a spring, as exchanged ones"),
    ],
)
def test_what_is_no_gap_of_the_model_opens_nothing(
    before: float, residual: float, given: dict[str, float]
) -> None:
    machine = taught(before)
    assert not any(machine.say(residual, **given) for _ in range(60))


def test_noise_alone_opens_nothing_where_warm_oil_lets_the_spool_move() -> None:
    """Thin oil: less inertia force, more motion against the spring, the same noise."""
    valve, noisy = find_valve("4weh10_soft"), Sensor(noise=0.07)
    watch, changes, residuals = GapWatch(), [], []
    for viscous, speed in ((30.0, 2160.0), (3.0, 2460.0)):
        machine = MachineOrders(
            speed_profile=((0.0, speed),), orders=((1.0, 3.5), (2.0, 1.0)), broadband_rms=0.3,
            broadband_high=75.0,
        )  # fmt: skip
        simulator = Simulator(
            valve, machine, parameters={"viscous_coefficient": viscous}, coulomb_force=0.05,
            sample_rate=1250.0, block_size=125, seed=1, body_sensor=noisy, spool_sensor=noisy,
        )  # fmt: skip
        estimator = Estimator(settings_for(valve))
        for block in simulator.records(28.0):
            for estimate in estimator.update(block):
                changes.append(watch.update(estimate))
                residuals.append(estimate.residual.value)
    assert residuals[-1] > watch.limit
    assert not any(changes)


def test_a_parameter_that_the_estimator_follows_opens_nothing() -> None:
    """A spring that softens by one percent a second leaves 5 % over by the estimator's lag of 4 s."""
    machine = taught(0.007)
    assert not any(machine.say(0.05, stiffness=1632.0 * 0.99**second) for second in range(40))
    assert any(machine.say(0.05, stiffness=1092.0) for _ in range(12))


def test_what_was_up_before_a_standstill_stayed_up_no_longer() -> None:
    machine = taught()
    assert not any(machine.say(0.06) for _ in range(8))
    assert not any(machine.say(0.0, state=State.NOT_EXCITED) for _ in range(10))
    assert not any(machine.say(0.06) for _ in range(8))


def test_a_residual_that_still_grows_is_waited_for() -> None:
    machine = taught()
    assert not any(machine.say(0.06 * 1.1**second) for second in range(20))
    assert any(machine.say(0.4) for _ in range(12))


@pytest.mark.parametrize("clips", [True, False])
def test_a_channel_that_clips_is_no_gap_of_the_model(clips: bool) -> None:
    machine = taught()
    time = np.arange(2000) / 2000.0
    wave = 5.0 * np.sin(2.0 * np.pi * 17.3 * time)
    spool = np.clip(wave, -3.0, 3.0) if clips else wave
    rows = (wave.astype(np.float32), spool.astype(np.float32))
    opened = []
    for number in range(20):
        machine.watch.take(Block(machine.time, number, 5e-4, *rows))
        opened.append(machine.say(0.3))
    assert any(opened) != clips


@pytest.mark.parametrize("state", [state for state in State if state is not State.TRACKING])
def test_what_is_not_tracked_says_nothing(state: State) -> None:
    machine = taught()
    assert not any(machine.say(0.5, state=state) for _ in range(20))
    fresh = Machine()
    for _ in range(2 * LEARNED):
        fresh.say(0.5, state=state)
    assert fresh.watch.median is None


def test_only_the_last_seconds_are_kept_and_a_gap_splits_them() -> None:
    recent = RecentBlocks(3.0)
    row = np.ones(100, dtype=np.float32)
    for number in range(100):
        stamp = round((number + (5 if number > 90 else 0)) * 0.1e9)
        verdict = Verdict.RESTARTS if number in (0, 91) else Verdict.CONTINUES
        recent.take(Block(stamp, number if number <= 90 else number + 5, 1e-3, row, row), verdict)
    records = recent.records("valve")
    # Whole runs of a second are forgotten: 3 s are kept before the 0.9 s of the run that is not full.
    assert [record.duration for record in records] == pytest.approx([3.1, 0.9])
    assert [record.first_sample for record in records] == [0, 3600]
    assert recent.stamp == pytest.approx(10.499e9 - 1, abs=2)


def test_thousands_of_blocks_are_held_in_few_pieces_and_jitter_splits_nothing() -> None:
    recent, gate = RecentBlocks(60.0), BlockGate()
    generator = np.random.default_rng(1)
    sent = []
    for number in range(1500):
        row = generator.standard_normal(40).astype(np.float32)
        sent.append(row)
        stamp = 10**18 + number * 20_000_000 + int(generator.integers(-200_000, 200_000))
        block = Block(stamp, number, 5e-4, row, -row)
        recent.take(block, gate.judge(block))
    (record,) = recent.records("valve")
    np.testing.assert_array_equal(record.body, np.concatenate(sent))
    np.testing.assert_array_equal(record.spool, -record.body)
    assert len(recent._runs) + len(recent._fresh) < 90
