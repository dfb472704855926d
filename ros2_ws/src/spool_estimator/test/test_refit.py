from __future__ import annotations

import math
import os
import pickle
import signal
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.refit import (
    Refit,
    RefitSettings,
    RefitState,
    RefitWorker,
    WindowRefits,
    WindowTask,
    refit,
)
from spool_sim.excitation import PRESETS, Part, Standstill
from spool_sim.excitation import Sequence as Parts
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
SETTINGS = RefitSettings(VALVE, MODELS["coulomb"], period=3.0)


@lru_cache(maxsize=1)
def record() -> tuple[Block, ...]:
    """Return 12 s of a valve with dry friction."""
    noisy = Sensor(noise=0.03)
    source = Simulator(
        VALVE, PRESETS["multisine"], coulomb_force=0.3, seed=2, body_sensor=noisy, spool_sensor=noisy
    )
    return tuple(source.records(12.0))


def tasks_of(blocks: Iterable[Block], settings: RefitSettings = SETTINGS) -> list[WindowTask]:
    estimator, windows = Estimator(settings_for(VALVE)), WindowRefits(settings)
    judged = ((block, estimator.gate.judge(block)) for block in blocks)
    return [
        task
        for block, verdict in judged
        for task in windows.update(block, verdict, estimator.update(block, verdict))
    ]


def same(one: Sequence[WindowTask], other: Sequence[WindowTask]) -> None:
    assert len(one) == len(other)
    for left, right in zip(one, other, strict=True):
        assert (left.stamp, left.start, left.idle) == (right.stamp, right.start, right.idle)
        assert left.record.start == right.record.start
        np.testing.assert_array_equal(left.record.body, right.record.body)
        np.testing.assert_array_equal(left.record.spool, right.record.spool)


def joined(blocks: Sequence[Block]) -> Block:
    first = blocks[0]
    return replace(
        first,
        body=np.concatenate([block.body for block in blocks]),
        spool=np.concatenate([block.spool for block in blocks]),
    )


def test_windows_end_at_multiples_of_the_period_once_they_are_full() -> None:
    tasks = tasks_of(record())
    ends = [round((task.stamp - record()[0].stamp) * 1e-9, 3) for task in tasks]
    assert ends == pytest.approx([6.0, 9.0, 12.0], abs=1e-3)
    samples = np.concatenate([block.spool for block in record()]).astype(float)
    for task, stop in zip(tasks, (12_000, 18_000, 24_000), strict=True):
        np.testing.assert_array_equal(task.record.spool, samples[stop - 8000 : stop])


