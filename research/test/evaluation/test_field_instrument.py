"""Instrument of the field study: a wrong verdict has one reason, found inside the run that gave it."""

from __future__ import annotations

from pathlib import Path

import pytest
from spool_blind.field.case import Importance, make_field
from spool_blind.files import write
from spool_evaluation.studies.field.instrument import (
    CHAIN,
    DETECTOR,
    LAW,
    LIKELIHOOD,
    MEANINGS,
    MINIMUM,
    NEVER,
    OVERRULED,
    REFUSED,
    diagnosed,
    diagnosis_page,
    reason,
    stretches_as_told,
)
from spool_evaluation.studies.field.study import BASE, field_row
from spool_evaluation.studies.field.verdicts import Diagnosis, FieldVerdict
from spool_gap.evidence import analyse
from spool_gap.evidence.analyse import Run
from spool_gap.likelihood.search import Key
from spool_gap.likelihood.structure_fit import DECISIVE
from spool_sim.model import MODELS

CASE = make_field(33, "coulomb_friction", ())
TRUTH: Key = frozenset({"coulomb_friction"}), frozenset({"spool_ac_coupling"})
OTHER: Key = frozenset({"mixed_friction"}), frozenset()


def row(hidden: str, verdict: str, kind: str = "effect", why: Diagnosis | None = None) -> FieldVerdict:
    important = {hidden: Importance(0.1, 0.1, 100.0, 10.0)}
    return FieldVerdict(
        seed=1, window="development", kind=kind, hidden=hidden, accepted=(hidden,), importance=important,
        nuisances=(), verdict=verdict, diagnosis=why,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("known", "lead", "right_again", "expected"),
    [
        ([OTHER], 500.0, True, NEVER),
        ([OTHER, (TRUTH[0], frozenset())], 500.0, True, CHAIN),
        ([OTHER, TRUTH], 500.0, True, MINIMUM),
        ([OTHER, TRUTH], DECISIVE + 1.0, False, OVERRULED),
        ([OTHER], DECISIVE - 1.0, False, LIKELIHOOD),
        ([OTHER, TRUTH], -500.0, False, LIKELIHOOD),
    ],
)
def test_the_reason_follows_from_what_was_fitted_and_from_the_second_decision(
    known: list[Key], lead: float, right_again: bool, expected: str
) -> None:
    assert reason(known, TRUTH, lead, right_again=right_again) == expected


@pytest.mark.parametrize(
    ("hidden", "verdict", "kind", "expected"),
    [
        ("coulomb_friction", "refused", "effect", REFUSED),
        ("maxwell_slip", "presliding_friction", "out_of_catalogue", LAW),
        ("sensor_saturation", "none", "effect", DETECTOR),
    ],
)
def test_some_verdicts_are_wrong_for_a_reason_that_no_fit_can_change(
    hidden: str, verdict: str, kind: str, expected: str
) -> None:
    # What a run holds is not looked at.
    run = object.__new__(Run) if verdict != "refused" else None
    assert diagnosed(CASE, row(hidden, verdict, kind), run) == Diagnosis(expected)


def test_a_verdict_that_is_right_has_no_diagnosis() -> None:
    assert diagnosed(CASE, row("coulomb_friction", "coulomb_friction"), None) is None


def test_the_page_counts_the_reasons_of_wrong_verdicts(tmp_path: Path) -> None:
    rows = [
        row("coulomb_friction", "none", why=Diagnosis(NEVER, 812.3, "coulomb_friction")),
        row("coulomb_friction", "coulomb_friction"),
    ]
    text = diagnosis_page(rows, tmp_path, "./spool study field --diagnose").read_text("utf-8")
    assert "1 of 2 verdicts are wrong" in text
    assert f"| {NEVER} | 1 | {MEANINGS[NEVER]} |" in text
    assert "| 812 |" in text


@pytest.mark.slow
def test_a_law_that_the_search_does_not_try_was_never_fitted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(analyse, "tried_effects", lambda _base: ["cubic_stiffness"])
    run = analyse.searched(*stretches_as_told(*write(CASE, tmp_path)), MODELS[BASE])
    decision = run.decided()
    said = run.words(decision, run.judged(decision)).verdict
    found = diagnosed(CASE, field_row(CASE, {"verdict": said}, (0.0, 0.0)), run)
    assert found is not None
    assert (found.reason, found.again) == (NEVER, "coulomb_friction")
    assert found.advantage is not None
    assert found.advantage > 100.0
