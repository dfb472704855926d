"""When the model gap counts as open, and what an analysis beside a stream looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spool_estimator.estimate import Estimate, State
from spool_estimator.gap_watch import LEARNED, GapWatch
from spool_estimator.gap_worker import RecentBlocks
from spool_stream.block import Block
from spool_stream.quantity import Quantity, Validity


def estimate(residual: float, state: State = State.TRACKING) -> Estimate:
    def unknown(name: str) -> Quantity:
        return Quantity(name, "1")

    return Estimate(
        0, "coulomb", state, 0, 0, 0.0, 4.0, (), unknown("natural_frequency"), unknown("damping_ratio"),
        Quantity("residual", "1", residual, validity=Validity.VALID), unknown("excitation"),
        unknown("relative_displacement"),
    )  # fmt: skip


def taught(level: float = 0.02) -> GapWatch:
    watch = GapWatch()
    generator = np.random.default_rng(0)
    for _ in range(LEARNED):
        assert watch.update(estimate(level * (1.0 + 0.02 * generator.normal()))) is None
    return watch


def test_noise_about_the_floor_opens_nothing() -> None:
    watch = taught()
    generator = np.random.default_rng(1)
    assert not any(watch.update(estimate(0.02 * (1.0 + 0.05 * generator.normal()))) for _ in range(2000))


def test_a_residual_that_stays_up_opens_the_gap_once_and_closes_it_once() -> None:
    watch = taught()
    changes = [watch.update(estimate(0.06)) for _ in range(10)]
    changes += [watch.update(estimate(0.02)) for _ in range(10)]
    found = [change for change in changes if change is not None]
    assert [change.raised for change in found] == [True, False]
    assert "6 % of the force unexplained" in found[0].sentence
    assert found[0].residual.value == 0.06


def test_a_single_outlier_opens_nothing() -> None:
    watch = taught()
    assert not any(watch.update(estimate(value)) for value in (0.2, 0.02, 0.02, 0.2, 0.2, 0.02))


@pytest.mark.parametrize("state", [state for state in State if state is not State.TRACKING])
def test_what_is_not_tracked_says_nothing(state: State) -> None:
    watch = taught()
    assert not any(watch.update(estimate(0.5, state)) for _ in range(20))
    fresh = GapWatch()
    for _ in range(2 * LEARNED):
        fresh.update(replace(estimate(0.5), state=state))
    assert fresh.floor is None


def test_only_the_last_seconds_are_kept_and_a_gap_splits_them() -> None:
    recent = RecentBlocks(3.0)
    row = np.ones(100, dtype=np.float32)
    for number in range(100):
        stamp = round((number + (5 if number > 90 else 0)) * 0.1e9)
        recent.take(Block(stamp, number if number <= 90 else number + 5, 1e-3, row, row))
    records = recent.records("valve")
    # Whole runs of a second are forgotten: 3 s are kept before the 0.9 s of the run that is not full.
    assert [record.duration for record in records] == pytest.approx([3.1, 0.9])
    assert [record.first_sample for record in records] == [0, 3600]
    assert recent.stamp == pytest.approx(10.499e9 - 1, abs=2)


def test_thousands_of_blocks_are_held_in_few_pieces_and_jitter_splits_nothing() -> None:
    recent = RecentBlocks(60.0)
    generator = np.random.default_rng(1)
    sent = []
    for number in range(1500):
        row = generator.standard_normal(40).astype(np.float32)
        sent.append(row)
        stamp = 10**18 + number * 20_000_000 + int(generator.integers(-200_000, 200_000))
        recent.take(Block(stamp, number, 5e-4, row, -row))
    (record,) = recent.records("valve")
    np.testing.assert_array_equal(record.body, np.concatenate(sent))
    np.testing.assert_array_equal(record.spool, -record.body)
    assert len(recent._runs) + len(recent._fresh) < 90
