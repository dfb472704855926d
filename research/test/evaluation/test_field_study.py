"""Field study: how it counts, what its page says, and that plain records are named as such."""

from __future__ import annotations

from pathlib import Path

import pytest
from spool_blind.field.case import Importance, make_field
from spool_evaluation.studies import workers
from spool_evaluation.studies.field import study
from spool_evaluation.studies.field.instrument import NEVER
from spool_evaluation.studies.field.instrument import PAGE as DIAGNOSES
from spool_evaluation.studies.field.study import PAGE, PICTURE, field_parts, write_field_page
from spool_evaluation.studies.field.verdicts import (
    FALSE,
    MISSED,
    NO_VERDICT,
    NOTHING,
    ONE,
    OUTSIDE,
    OVER_CAUTIOUS,
    RIGHT,
    TWO,
    UNIMPORTANT,
    ChainFault,
    Diagnosis,
    FieldVerdict,
    brier_scores,
    by_nuisance,
    counted,
    deciles,
    field_targets,
    told_of,
)
from spool_gap.evidence import analyse

LARGE, SMALL = Importance(0.1, 0.05, 1e3, 10.0), Importance(0.01, 0.001, 1e3, 10.0)
HUM = ChainFault("hum", "spool", 0.2, "m/s^2")


def row(hidden: str, verdict: str, accepted: tuple[str, ...] = (), **given: object) -> FieldVerdict:
    names = [] if hidden == "none" else hidden.split("+")
    kind = ("none", "effect", "pair")[len(names)] if hidden != "oil_chamber" else "out_of_catalogue"
    values: dict[str, object] = {
        "seed": 7, "window": "report", "importance": dict.fromkeys(names, LARGE), "nuisances": (), **given
    }  # fmt: skip
    return FieldVerdict(kind=kind, hidden=hidden, accepted=accepted or (hidden,), verdict=verdict, **values)


@pytest.mark.parametrize(
    ("hidden", "verdict", "outcome"),
    [
        ("none", "none", RIGHT),
        ("none", "unexplained", OVER_CAUTIOUS),
        ("none", "coulomb_friction", FALSE),
        ("none", "coulomb_friction+unexplained", FALSE),
        ("none", "refused", NO_VERDICT),
        ("end_stop", "end_stop", RIGHT),
        ("end_stop", "end_stop+unexplained", OVER_CAUTIOUS),
        ("end_stop", "unexplained", MISSED),
        ("end_stop", "none", MISSED),
        ("end_stop", "cubic_stiffness", FALSE),
        ("end_stop", "coulomb_friction+end_stop", FALSE),
        ("a+b", "b+a", RIGHT),
        ("a+b", "b+unexplained+a", OVER_CAUTIOUS),
        ("a+b", "b", MISSED),
        ("a+b", "b+unexplained", MISSED),
        ("a+b", "b+c", FALSE),
    ],
)
def test_a_verdict_is_right_over_cautious_false_or_missed_by_its_set_of_names(hidden, verdict, outcome):
    assert row(hidden, verdict).outcome == outcome


@pytest.mark.parametrize(
    ("verdict", "outcome"),
    [
        ("unexplained", RIGHT),
        ("mixed_friction+unexplained", RIGHT),
        ("mixed_friction", FALSE),
        ("none", MISSED),
    ],
)
def test_a_law_of_no_catalogue_has_to_leave_something_unexplained(verdict, outcome):
    assert row("oil_chamber", verdict, ("unexplained",)).outcome == outcome


@pytest.mark.parametrize(
    ("explained", "outcome", "held", "single", "grouped"),
    [
        ((("stribeck_friction",), ("coulomb_friction",)), OVER_CAUTIOUS, True, False, True),
        ((("stribeck_friction",), ("mixed_friction",)), FALSE, False, False, True),
        ((("quadratic_damping",), ("damping_drift",)), FALSE, False, False, False),
    ],
)
def test_a_group_is_right_where_its_explanations_hold_the_truth(explained, outcome, held, single, grouped):
    said = row("coulomb_friction", "dry_friction", explained=explained)
    assert (said.outcome, said.set_right, said.single, said.group_right) == (outcome, held, single, grouped)
    assert not said.first_right


