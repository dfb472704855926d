"""Diagnosis of wrong verdicts: the reason follows from the likelihood of the truth."""

from __future__ import annotations

import pytest
from spool_blind.field.case import make_field
from spool_evaluation.studies.field.diagnosis import (
    DETECTOR,
    LAW,
    LIKELIHOOD,
    NUISANCE,
    OPEN,
    SEARCH,
    diagnosed,
    reason,
)
from spool_evaluation.studies.field.study import field_row
from spool_evaluation.studies.field.verdicts import ChainFault, FieldVerdict, HiddenShare

DRAWN, TOLD = ChainFault("ac_coupling", "spool", 1.0, "Hz"), ChainFault("anti_alias", "spool", 1e-3, "s")


def row(hidden: str, verdict: str, kind: str = "effect", told: tuple[ChainFault, ...] = ()) -> FieldVerdict:
    return FieldVerdict(
        seed=1, window="development", kind=kind, hidden=hidden, accepted=(hidden,), nuisances=(DRAWN,),
        importance={hidden: HiddenShare(0.1, 0.1, 10.0, True)}, verdict=verdict, told=told,
    )  # fmt: skip


def test_a_law_of_no_catalogue_has_no_truth_to_fit() -> None:
    assert diagnosed(row("maxwell_slip", "presliding_friction", "out_of_catalogue")).reason == LAW


def test_a_missed_saturation_is_the_detectors() -> None:
    assert diagnosed(row("sensor_saturation", "none")).reason == DETECTOR


@pytest.mark.parametrize(
    ("advantage", "told", "expected"),
    [
        (500.0, (), SEARCH),
        (500.0, (DRAWN,), SEARCH),
        (500.0, (TOLD,), NUISANCE),
        (-500.0, (TOLD,), LIKELIHOOD),
        (9.0, (TOLD,), OPEN),
        (-9.0, (), OPEN),
    ],
)
def test_the_reason_follows_from_the_advantage_of_the_truth(
    advantage: float, told: tuple[ChainFault, ...], expected: str
) -> None:
    assert reason(row("coulomb_friction", "none", told=told), advantage) == expected


@pytest.mark.slow
def test_a_law_that_was_overlooked_is_a_failure_of_the_search() -> None:
    wrong = field_row(make_field(300032), {"verdict": "coulomb_friction+spool_delay"}, (0.0, 0.0))
    found = diagnosed(wrong)
    assert found.reason == SEARCH
    assert found.advantage is not None
    assert found.advantage > 1000.0
