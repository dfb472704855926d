"""What a monitor makes of estimates that are lost, doubled, late or exchanged; 10,000 by ``.ci/nightly``."""

from __future__ import annotations

import os

from .messages import run

#: How many seeds, from 0.
RUNS = int(os.environ.get("SPOOL_FAULTS_RUNS", "40"))


def test_faults_of_messages_invent_no_alarm_lose_none_and_end_the_same_again() -> None:
    wrong = []
    for seed in range(RUNS):
        one = run(seed)
        if one.invented or one.lost or (seed % 10 == 0 and run(seed) != one):
            wrong.append((seed, one.story, one.faults, one.invented, one.lost))
        if seed % 500 == 499:
            print(f"{seed + 1} of {RUNS} seeds, {len(wrong)} wrong", flush=True)
    assert wrong == []
