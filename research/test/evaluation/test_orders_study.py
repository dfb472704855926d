"""Study of orders: a small sample of it holds what its page states."""

from __future__ import annotations

import numpy as np
from spool_evaluation.studies.orders import KINDS, OrdersCase, judge, structure, table

SAMPLE = 12


def test_nothing_is_named_wrongly_in_a_sample_and_speeds_are_found() -> None:
    kinds = [
        kind
        for kind in KINDS
        if "0.5%" not in kind and "same kind" not in kind and "order: foreign" not in kind
    ]
    found = [judge(OrdersCase(kind, seed)) for kind in kinds for seed in range(SAMPLE)]
    assert not [one for one in found if one.named and not one.right]
    alone = [one for one in found if one.kind == "speed: the machine alone"]
    assert sum(one.right for one in alone) >= 2


def test_a_structure_has_the_stated_damping() -> None:
    pieces = np.stack([structure(np.random.default_rng(n), 0.03) for n in range(30)])
    powers = np.mean(np.abs(np.fft.rfft(pieces * np.hanning(pieces.shape[1]))) ** 2, axis=0)
    frequency = np.fft.rfftfreq(pieces.shape[1], 5e-4)
    peak = powers[np.abs(frequency - 29.0) < 0.5].mean()
    above = frequency[(powers > 0.5 * peak) & (np.abs(frequency - 29.0) < 5.0)]
    assert abs(np.ptp(above) / 29.0 - 0.06) < 0.025  # half power is 2 zeta wide


def test_a_wrong_name_is_counted() -> None:
    kind = "speed: the machine stands, a pump of the same kind runs"
    found = [judge(OrdersCase(kind, seed)) for seed in range(SAMPLE)]
    wrong = sum(one.named for one in found)
    assert wrong > 0
    assert f"| {kind} | {SAMPLE} | {wrong} |" in table(found)