def test_a_verdict_of_one_explanation_is_a_single_name():
    said = row("end_stop", "end_stop+unexplained", explained=(("end_stop",),))
    assert said.single
    assert said.first_right
    assert not row("end_stop", "none", explained=((),)).single


def test_what_does_not_matter_is_not_counted_against():
    accepted = ("none", "end_stop")
    small = {"importance": {"end_stop": SMALL}}
    assert [row("end_stop", said, accepted, **small).outcome for said in accepted] == [RIGHT, RIGHT]
    assert row("end_stop", "none", accepted, **small).question == UNIMPORTANT
    assert row("a+b", "a", importance={"a": LARGE, "b": SMALL}).question == ONE
    assert [row(hidden, "none").question for hidden in ("none", "a", "a+b", "oil_chamber")] == [
        NOTHING, ONE, TWO, OUTSIDE,
    ]  # fmt: skip


def test_outcomes_are_counted_by_nuisance():
    rows = [row("none", "none"), row("none", "unexplained", nuisances=(HUM,), told=(HUM,)), row("a", "a")]
    groups = by_nuisance(rows)
    assert [len(groups[name]) for name in ("no nuisance", "any nuisance", "hum")] == [2, 1, 1]
    assert counted(groups["hum"])[OVER_CAUTIOUS].count == 1
    where, elsewhere = told_of(rows, "hum")
    assert (where.count, where.of, elsewhere.count, elsewhere.of) == (1, 1, 0, 2)


def test_outcomes_are_counted_by_the_filter_of_the_logger():
    rows = [row("none", "none", sampled="causal"), row("a", "b", sampled="causal"), row("a", "a")]
    groups = by_nuisance(rows)
    assert counted(groups["logger's filter: causal"])[FALSE].count == 1
    assert [name for name in groups if name.startswith("logger")] == ["logger's filter: causal"]


def test_names_count_as_right_whatever_is_left_and_none_has_to_be_said_alone():
    rows = [row("a", "a+unexplained"), row("a", "a"), row("none", "unexplained")]
    met = {target.name: target.met for target in field_targets(rows)}
    assert met["one effect of importance, its name right"]
    assert met["nothing hidden, a false name"]
    assert not met["nothing hidden, `none` said"]


def test_a_law_that_is_not_seen_has_no_false_name_but_is_not_said_to_be_unexplained_either():
    verdicts = ["none"] * 6 + ["unexplained"] * 3 + ["a"]
    rows = [row("oil_chamber", said, ("unexplained",)) for said in verdicts]
    shares = {target.name: target.share for target in field_targets(rows)}
    unnamed = shares["out-of-catalogue laws not given a name alone"]
    unexplained = shares["out-of-catalogue laws said to be unexplained, or linear ones a resonance"]
    assert (unnamed.count, unexplained.count, unnamed.of, unexplained.of) == (9, 3, 10, 10)


def test_intervals_are_held_against_the_truth_where_the_names_are_right():
    held = row("a", "a", truth={"a.x": 2.0, "a.y": 1.0}, found={"a.x": (2.1, 0.06), "a.y": (1.5, 0.1)})
    assert held.within == {"a.x": True, "a.y": False}
    assert row("a", "b", truth={"a.x": 2.0}, found={"a.x": (2.1, 0.06)}).within == {}
    assert row("a", "a", truth={"a.x": 2.0}, found={"a.x": (2.1, None)}).within == {}


def test_a_confidence_that_is_a_frequency_beats_the_base_rate():
    sure = [row("a", "a", confidence=0.9)] * 18 + [row("a", "b", confidence=0.9)] * 2
    doubtful = [row("a", "a", confidence=0.1)] * 2 + [row("a", "b", confidence=0.1)] * 18
    low, high = deciles(sure + doubtful)
    assert (low.low, high.low, low.share.count, high.share.count) == (0.1, 0.9, 2, 18)
    assert low.agrees
    assert high.agrees
    score = brier_scores(sure + doubtful)[0]
    assert score.score == pytest.approx(0.09)
    assert score.base_rate == pytest.approx(0.25)
    assert brier_scores([row("a", "a", confidence=1.0)])[0].score == 0.0


