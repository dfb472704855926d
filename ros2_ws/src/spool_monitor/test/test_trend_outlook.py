"""Outlook of a stored trend: when wear reaches its limit, and that a healthy valve promises nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from spool_monitor.trend import DAY, HOUR, Span, Sums, TrendStore
from spool_monitor.trend_outlook import outlook, time_to_limit

LIMIT = 1.0


def worn(random: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return wear of each day, and the day on which it reaches 1: steady, in steps, faster or slower."""
    life = random.uniform(60.0, 400.0)
    days = np.arange(int(3.0 * life))
    kind = random.choice(["steady", "steps", "faster", "slower"])
    if kind == "steps":
        count = int(random.integers(5, 15))
        at = np.sort(random.uniform(0.0, 3.0 * life, 3 * count))
        wear = np.searchsorted(at, days) / count
    else:
        power = {"steady": 1.0, "faster": random.uniform(1.5, 3.0), "slower": random.uniform(0.5, 0.8)}[kind]
        wear = (days / life) ** power
    reached = np.flatnonzero(wear >= LIMIT)
    return wear, float(reached[0]) if reached.size else np.inf


def measured(random: np.random.Generator, wear: np.ndarray) -> list[Span]:
    """Return the days' means of ``wear``, with noise that follows itself, some days missing."""
    spread, follows, missing = random.uniform((0.02, 0.0, 0.0), (0.15, 0.8, 0.3))
    noise = np.zeros(wear.size)
    for day in range(1, wear.size):
        noise[day] = follows * noise[day - 1] + spread * np.sqrt(1.0 - follows**2) * random.standard_normal()
    kept = np.flatnonzero(random.random(wear.size) >= missing)
    return [Span(int(day) * DAY, 1, 0.0, float(wear[day] + noise[day]), 0.0) for day in kept]


def counted(seed: int, runs: int) -> tuple[int, int]:
    """Return how often an interval was stated, and how often it held the day."""
    random = np.random.default_rng(seed)
    stated = right = 0
    while stated < runs:
        wear, reached = worn(random)
        now = int(random.uniform(0.3, 0.9) * min(reached, wear.size))
        spans = measured(random, wear[:now])
        found = time_to_limit(spans, DAY, LIMIT)
        if found is not None:
            stated += 1
            right += found.early <= reached * DAY - spans[-1].start <= found.late
    return stated, right


def test_the_interval_holds_the_day_as_often_as_it_says() -> None:
    _, right = counted(seed=2, runs=40)
    # 90 % of 40 are 36; with a probability of 0.995 at least 31.
    assert right >= 31


def test_a_healthy_valve_promises_no_limit() -> None:
    random = np.random.default_rng(3)
    found = [time_to_limit(measured(random, np.full(90, 0.2)), DAY, LIMIT) for _ in range(60)]
    assert sum(one is not None and np.isfinite(one.late) for one in found) <= 3


def test_days_near_the_limit_are_counted_and_what_has_passed_it_reaches_none(tmp_path: Path) -> None:
    begin, now = 1_700_000_000 - 1_700_000_000 % DAY, 1_700_000_000 - 1_700_000_000 % DAY + 30 * DAY
    sums = Sums()
    for hour in range(30 * 24):
        day = hour // 24
        value = {25: 0.85, 27: 0.95}.get(day, 0.3)
        sums.add((begin + hour * HOUR) * 1_000_000_000, "coulomb_force", "N", value)
        sums.add((begin + hour * HOUR) * 1_000_000_000, "natural_frequency", "Hz", 14.0 - 0.05 * day)
    store = TrendStore(tmp_path / "trends.sqlite")
    store.write(sums)
    assert outlook(store, "coulomb_force", 0.2, (None, LIMIT), now) == (2, None)
    near, reaches = outlook(store, "natural_frequency", 15.0, (13.0, 16.0), now)
    assert (near, reaches) == (7, None)
    near, reaches = outlook(store, "natural_frequency", 15.0, (12.0, 16.0), now)
    store.close()
    assert near == 2
    assert reaches is not None
    # 12.55 Hz on the last whole day, 0.05 Hz less each day.
    assert reaches.early <= 11 * DAY <= reaches.late
