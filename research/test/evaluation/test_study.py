"""Blind study: how it counts, and what its pages say."""

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from scipy.stats import binom
from spool_blind.case import limit_case, make
from spool_core.errors import InputError
from spool_evaluation.bench import run_bench
from spool_evaluation.results.page import Proportion, interval, write_page
from spool_evaluation.results.stale import ROOT, ages
from spool_evaluation.studies import gap_limit, workers
from spool_evaluation.studies.gap import (
    PICTURE,
    BlindVerdict,
    confusion,
    row_of,
    summary,
    targets,
    write_study,
)
from spool_evaluation.studies.gap_limit import STEP, DetectionLimit, page_parts, run, smallest_named, within
from spool_evaluation.studies.workers import spread
from spool_tools.cli import main


def row(kind: str, hidden: str, verdict: str, **given: object) -> BlindVerdict:
    return BlindVerdict(
        seed=1, kind=kind, hidden=hidden, accepted=(hidden,), factor=1.0, verdict=verdict, **given
    )


@pytest.mark.parametrize(
    ("kind", "hidden", "verdict", "right"),
    [
        ("none", "none", "none", True),
        ("none", "none", "coulomb_friction", False),
        ("none", "none", "unexplained", False),
        ("effect", "end_stop", "end_stop", True),
        ("effect", "end_stop", "end_stop+coulomb_friction", False),
        ("effect", "end_stop", "refused", False),
        ("pair", "a+b", "b+a", True),
        ("pair", "a+b", "a", False),
        ("out_of_catalogue", "lugre_friction", "unexplained", True),
        ("out_of_catalogue", "lugre_friction", "stribeck_friction", False),
    ],
)
def test_a_verdict_is_right_only_if_it_is_the_whole_truth(kind, hidden, verdict, right):
    assert row(kind, hidden, verdict).right is right


def test_shares_carry_wilsons_interval():
    low, high = Proportion(98, 100).interval
    assert (low, high) == pytest.approx((0.9300, 0.9945), abs=5e-4)
    assert Proportion(0, 40).interval[1] == pytest.approx(0.0876, abs=5e-4)
    assert Proportion(0, 0).value is None


def test_exact_intervals_are_those_of_clopper_and_pearson():
    """By the distribution of the count: at either bound the count found, or a more extreme one, has 2.5 %."""
    low, high = interval(37, 40, "exact")
    assert binom.sf(36, 40, low) == pytest.approx(0.025)
    assert binom.cdf(37, 40, high) == pytest.approx(0.025)
    assert interval(0, 4, "exact")[0] == 0.0
    assert interval(4, 4, "exact")[1] == 1.0
    assert interval(0, 0, "exact") == (0.0, 1.0)


def test_targets_are_met_only_by_what_was_found():
    good = [row("effect", "a", "a", truth={"a.x": 2.0}, found={"a.x": (2.1, 0.1)}, after=0.012, floor=0.01)]
    bad = [row("effect", "a", "b"), row("none", "none", "a"), row("out_of_catalogue", "s", "a")]
    assert all(target.met for target in targets(good) if target.share.of)
    assert {target.answer for target in targets(good) if not target.share.of} == {"unknown"}
    met = {target.name: target.met for target in targets(good + bad)}
    assert not met["one effect, named right"]
    assert not met["nothing hidden, a false name"]
    assert not met["out-of-catalogue effects not given a name alone"]
    assert met["parameters within 10 %"]


def test_every_case_is_in_the_confusion_matrix_once(tmp_path: Path):
    rows = [
        row("none", "none", "none"),
        row("effect", "end_stop", "cubic_stiffness"),
        row("pair", "a+b", "b+a"),
        row("pair", "a+b", "b"),
        row("out_of_catalogue", "lugre_friction", "unexplained"),
        row("effect", "end_stop", "refused", message="too short"),
    ]
    hidden, verdicts, counts = confusion(rows)
    assert counts.sum() == len(rows)
    assert counts[hidden.index("pair"), verdicts.index("right pair")] == 1
    assert counts[hidden.index("end_stop"), verdicts.index("refused")] == 1
    page = write_study(rows, tmp_path, "./spool study gap").read_text("utf-8")
    assert "too short" in page
    assert (tmp_path / PICTURE).stat().st_size > 1000
    assert summary(rows, targets(rows))["cases"] == len(rows)


def test_parameters_are_held_against_the_truth_under_the_names_of_the_catalogue():
    case = make(13, "sensor_saturation")
    limit = case.truth["sensor_saturation"]["full_scale"]
    found = {"id": "sensor_saturation", "parameters": {"saturation_limit": {"value": 1.02 * limit}}}
    judged = row_of(case, {"verdict": "sensor_saturation", "effects": [found]}, (1.0, 0.5))
    assert judged.right
    assert judged.errors == pytest.approx({"sensor_saturation.saturation_limit": 0.02})


def test_the_limit_counts_conditions_where_nothing_was_named():
    limits = [
        DetectionLimit("coulomb_friction", seed, "coulomb_force", 0.001, named, ratio)
        for seed, named, ratio in ((1, 0.004, 4.0), (2, 0.008, 8.0), (3, None, None))
    ]
    line = next(line for line in page_parts(limits)[-1].splitlines() if "coulomb_friction" in line)
    assert "| 0.001 | 0.008 | 8 | 2/3 |" in line


