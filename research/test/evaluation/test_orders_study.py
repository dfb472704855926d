"""Study of orders: a small sample of it holds what its page states."""

from __future__ import annotations

import numpy as np
from spool_evaluation.studies.orders import KINDS, judge, structure, table

SAMPLE = 12


def test_nothing_is_named_wrongly_in_a_sample() -> None:
    kinds = [kind for kind in KINDS if "0.5%" not in kind and "foreign" not in kind]
    found = [judge((kind, seed)) for kind in kinds for seed in range(SAMPLE)]
    assert not [kind for kind, named in found if named]


def test_a_structure_has_the_stated_damping() -> None:
    pieces = np.stack([structure(np.random.default_rng(n), 0.03) for n in range(30)])
    powers = np.mean(np.abs(np.fft.rfft(pieces * np.hanning(pieces.shape[1]))) ** 2, axis=0)
    frequency = np.fft.rfftfreq(pieces.shape[1], 5e-4)
    peak = powers[np.abs(frequency - 29.0) < 0.5].mean()
    above = frequency[(powers > 0.5 * peak) & (np.abs(frequency - 29.0) < 5.0)]
    assert abs(np.ptp(above) / 29.0 - 0.06) < 0.025  # half power is 2 zeta wide


def test_a_wrong_name_is_counted() -> None:
    kind = "order: foreign tone, engine at 580 rev/min"
    found = [(kind, named) for named in (True, False, True)]
    assert f"| {kind} | 3 | 2 |" in table(found)
