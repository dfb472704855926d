"""Fault injection: faults of all kinds, chosen by a seed, several recorders at a time."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from . import files, live, power
from .outcome import Outcome

#: Faults that one recorder meets, one after the other.
IN_A_ROW = 6
#: Of all faults those that a running recorder meets; the others are of files.
LIVE_SHARE = 0.6


def run(
    folder: Path, count: int, domains: list[int], seed: int, show: Callable[[str], object] = lambda _: None
) -> list[Outcome]:
    """Inject ``count`` faults and return what each cost; one recorder at a time on each DDS domain."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    sessions = max(round(count * LIVE_SHARE / IN_A_ROW), 1)
    outcomes: list[Outcome] = []

    def one(number: int) -> list[Outcome]:
        domain = domains.pop()
        place = folder / f"session_{number}"
        try:
            return live.session(place, domain, seed + number, IN_A_ROW)
        finally:
            domains.append(domain)
            shutil.rmtree(place, ignore_errors=True)

    with ThreadPoolExecutor(len(domains)) as pool:
        for done, found in enumerate(pool.map(one, range(sessions)), 1):
            outcomes += found
            show(f"{len(outcomes)} of {count} faults, {done} of {sessions} recorders")
    return outcomes + of_files(folder, count - len(outcomes), seed, show)


def of_files(folder: Path, count: int, seed: int, show: Callable[[str], object]) -> list[Outcome]:
    """Inject ``count`` faults of files."""
    contents = files.Contents(files.recorded(folder / "whole"))
    log = power.WriteLog(folder / "power")
    outcomes = []
    kinds = [*files.FAULTS, "power loss"]
    for number in range(count):
        place = folder / f"file_{number}"
        kind, own = kinds[number % len(kinds)], seed * 100_000 + number
        if kind == "power loss":
            outcomes.append(power.power_loss(log, place, own))
        else:
            outcomes.append(files.FAULTS[kind](contents, place, own))
        shutil.rmtree(place, ignore_errors=True)
        if number % 50 == 49:
            show(f"{number + 1} of {count} faults of files")
    return outcomes
