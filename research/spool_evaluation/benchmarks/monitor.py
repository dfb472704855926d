"""Benchmark of drift detectors on the same estimates, against river, ruptures and the literature.

In each row the errors are median delays, s, over the drifts that were found; ``work`` counts those, and
``peer`` tells how many the peer found with its best setting: the one with the most found, then the shortest
delay, among those that raise nothing on the healthy streams. Ours runs with the defaults of the node, which
let pass what is not large enough to matter; "Page's sum, chosen alike" is the same sum with the setting that
is best on these streams, as the peers' are. A negative delay is a change found before it is that large.
That sum and the Bayesian change points are those of ``./spool study operation``, compiled.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from spool_core.numbers import Array
from spool_estimator.estimate import Estimate
from spool_monitor.parameter_drift import VISCOUS, ParameterDrift
from spool_monitor.state_file import Baseline
from spool_sim.simulator import DEFAULT_START_STAMP

from spool_evaluation.results.timing import Timing, best_of
from spool_evaluation.studies.monitor import replay
from spool_evaluation.studies.peers import (
    EVERY,
    SHORTEST,
    WINDOW,
    Statistic,
    first_alarm,
    judged_share,
    median,
    page_sum,
    run_change,
    run_level,
    soonest,
)
from spool_evaluation.studies.scenarios import Scenario, draw_scenario

LATE = ("river", "ruptures")  # loaded where they are asked for
#: Of the streams; no seed from here to 30999 was used for making the detectors or a published table.
FRESH = 30_000
HEALTHY = ("healthy, oil warms", "healthy, speed changes", "healthy, standstills")
DRIFTS = ("wear, step", "wear, ramp", "wear, oil warms", "contamination", "contamination, oil warms")
#: How often each is drawn.
ROUNDS = 2

#: By text, settings of a detector: what it watches, and from where on it tells of a change.
Settings: TypeAlias = dict[str, tuple[Statistic, float]]


def river(values: Array, detector: str, **settings: float) -> Array:
    """Return 1 where the detector of river with that name tells of a change, else 0."""
    from river import drift  # noqa: PLC0415 - slow to load

    made = getattr(drift, detector)(**settings)
    found = np.zeros(values.size)
    for number, value in enumerate(values):
        made.update(value)
        found[number] = made.drift_detected
    return found


def kernel_change_points(values: Array, penalty: float) -> Array:
    """Return 1 where ruptures' search over the last ``WINDOW`` values, at every ``EVERY``, finds a change."""
    import ruptures  # noqa: PLC0415 - slow to load

    found = np.zeros(values.size)
    for end in range(3 * SHORTEST, values.size + 1, EVERY):
        search = ruptures.KernelCPD(kernel="linear", min_size=SHORTEST).fit(
            values[max(0, end - WINDOW) : end]
        )
        found[end - 1] = len(search.predict(pen=penalty)) > 1
    return found


def _river(detector: str, **settings: Any) -> tuple[Statistic, float]:
    return partial(river, detector=detector, **settings), 0.5


