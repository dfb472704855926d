"""What a monitor makes of estimates that are lost, doubled, late or exchanged; 10,000 by ``.ci/nightly``."""

from __future__ import annotations

import os

from .messages import run

#: How many seeds, and the first one.
RUNS, FIRST = int(os.environ.get("SPOOL_FAULTS_RUNS", "40")), int(os.environ.get("SPOOL_FAULTS_FIRST", "0"))


def test_faults_of_messages_invent_no_alarm_lose_none_and_end_the_same_again() -> None:
    wrong = []
    for seed in range(FIRST, FIRST + RUNS):
        one = run(seed)
        if one.invented or one.lost or (seed % 10 == 0 and run(seed) != one):
            wrong.append((seed, one.story, one.faults, one.invented, one.lost))
        if (seed - FIRST) % 500 == 499:
            print(f"{seed - FIRST + 1} of {RUNS} seeds, {len(wrong)} wrong", flush=True)
    assert wrong == []
