"""Studies and benchmarks: how they count, what their pages say, and what they refuse."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from scipy.stats import binom
from spool_core.errors import InputError
from spool_evaluation.bench import run_bench
from spool_evaluation.results.page import Proportion, interval, write_page
from spool_evaluation.results.stale import ROOT, ages
from spool_evaluation.studies.workers import spread
from spool_tools.cli import main


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


def test_work_is_spread_over_processes_and_all_of_it_comes_back():
    assert sorted(spread(abs, [-3, 1, -2], "numbers", 2)) == [1, 2, 3]


@pytest.mark.parametrize(
    ("words", "named"),
    [("study nothing", "field"), ("study field --cases 0", "--cases"), ("study field --seed -1", "--seed"),
     ("study field --workers 0", "--workers"), ("bench nothing", "estimate"),
     ("bench sim --seed 1", "--seed"), ("bench gap --cases 0", "--cases")],
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
    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(InputError, match="bench gap: pysindy is not installed"):
        run_bench("gap", None)


def test_a_result_page_says_when_and_by_what_it_was_made(tmp_path: Path):
    page = write_page(
        tmp_path / "page.md", "Title", "./spool study field --cases 1 --seed 2 --out DIR", ["text"]
    )
    title, made, depends, text = page.read_text(encoding="utf-8").strip().split("\n\n")
    assert (title, text) == ("# Title", "text")
    assert {"spool_gap", "spool_estimator", "spool_sim"} <= set(re.findall(r"`(\w+)`", depends))
    assert re.fullmatch(r"Made on \d{4}-\d\d-\d\d by `./spool study field .+`, version 0.1.0.*\.", made)


def test_a_result_page_is_stale_once_a_third_of_the_code_that_it_measured_is_newer(tmp_path: Path) -> None:
    made = "# Title\n\nMade on {} by `./spool bench sim --markdown FILE`, version 0.1.0 (commit {}).\n"
    words = ["git", "rev-list", "--max-parents=0", "HEAD"]
    first = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()[-1]
    (tmp_path / "old.md").write_text(made.format("2026-11-23", first), "utf-8")
    (tmp_path / "new.md").write_text(
        made.format("2037-12-31", "0123456789ab"), "utf-8"
    )  # the last commit of that day
    (tmp_path / "before.md").write_text(made.format("1999-12-31", "0123456789ab"), "utf-8")
    lost = made.replace("bench sim --markdown FILE", "python lost.py")  # a script that is not here
    (tmp_path / "lost.md").write_text(lost.format("2026-11-30", first), "utf-8")
    (tmp_path / "other.md").write_text("# No results\n", "utf-8")
    found = {one.page: one for one in ages(tmp_path)}
    assert {name for name, one in found.items() if one.share > 1 / 3} == {"old.md", "before.md", "lost.md"}
    assert "new.md" not in found or found["new.md"].share < 0.1  # what is not committed yet
    assert str(found["before.md"]).startswith("stale: before.md, made 1999-12-31; 100.0% of the lines")