#: By name, the settings of each peer.
PEERS: dict[str, Settings] = {
    "Page's sum, chosen alike": {
        f"allowance {allowance:g}, threshold {threshold:g}": (
            partial(page_sum, allowance=allowance),
            threshold,
        )
        for allowance, threshold in product((0.1, 0.2, 0.4, 0.65), (0.25, 0.5, 1.0, 2.0, 4.0, 8.0))
    },
    "river PageHinkley": {
        f"delta {delta:g}, threshold {threshold:g}": _river(
            "PageHinkley", min_instances=15, delta=delta, threshold=threshold, alpha=1.0
        )
        for delta, threshold in product((0.05, 0.2, 0.5), (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0))
    },
    "river ADWIN": {
        f"delta 1e-{power}, grace {grace}": _river(
            "ADWIN", delta=10.0**-power, clock=1, min_window_length=3, grace_period=grace
        )
        for power, grace in product(range(1, 13), (10, 30))
    },
    "river KSWIN": {
        f"alpha 1e-{power}, window {size}": _river(
            "KSWIN", alpha=10.0**-power, window_size=size, stat_size=size // 3, seed=1
        )
        for power, size in product((2, 4, 6, 8, 10, 12), (30, 60))
    },
    "ruptures KernelCPD": {
        f"penalty {penalty:g}": (partial(kernel_change_points, penalty=penalty), 0.5)
        for penalty in (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
    },
    "Bayesian change points": {
        f"hazard {hazard:g}, scatter {scatter:g}, {name} {threshold:g}": (
            partial(statistic, hazard=hazard, scatter=scatter),
            threshold,
        )
        for hazard, scatter in product((1e-2, 1e-4, 1e-6), (0.05, 0.2, 0.5))
        for name, statistic, thresholds in (
            ("probability", run_change, (0.5, 0.99, 1.0 - 1e-6)),
            ("level", run_level, (0.25, 0.5, 0.75, 1.0)),
        )
        for threshold in thresholds
    },
}


@dataclass(frozen=True, slots=True)
class DriftStream:
    """One parameter of one case.

    Attributes:
        estimates: what the estimator said.
        seconds, shares: when (s) our test judged a change, and that in units of the one that matters.
        ours: s, when our test told of a change, infinite where it did not.
        reached: s, when the change matters, NaN on a healthy valve.
        began: s, infinite on a healthy valve.
    """

    parameter: str
    estimates: Sequence[Estimate]
    seconds: Array
    shares: Array
    ours: float
    reached: float
    began: float


def run(seed: int = FRESH, cases: int = ROUNDS) -> Iterator[Timing]:
    """Yield a row per peer; every kind of stream is drawn ``cases`` times from ``seed``.

    Raises:
        RuntimeError: our test raised a false alarm.
    """
    streams = list(_streams(seed, cases))
    ours = delays_of([one.ours for one in streams], streams)
    if ours is None:
        raise RuntimeError("bench monitor: a false alarm of ours, so delays can't be compared")
    work = f"one value; {_found(ours)} drifts found, error: delay, s"
    ours_s = min(
        best_of(1, partial(list, judged(one.parameter, one.estimates))) / len(one.estimates)
        for one in streams
    )
    for name, settings in PEERS.items():
        silent = {}
        for text, (watched, threshold) in settings.items():
            found = [first_alarm(watched(one.shares), threshold, one.seconds) for one in streams]
            delays = delays_of(found, streams)
            if delays is not None:
                silent[text] = delays
        peer, error, text = f"{name}: false alarms in every setting", math.inf, next(iter(settings))
        if silent:
            text, delays = soonest(silent)
            peer, error = f"{name} {text}: {_found(delays)} found", median(delays)
        watched = settings[text][0]
        peer_s = min(best_of(1, partial(watched, one.shares)) / one.shares.size for one in streams)
        yield Timing(work, peer, ours_s, peer_s, median(ours), error if math.isfinite(error) else None)


def delays_of(found: Sequence[float], streams: Sequence[DriftStream]) -> Array | None:
    """Return how late (s) each drift was found, infinite where not; ``None`` if there is a false alarm.

    Args:
        found: s, when a detector first told of a change in each of ``streams``, infinite where it did not.
        streams: healthy ones and ones that drift.
    """
    pairs = list(zip(found, streams, strict=True))
    if any(when < one.began for when, one in pairs):
        return None
    return np.array([when - one.reached for when, one in pairs if math.isfinite(one.reached)])


def _found(delays: Array) -> str:
    return f"{np.isfinite(delays).sum()}/{delays.size}"


def _streams(seed: int, rounds: int) -> Iterator[DriftStream]:
    """Yield the streams of the healthy cases, two parameters each, and of the drifting ones."""
    for number, kind in enumerate((*HEALTHY, *DRIFTS) * rounds):
        case = draw_scenario(kind, np.random.default_rng([seed, number]))
        estimates = replay(case, keep=True).estimates
        moved = {change.quantity for change in case.changes} - {"oil_temperature"}
        for parameter in (VISCOUS, "coulomb_force"):
            if not moved or parameter in moved:
                yield _stream(case, parameter, estimates)


def _stream(case: Scenario, parameter: str, estimates: Sequence[Estimate]) -> DriftStream:
    """Return what our sequential test judges, without the baseline, and when it tells of a change."""
    ours, seen = math.inf, []
    for estimate, test in judged(parameter, estimates):
        second = (estimate.stamp - DEFAULT_START_STAMP) * 1e-9
        if test.judged:
            seen.append((second, judged_share(test)))
        if test.level is not None:
            ours = min(ours, second)
    seconds, shares = np.array(seen).T.copy()
    event = case.expected[0] if case.expected else None
    reached, began = (event.reached, event.begin) if event else (math.nan, math.inf)
    return DriftStream(parameter, estimates, seconds, shares, ours, reached, began)


def judged(parameter: str, estimates: Iterable[Estimate]) -> Iterator[tuple[Estimate, ParameterDrift]]:
    """Yield each of ``estimates`` with our test after it."""
    relative = parameter == VISCOUS
    test = ParameterDrift(parameter, 0.2 if relative else 0.1, relative, Baseline(15.0))
    for estimate in estimates:
        test.update(estimate)
        yield estimate, test