def test_the_page_names_its_window_and_every_case_that_went_wrong(tmp_path: Path):
    rows = [row("none", "none", confidence=0.9), row("a", "b", seed=8, nuisances=(HUM,), confidence=0.8)]
    page = write_field_page(rows, tmp_path, "./spool study field").read_text("utf-8")
    assert "window **report**" in page
    assert "| 8 | a | false | b | 0.80 |" in page
    assert "hum (spool 0.2 m/s^2)" in page
    assert (tmp_path / PICTURE).stat().st_size > 1000
    others = field_parts([row("none", "none", window="check")])[1]
    assert "**check**" in others
    assert "no choice has seen" in others


def test_a_study_goes_on_where_it_was_ended(tmp_path: Path, monkeypatch):
    rows = [row("a", "a", seed=seed, nuisances=(HUM,), found={"a.x": (1.0, None)}) for seed in (5, 6)]
    monkeypatch.setattr(workers, "suite_version", lambda: "1.0 (commit ab)")
    monkeypatch.setattr(study, "judge_field_seed", lambda seed, **_: looked.append(seed) or rows[seed - 5])
    looked: list[int] = []
    study.run(1, 5, tmp_path, 1)
    kept = (tmp_path / study.ROWS).read_text("utf-8")
    (tmp_path / study.ROWS).write_text(kept + kept[:30], "utf-8")
    for _ in range(2):
        assert study.run(2, 5, tmp_path, 1) == rows
    assert looked == [5, 6]
    assert "2 cases" in (tmp_path / PAGE).read_text("utf-8")


def test_rows_with_a_diagnosis_are_kept_apart_and_have_a_page(tmp_path: Path, monkeypatch):
    wrong = row("a", "none", seed=5, diagnosis=Diagnosis(NEVER, 812.3, "a"))
    monkeypatch.setattr(workers, "suite_version", lambda: "1.0 (commit ab)")
    monkeypatch.setattr(study, "judge_field_seed", lambda seed, **_: looked.append(seed) or wrong)
    looked: list[int] = []
    for _ in range(2):
        assert study.run(1, 5, tmp_path, 1, diagnosing=True) == [wrong]
    assert looked == [5]
    assert not (tmp_path / study.ROWS).exists()
    assert "1 of 1 verdicts are wrong" in (tmp_path / DIAGNOSES).read_text("utf-8")


@pytest.mark.parametrize("version", ["1.1 (commit cd)", "1.0 (commit ab+)"])
def test_rows_of_another_or_a_changed_version_are_made_again(
    tmp_path: Path, monkeypatch, version: str, capsys
):
    monkeypatch.setattr(
        study, "judge_field_seed", lambda seed, **_: looked.append(seed) or row("a", "a", seed=5)
    )
    looked: list[int] = []
    for one in ("1.0 (commit ab)", version, version):
        monkeypatch.setattr(workers, "suite_version", lambda one=one: one)
        study.run(1, 5, tmp_path, 1)
    assert looked == ([5, 5] if version.startswith("1.1") else [5, 5, 5])
    assert "1 rows are of another version" in capsys.readouterr().out


def test_a_record_with_nothing_hidden_and_no_nuisance_lacks_nothing(monkeypatch):
    """One law is tried: slow tests try all."""
    monkeypatch.setattr(analyse, "tried_effects", lambda _base: ["coulomb_friction"])
    found = study.judge_field(make_field(33, "none", ()))
    assert (found.verdict, found.outcome, found.question) == ("none", RIGHT, NOTHING)
    assert found.confidence > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "hidden", "nuisances"),
    [
        (33, "none", ()),
        (158, "none", ("hum", "quantisation")),
        (33, "coulomb_friction", ("hum",)),
        (135, "spring_preload", ("bias_drift", "coloured_noise")),
    ],
)
def test_what_a_measuring_chain_does_is_no_force(seed, hidden, nuisances):
    found = study.judge_field(make_field(seed, hidden, nuisances))
    assert found.outcome in (RIGHT, OVER_CAUTIOUS), found.verdict


def test_empty_cells_end_in_a_row_that_says_why():
    """A record that is refused is no verdict, neither right nor false."""
    case = make_field(33, nuisances=("missing_samples",))
    assert [one.id for one in case.nuisances if one.id == "missing_samples"]
    found = study.field_row(case, {"verdict": "refused"}, (1.0, 1.0), "spool_m_s2 is empty")
    assert found.outcome == NO_VERDICT
    assert "spool_m_s2 is empty" in "\n".join(field_parts([found]))