def test_a_ratio_of_two_steps_of_half_an_octave_is_two():
    """Two, times a rounding of the root of 2, meets a target of 2; half an octave more does not."""
    twice, more = STEP**2, STEP**3
    assert within([DetectionLimit("coulomb_friction", 1, "coulomb_force", 0.001, 0.001 * twice, twice)])
    assert not within([DetectionLimit("coulomb_friction", 1, "coulomb_force", 0.001, 0.001 * more, more)])


def test_the_smallest_size_is_found_by_few_looks(monkeypatch):
    """Named from twice the square root of two on; of 16 sizes few are tried."""
    looked = []

    def judged(case, least_share):
        assert least_share == 0.0
        looked.append(case.factor)
        return SimpleNamespace(right=case.factor > 2.5 * looked[0] / 2.0)

    monkeypatch.setattr(gap_limit, "judge", judged)
    limit = smallest_named(("coulomb_friction", 7))
    assert limit.ratio == pytest.approx(2.0 * 2.0**0.5)
    assert limit.named == pytest.approx(limit.ratio * limit.visible)
    assert len(looked) <= 5


def test_a_search_for_limits_goes_on_where_it_was_ended(tmp_path, monkeypatch):
    rows = [DetectionLimit("coulomb_friction", 5, "coulomb_force", 0.001, 0.002, 2.0)]
    rows.append(DetectionLimit("coulomb_friction", 6, "coulomb_force", 0.002, 0.003, 1.5))
    monkeypatch.setattr(workers, "suite_version", lambda: "1.0 (commit ab)")
    monkeypatch.setattr(gap_limit, "smallest_named", lambda item: looked.append(item) or rows[item[1] - 5])
    looked = []
    for cases in (1, 2, 2):  # also where its files are there already
        assert run(cases, 5, tmp_path, 1, ["coulomb_friction"]) == rows[:cases]
    assert looked == [("coulomb_friction", 5), ("coulomb_friction", 6)]
    assert (tmp_path / "gap_limits.png").stat().st_size > 1000
    assert "1 of 1 effects are named" in (tmp_path / "gap_limits.md").read_text("utf-8")


def test_a_likelihood_ratio_test_sees_half_at_the_limit():
    case = limit_case(7, "coulomb_friction", moderate=True)
    assert case.visibility.evidence == pytest.approx(case.threshold, rel=0.15)
    larger = make(7, "coulomb_friction", factor=2.0 * case.factor, moderate=True)
    assert larger.visibility.evidence == pytest.approx(4.0 * case.visibility.evidence, rel=0.2)
    assert 15.0 <= case.time[-1] <= 20.0


def test_work_is_spread_over_processes_and_all_of_it_comes_back():
    assert sorted(spread(abs, [-3, 1, -2], "numbers", 2)) == [1, 2, 3]


@pytest.mark.parametrize(
    ("words", "named"),
    [("study nothing", "gap-limit"), ("study gap --cases 0", "--cases"), ("study gap --seed -1", "--seed"),
     ("study gap --workers 0", "--workers"), ("bench nothing", "estimate"), ("bench sim --seed 1", "--seed"),
     ("bench gap --cases 0", "--cases")],
)  # fmt: skip
def test_what_cannot_be_run_is_refused_by_name(words, named, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")] if words.startswith("study") else []
    assert main([*words.split(), *out]) == 2
    said = capsys.readouterr().err
    assert named in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_benchmark_names_the_peer_that_is_not_installed(monkeypatch):
    """A machine without peers lacks their benchmarks, and nothing else."""
    monkeypatch.setitem(sys.modules, "river", None)
    with pytest.raises(InputError, match="bench monitor: river is not installed"):
        run_bench("monitor", None)


def test_a_result_page_says_when_and_by_what_it_was_made(tmp_path: Path):
    page = write_page(
        tmp_path / "page.md", "Title", "./spool study gap --cases 1 --seed 2 --out DIR", ["text"]
    )
    title, made, depends, text = page.read_text(encoding="utf-8").strip().split("\n\n")
    assert (title, text) == ("# Title", "text")
    assert {"spool_gap", "spool_estimator", "spool_sim"} <= set(re.findall(r"`(\w+)`", depends))
    assert re.fullmatch(r"Made on \d{4}-\d\d-\d\d by `./spool study gap .+`, version 0.1.0.*\.", made)


def test_a_result_page_is_stale_once_a_third_of_the_code_that_it_measured_is_newer(tmp_path: Path) -> None:
    made = "# Title\n\nMade on {} by `./spool bench sim --markdown FILE`, version 0.1.0 (commit {}).\n"
    words = ["git", "rev-list", "--max-parents=0", "HEAD"]
    first = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()[-1]
    (tmp_path / "old.md").write_text(made.format("2026-11-23", first), "utf-8")
    (tmp_path / "new.md").write_text(
        made.format("2037-12-31", "0123456789ab"), "utf-8"
    )  # the last commit of that day
    (tmp_path / "before.md").write_text(made.format("1999-12-31", "0123456789ab"), "utf-8")
    (tmp_path / "other.md").write_text("# No results\n", "utf-8")
    found = {one.page: one for one in ages(tmp_path)}
    assert {name for name, one in found.items() if one.share > 1 / 3} == {"old.md", "before.md"}
    assert "new.md" not in found or found["new.md"].share < 0.1  # what is not committed yet
    assert str(found["before.md"]).startswith("stale: before.md, made 1999-12-31; 100.0% of the lines")