@pytest.mark.parametrize("size", [7, 20])
def test_how_the_stream_is_split_changes_no_window(size: int) -> None:
    blocks = record()
    again = [replace(joined(blocks[n : n + size]), sequence=n // size) for n in range(0, len(blocks), size)]
    same(tasks_of(blocks), tasks_of(again))


def test_the_recursion_gives_the_start() -> None:
    for task in tasks_of(record()):
        assert task.start["spring_stiffness"] == pytest.approx(VALVE.spring_stiffness, rel=0.02)
        assert set(task.start) == {"spring_stiffness", "viscous_coefficient", "coulomb_force"}


def test_a_window_starts_from_the_newest_estimate_of_its_samples() -> None:
    """Others are older, or come from later samples of the same block."""
    estimator, windows = Estimator(settings_for(VALVE, period=0.1)), WindowRefits(SETTINGS)
    estimates: list[Estimate] = []
    starts: list[float] = []
    for number, first in enumerate(range(0, 500, 14)):
        block = replace(joined(record()[first : first + 14]), sequence=number)
        verdict = estimator.gate.judge(block)
        estimates += (found := estimator.update(block, verdict))
        for task in windows.update(block, verdict, found):
            (own,) = [one for one in estimates if abs(one.stamp - task.stamp) < 1000]
            assert own.stamp < found[-1].stamp
            assert task.start == {one.name: one.value for one in own.parameters}
            starts.append(task.start["spring_stiffness"])
    assert len(set(starts)) == 2


def test_a_refit_finds_the_truth_within_its_own_uncertainty() -> None:
    found = refit(tasks_of(record())[-1])
    assert found.state is RefitState.CONVERGED
    truth = {
        "spring_stiffness": VALVE.spring_stiffness,
        "viscous_coefficient": VALVE.viscous_coefficient,
        "coulomb_force": 0.3,
    }
    quantities = {quantity.name: quantity for quantity in found.parameters}
    for name, value in truth.items():
        assert abs(quantities[name].value - value) < 4.0 * quantities[name].standard_deviation
        assert quantities[name].standard_deviation < 0.02 * value
    assert quantities["mass"].validity is Validity.HELD
    matrix = np.reshape(found.correlations, (len(found.fitted),) * 2)
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    assert found.nrmse.value < 0.1
    assert found.amplitude_ratio.value == pytest.approx(1.0, abs=0.02)
    assert found.objective.value > 0.0


def test_a_gap_begins_the_window_anew() -> None:
    blocks = record()
    ends = [task.stamp for task in tasks_of([*blocks[:250], *blocks[260:]])]
    # 5.2 s on, nothing before 6 s after it.
    assert [round((end - blocks[260].stamp) * 1e-9) for end in ends] == [6]


def test_a_standstill_is_a_result_with_a_reason() -> None:
    excitation = Parts(
        parts=(
            Part(excitation=PRESETS["multisine"], duration=5.0),
            Part(excitation=Standstill(), duration=8.0),
        )
    )
    still = list(Simulator(VALVE, excitation, coulomb_force=0.3).records(12.0))
    found = refit(tasks_of(still)[-1])
    assert found.state is RefitState.FAILED
    assert (
        found.reason == f"nothing to fit: the recursion is {State.NOT_EXCITED.name.lower().replace('_', ' ')}"
    )
    assert found.parameters == ()


@pytest.mark.parametrize("value", [0.0, 1e30, 1e-40])
def test_whatever_is_in_the_window_is_a_result_with_a_reason(value: float) -> None:
    task = tasks_of(record())[0]
    senseless = replace(task, record=replace(task.record, spool=np.full(task.record.spool.size, value)))
    found = refit(senseless)
    assert found.state in (RefitState.FAILED, RefitState.NOT_CONVERGED)
    assert found.reason


def test_memory_holds_one_window() -> None:
    windows = WindowRefits(SETTINGS)
    sizes = []
    for block in record():
        windows.update(block, Verdict.CONTINUES, ())
        sizes.append(len(pickle.dumps(windows)))
    assert max(sizes[300:]) < 1.05 * sizes[250]


def test_memory_holds_one_window_however_often_blocks_are_lost() -> None:
    windows, gate = WindowRefits(SETTINGS), BlockGate()
    sizes = []
    for block in record():
        if block.sequence % 100 >= 50:
            windows.update(block, gate.judge(block), ())
        if block.sequence % 100 == 99:
            sizes.append(len(pickle.dumps(windows)))
    assert max(sizes[2:]) < 1.05 * sizes[1]


@pytest.mark.slow
def test_the_process_gives_the_same_bits_skips_what_comes_too_soon_and_survives_its_death() -> None:
    tasks = tasks_of(record())
    worker = RefitWorker(SETTINGS)
    try:
        assert worker.collect() is None
        worker.wait(180.0)
        assert worker.offer(tasks[0])
        assert not worker.offer(tasks[1])
        worker.wait(180.0)
        assert repr(worker.collect()) == repr(refit(tasks[0]))
        assert (worker.done, worker.skipped) == (1, 1)
        assert worker.offer(tasks[1])
        assert worker.process is not None
        os.kill(worker.process, signal.SIGKILL)
        worker.wait(180.0)
        broken = worker.collect()
        assert broken is not None
        assert broken.state is RefitState.FAILED
        assert "killed" in broken.reason
        assert worker.offer(tasks[2])
        worker.wait(180.0)
        assert repr(worker.collect()) == repr(refit(tasks[2]))
    finally:
        worker.close()


def test_an_empty_refit_claims_nothing() -> None:
    empty = Refit(1, "coulomb", RefitState.FAILED, "", 0, 4.0)
    for quantity in (empty.objective, empty.amplitude_ratio, empty.nrmse):
        assert math.isnan(quantity.value)
        assert quantity.validity is Validity.UNKNOWN
