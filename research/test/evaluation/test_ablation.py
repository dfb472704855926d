"""Ablation of the gap selection: counts by hand, real stages, nothing analysed twice."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from spool_evaluation.studies import ablation
from spool_evaluation.studies.ablation import NEEDED, UNSEEN, Trial, worths
from spool_gap.stages.growth import BACKWARD, FORWARD
from spool_gap.stages.selection import FINAL, SELECTION

STAGES = {stage.__name__ for stage in (*SELECTION, *FORWARD, *BACKWARD, *FINAL)}


def trial(seed: int, without: str, right: bool, *changed_by: str) -> Trial:
    return Trial(
        seed, without, "coulomb_friction", "coulomb_friction" if right else "none", right, changed_by
    )


def test_worth_is_what_is_right_with_a_stage_only_less_what_is_right_without_it_only() -> None:
    first = [trial(seed, "", seed != 3, "try_other_start") for seed in range(10)]
    without = [trial(seed, "try_other_start", seed in (2, 3)) for seed in range(4)]
    (row,) = worths([*first, *without])
    assert (row.cases, row.changed, row.gained, row.lost) == (10, 4, 2, 1)
    assert row.worth == pytest.approx(0.1)
    assert row.p == pytest.approx(1.0)  # two to one says nothing


def test_few_cases_decide_nothing_against_a_stage() -> None:
    (few,) = worths([trial(1, "", True), trial(1, "drop_insignificant", True)])
    assert few.stays == "not decided"
    many = [trial(seed, "", True) for seed in range(400)]
    (row,) = worths([*many, trial(1, "drop_insignificant", True)])
    assert row.stays == "no"


def test_stages_by_these_names_exist() -> None:
    assert set(UNSEEN) | NEEDED <= STAGES


def test_what_is_known_is_not_analysed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = [trial(50, "", True, "drop_insignificant"), trial(50, "drop_insignificant", False)]
    known += [trial(50, stage, True) for stage in UNSEEN]
    rows = tmp_path / ablation.ROWS
    half = '{"seed": 51, "with'
    rows.write_text("\n".join(json.dumps(asdict(one)) for one in known) + "\n" + half)
    asked: list[object] = []
    monkeypatch.setattr(ablation, "spread", lambda _work, items, *_: asked.extend(items) or [])
    found = ablation.run(1, 50, tmp_path)
    assert asked == []
    assert {row.stage: row.gained for row in found}["drop_insignificant"] == 1
    assert "drop insignificant" in (tmp_path / ablation.PAGE).read_text()
