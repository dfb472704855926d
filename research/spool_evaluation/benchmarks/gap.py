"""Benchmark of naming what is hidden in blind records, against PySINDy."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial

from spool_blind.case import hidden_by, kind_of, make
from spool_gap.registry import EFFECTS

from spool_evaluation.results.timing import Stopwatch, Timing
from spool_evaluation.studies.gap import given, judge

from .gap_peer import library, named

CASES = 12
#: Of the first record; no seed from here to 30999 was used for making the workflow or a published table.
FRESH = 30_000
PEERS = {"PySINDy STLSQ": False, "PySINDy ensemble": True}


def run(seed: int = FRESH, cases: int = CASES) -> Iterator[Timing]:
    """Yield per peer one row for the share not named right and one for false terms a record.

    The records are the first from ``seed`` on that hide nothing or what a library of terms can hold.
    """
    ours_s, ours_wrong, ours_false = 0.0, 0, 0
    peer_s = dict.fromkeys(PEERS, 0.0)
    peer_wrong, peer_false = dict.fromkeys(PEERS, 0), dict.fromkeys(PEERS, 0)
    for number in seeds(cases, seed):
        case = make(number)
        hidden = frozenset(case.hidden.split("+")) - {"none"}
        row = judge(case)
        said = frozenset(row.verdict.split("+")) - {"none"}
        ours_s += row.seconds
        ours_wrong += not row.right
        ours_false += len(said - hidden)
        record, valve = given(case)
        for peer, ensemble in PEERS.items():
            watch = Stopwatch()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it warns of every threshold that removes all columns
                found = named(library(record, valve), ensemble=ensemble)
            peer_s[peer] += watch.read()[0]
            peer_wrong[peer] += found != hidden
            peer_false[peer] += len(found - hidden)
    for peer in PEERS:
        row_of = partial(Timing, peer=peer, ours_s=ours_s / cases, peer_s=peer_s[peer] / cases)
        yield row_of(
            f"name what is hidden, {cases} records from seed {seed}: not right",
            ours_error=ours_wrong / cases,
            peer_error=peer_wrong[peer] / cases,
        )
        yield row_of(
            f"name what is hidden, {cases} records from seed {seed}: false terms",
            ours_error=ours_false / cases,
            peer_error=peer_false[peer] / cases,
        )


def seeds(count: int, seed: int = FRESH) -> list[int]:
    """Return the first ``count`` from ``seed`` on whose case hides nothing or forces of the catalogue."""
    found: list[int] = []
    while len(found) < count:
        names = hidden_by(seed).split("+")
        forces = all(name in EFFECTS and EFFECTS[name].terms for name in names)
        if kind_of(hidden_by(seed)) == "none" or forces:
            found.append(seed)
        seed += 1
    return found
