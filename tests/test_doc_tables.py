"""Every table of the documentation says which command made it, or is no measurement."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from spool_evaluation.bench import markdown_of
from spool_evaluation.monitor_cases.run import ScenarioOutcome
from spool_evaluation.monitor_cases.table import table
from spool_evaluation.results.timing import Timing
from spool_evaluation.studies import records, steps
from spool_evaluation.studies.estimation import run as run_estimation
from spool_evaluation.studies.gap_limit_page import page_parts
from spool_evaluation.studies.gap_limit_summary import DetectionLimit, sentence, within
from spool_evaluation.studies.gap_page import write_study
from spool_evaluation.studies.gap_summary import BlindVerdict

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
HEADER = re.compile(r"^\|(.+)\|\n\| *:?-", re.M)

#: Measured tables by page: the command that must stand above, as many times as there are tables of it.
MADE = {
    "benchmarks.md": [
        "./spool bench sim",
        "./spool bench estimate",
        "./spool bench gap",
        "./spool bench monitor",
    ],
    "estimation.md": ["./spool study records"],
    "estimation_study.md": ["./spool study estimation"],
    "gap_limits.md": ["./spool study gap-limit"],
    "gap_study.md": ["./spool study gap"] * 4,
    "monitoring.md": ["./spool study monitor"],
    "physics.md": ["./spool study steps"],
}
#: Tables that define or explain: names, meanings, settings, sources. Nothing in them was measured.
EXPLAINING = {
    "alarms.md": [("kind", "number"), ("number", "what it means"), ("file", "holds")],
    "architecture.md": [("package", "job"), ("topic", "offered")],
    "estimation.md": [("question", "answer")],
    "gap.md": [("verdict",), ("matter", "what happens")],
    "monitoring.md": [("detector", "what it judges"), ("what moved", "cause")],
    "physics.md": [("model", "equation"), ("where", "the print"), ("oil", "40 deg C"), ("parameter", "unit")],
}


def headers(text: str) -> list[tuple[int, tuple[str, ...]]]:
    """Return where each table begins and the names of its columns."""
    return [(match.start(), _names(match.group(1))) for match in HEADER.finditer(text)]


def _names(line: str) -> tuple[str, ...]:
    return tuple(cell.strip() for cell in line.strip().strip("|").split("|"))


def measured(page: str) -> list[tuple[int, tuple[str, ...]]]:
    """Return the tables of ``page`` that do not only explain."""
    known = EXPLAINING.get(page, [])
    return [
        entry for entry in headers((DOCS / page).read_text(encoding="utf-8")) if entry[1][:2] not in known
    ]


def only_header(text: str) -> tuple[str, ...]:
    return headers(text)[0][1]


@pytest.mark.parametrize("page", sorted(path.name for path in DOCS.glob("*.md")))
def test_above_each_measured_table_stands_the_command_that_made_it(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    wanted = MADE.get(page, [])
    found = measured(page)
    assert len(found) == len(wanted), [names for _, names in found]
    for (place, _), command in zip(found, wanted, strict=True):
        assert f"{command} " in text[:place]


def test_the_tables_have_the_columns_that_their_commands_write(tmp_path: Path) -> None:
    known = {"truth": {"a.x": 1.0}, "found": {"a.x": 1.0}, "before": 0.1, "after": 0.01, "floor": 0.01}
    case = {"kind": "effect", "hidden": "end_stop", "accepted": ("end_stop",), "factor": 1.0}
    row, other = (
        BlindVerdict(seed=1, verdict="end_stop", **case, **known),
        BlindVerdict(seed=2, verdict="none", **case),
    )
    study = write_study([row, other], tmp_path, "x").read_text(encoding="utf-8")
    limit = DetectionLimit("coulomb_friction", 1, "coulomb_force", 0.001, 0.002, 2.0)
    wanted = {
        "gap_study.md": [names for _, names in headers(study)],
        "gap_limits.md": [only_header(page_parts([limit])[-1])],
        "monitoring.md": [only_header(table([ScenarioOutcome("healthy", 1, 60.0, (), (), ())]))],
        "physics.md": [only_header(steps.table({}))],
        "estimation.md": [only_header(records.table([]))],
        "benchmarks.md": [
            only_header(markdown_of([Timing("a", "b", 1.0, 2.0, 1.0, 1.0, compiling=1.0)])),
            only_header(markdown_of([Timing("a", "b", 1.0, 2.0, 1.0, 1.0, compiling=1.0)])),
            only_header(markdown_of([Timing("a", "b", 1.0, 2.0, 1.0, 1.0)])),
            only_header(markdown_of([Timing("a", "b", 1.0, 2.0, 1.0, 1.0)])),
        ],
    }
    for page, expected in wanted.items():
        assert [names for _, names in measured(page)] == expected


def test_the_study_of_the_estimates_writes_the_table_of_its_page(tmp_path: Path) -> None:
    run_estimation(1, 7, tmp_path, 1)
    written = (tmp_path / "estimation_study.md").read_text(encoding="utf-8")
    assert [only_header(written)] == [names for _, names in measured("estimation_study.md")]
    # The sentence that limits what the table proves is part of the page, not of its last edit.
    for text in (written, (DOCS / "estimation_study.md").read_text(encoding="utf-8")):
        assert "truth and fit share one simulator" in " ".join(text.split())


def test_the_fits_of_the_sample_records_are_those_of_the_page(tmp_path: Path, monkeypatch) -> None:
    """The last digits may differ between machines, by a tenth of a standard deviation at most."""
    monkeypatch.chdir(ROOT)
    page = (DOCS / "estimation.md").read_text(encoding="utf-8")
    printed = {_names(line)[:3]: _names(line) for line in page.splitlines() if line.startswith("| `practice")}
    assert len(printed) == sum(3 if sample.model == "coulomb" else 2 for sample in records.SAMPLES)
    for row in records.run(1, 0, tmp_path, 1):
        cells = printed[f"`{row.bag}`", row.model, row.parameter]
        assert float(cells[4]) == pytest.approx(row.value, abs=0.1 * row.deviation)
        assert float(cells[5]) == pytest.approx(row.deviation, rel=0.1)
        assert float(cells[6]) == pytest.approx(row.score, abs=0.2)


def test_the_truth_of_the_sample_records_is_what_made_them() -> None:
    text = (ROOT / "bags" / "README.md").read_text(encoding="utf-8")
    rows = {_names(line)[0].strip("`"): _names(line) for line in text.splitlines() if line.startswith("| `")}
    for sample in records.SAMPLES:
        cells = [cell.split()[0].replace("none", "0") for cell in rows[sample.bag][2:5]]
        assert list(sample.truth.values()) == [float(cell) for cell in cells]


def test_the_errors_of_a_time_step_are_those_of_the_page(tmp_path: Path) -> None:
    page = (DOCS / "physics.md").read_text(encoding="utf-8")
    found = steps.run(2, 0, tmp_path, 1)
    for name, errors in found.items():
        line = next(line for line in page.splitlines() if line.startswith(f"| `{name}` | ") and "e-" in line)
        printed = [float(cell) for cell in _names(line)[1:-1]]
        assert printed == pytest.approx(errors[: len(printed)], rel=0.1)
    assert (tmp_path / "convergence.png").stat().st_size > 1000


def test_how_many_effects_reach_the_limit_follows_from_the_table_below() -> None:
    text = (DOCS / "gap_limits.md").read_text(encoding="utf-8")
    place, names = measured("gap_limits.md")[0]
    ratios = [_names(line)[names.index("ratio")] for line in text[place:].splitlines()[2:] if line]
    limits = [
        DetectionLimit("any", number, "x", 1.0, 1.0, None if ratio == "-" else float(ratio))
        for number, ratio in enumerate(ratios)
    ]
    met = sum(within([limit]) for limit in limits)
    assert sentence(met, len(limits)) in text
