"""Change detectors of river, ruptures and the literature, each with the settings that are tried."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import TypeAlias

import numpy as np
import ruptures
from river import drift as river_drift
from spool_monitor.drift.parameter_drift import CAP, CumulativeSum

from .change_points import ChangePoints

#: Values that ruptures looks at, and how many come between two looks.
WINDOW, EVERY = 90, 3

#: Takes a value, returns whether it tells of a change.
Peer: TypeAlias = Callable[[float], bool]
#: By text, what makes a peer with a setting.
Settings: TypeAlias = dict[str, Callable[[], Peer]]


def page_sum(allowance: float, threshold: float) -> Peer:
    """Return Page's cumulative sum, the one that ships, fed once a second."""
    total = CumulativeSum(allowance, CAP)
    count = 0

    def update(value: float) -> bool:
        nonlocal count
        count += 1
        total.update(count * 1_000_000_000, value, 1.0)
        return total.size > threshold

    return update


def river(detector: type[river_drift.ADWIN], **settings: float) -> Peer:
    """Return one of river's detectors."""
    made = detector(**settings)

    def update(value: float) -> bool:
        made.update(value)
        return bool(made.drift_detected)

    return update


def kernel_change_points(penalty: float) -> Peer:
    """Return ruptures' offline search over the last ``WINDOW`` values, looked at every ``EVERY``."""
    last: list[float] = []
    count = 0

    def update(value: float) -> bool:
        nonlocal count
        last.append(value)
        del last[:-WINDOW]
        count += 1
        if count % EVERY or len(last) < 12:
            return False
        model = ruptures.KernelCPD(kernel="linear", min_size=4).fit(np.array(last))
        return len(model.predict(pen=penalty)) > 1

    return update


def change_points(
    hazard: float, scatter: float, probability: float = math.inf, level: float = math.inf
) -> Peer:
    """Return Bayesian change points: alarm by the probability of a change, or by the level."""
    detector = ChangePoints(hazard, scatter)

    def update(value: float) -> bool:
        detector.update(value)
        return detector.changed > probability or abs(detector.level) > level

    return update


def _change_point_settings() -> Settings:
    found: Settings = {}
    for hazard, scatter in product((1e-2, 1e-4, 1e-6), (0.05, 0.2, 0.5)):
        given = f"hazard {hazard:g}, scatter {scatter:g}"
        for probability in (0.5, 0.99, 1.0 - 1e-6):
            made = partial(change_points, hazard, scatter, probability=probability)
            found[f"{given}, probability {probability:g}"] = made
        for level in (0.25, 0.5, 0.75, 1.0):
            found[f"{given}, level {level:g}"] = partial(change_points, hazard, scatter, level=level)
    return found


#: By name, the settings of each peer.
PEERS: dict[str, Settings] = {
    "Page's sum, chosen alike": {
        f"allowance {allowance:g}, threshold {threshold:g}": partial(page_sum, allowance, threshold)
        for allowance, threshold in product((0.1, 0.2, 0.4, 0.65), (0.25, 0.5, 1.0, 2.0, 4.0, 8.0))
    },
    "river PageHinkley": {
        f"delta {delta:g}, threshold {threshold:g}": partial(
            river, river_drift.PageHinkley, min_instances=15, delta=delta, threshold=threshold, alpha=1.0
        )
        for delta, threshold in product((0.05, 0.2, 0.5), (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0))
    },
    "river ADWIN": {
        f"delta 1e-{power}, grace {grace}": partial(
            river, river_drift.ADWIN, delta=10.0**-power, clock=1, min_window_length=3, grace_period=grace
        )
        for power, grace in product(range(1, 13), (10, 30))
    },
    "river KSWIN": {
        f"alpha 1e-{power}, window {size}": partial(
            river, river_drift.KSWIN, alpha=10.0**-power, window_size=size, stat_size=size // 3, seed=1
        )
        for power, size in product((2, 4, 6, 8, 10, 12), (30, 60))
    },
    "ruptures KernelCPD": {
        f"penalty {penalty:g}": partial(kernel_change_points, penalty)
        for penalty in (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
    },
    "Bayesian change points": _change_point_settings(),
}
