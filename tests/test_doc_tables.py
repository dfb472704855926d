"""Documentation: a table is a dated result of a command or explains, and every link leads somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from spool_blind.field.case import Importance
from spool_core.record_limits import limits_table
from spool_evaluation.bench import markdown_of
from spool_evaluation.results.timing import Timing
from spool_evaluation.studies.estimation import LIMITS, Estimated, RecordFit
from spool_evaluation.studies.estimation import page_parts as estimation_parts
from spool_evaluation.studies.field.study import field_parts
from spool_evaluation.studies.field.verdicts import ChainFault, FieldVerdict

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
RESULTS = DOCS / "results"
HEADER = re.compile(r"^\|(.+)\|\n\| *:?-", re.M)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
#: A file of Python or a folder, as a page names it; and one that a recipe of CONTRIBUTING.md writes.
NAMED = re.compile(r"`((?:[\w.-]+/)*[\w-]+\.py|(?:[\w.-]+/)+)`(?!:\n\n```python)")
MADE = re.compile(
    r"# .+\n\nMade on \d{4}-\d\d-\d\d by "
    r"`(\./spool (bench|study|python) [^`]+|SPOOL_\w+=\d+ \.ci/nightly( --weekly)?)`, version .+\.\n"
)
PAGES = [
    ROOT / "README.md",
    ROOT / "bags" / "README.md",
    *DOCS.rglob("*.md"),
    *ROOT.glob("ros2_ws/*/spool_*/**/README.md"),
    *ROOT.glob("research/*/README.md"),
]
#: Tables elsewhere define or explain: names, meanings, settings, sources. Nothing in them was measured.
EXPLAINING = {
    "operator.md": [("urgency", "what to do"), ("act", "when")],
    "alarms.md": [
        ("state", "raised"),
        ("kind", "number"),
        ("number", "title"),
        ("event", "on-delay"),
        ("name", "one for"),
        ("while this is active", "these are not judged"),
        ("figure", "limit by default"),
        ("where", "how to choose"),
        ("where", "what it shows"),
        ("file", "holds"),
        ("field", "content"),
        ("rule", "with our nodes"),
    ],
    "metrics.md": [("metric", "labels")],
    "architecture.md": [("package", "job"), ("topic", "offered")],
    "evidence.md": [("the model is", "cause"), ("the missing force looks like", "cause")],
    "commissioning.md": [("`replay` reports", "meaning and action")],
    "fleet.md": [("`--analysis`", "gives"), ("table", "columns")],
    "what_if.md": [("option", "changes"), ("option", "excitation")],
    "fmu.md": [("name", "causality"), ("program", "tried")],
    "orders.md": [("where", "name"), ("key", "meaning"), ("remark", "reason")],
    "recording.md": [("fault", "what the recorder keeps")],
    "gap.md": [("verdict",), ("problem", "what happens"), ("nuisance", "how it is detected")],
    "measure.md": [("matter", "what to choose"), ("question", "excitation"), ("report", "condition")],
    "glossary.md": [("term", "meaning")],
    "index.md": [("you want to", "page")],
    "laptop.md": [("extra", "adds"), ("system", "what was done")],
    "python.md": [("question", "where"), ("call", "gives"), ("name", "number")],
    "setups.md": [("key of `known`", "unit")],
    "watch.md": [("state", "meaning")],
    "strokes.md": [("where", "what"), ("quantity", "what"), ("what", "found")],
    "methods/estimation.md": [("question", "answer")],
    "methods/gap.md": [("in `result.json`", "rule"), ("limit", "value")],
    "methods/monitoring.md": [
        ("detector", "what it judges"),
        ("to change", "parameter of the monitor"),
        ("error of a change", "standard deviation"),
        ("what moved", "cause"),
    ],
    "methods/physics.md": [
        ("model", "equation"),
        ("where", "the print"),
        ("oil", "40 deg C"),
        ("parameter", "unit"),
    ],
}


def headers(text: str) -> list[tuple[str, ...]]:
    """Return the names of the columns of each table."""
    return [_names(match.group(1)) for match in HEADER.finditer(text)]


def _names(line: str) -> tuple[str, ...]:
    return tuple(cell.strip() for cell in line.strip().strip("|").split("|"))


def result(name: str) -> str:
    return (RESULTS / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", sorted(RESULTS.glob("*.md")), ids=lambda path: path.name)
def test_a_result_page_says_when_and_by_what_it_was_made(page: Path) -> None:
    assert MADE.match(page.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", sorted(set(DOCS.rglob("*.md")) - set(RESULTS.glob("*.md"))), ids=str)
def test_tables_elsewhere_only_explain(page: Path) -> None:
    known = EXPLAINING.get(str(page.relative_to(DOCS)), [])
    measured = [names for names in headers(page.read_text(encoding="utf-8")) if names[:2] not in known]
    assert measured == []


def test_the_method_page_of_the_gap_holds_the_limits_that_decide() -> None:
    assert limits_table() in (DOCS / "methods" / "gap.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    links = LINK.findall(page.read_text(encoding="utf-8"))
    assert [link for link in links if "://" not in link and not (page.parent / link).exists()] == []


@pytest.fixture(scope="module", name="sources")
def _sources() -> str:
    """The paths of all folders and files of the sources, a line each."""
    folders = ".ci bags docs requirements research ros2_ws/src ros2_ws/addons setup tests"
    top = [ROOT / name for name in folders.split()]
    found = [path for folder in top for path in (folder, *folder.rglob("*"))]
    return "".join(f"/{path.relative_to(ROOT)}{'/' * path.is_dir()}\n" for path in found)


@pytest.mark.parametrize(
    "page",
    [page for page in [ROOT / "CONTRIBUTING.md", *PAGES] if page.parent != RESULTS],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_files_and_folders_that_a_page_names_exist(page: Path, sources: str) -> None:
    """Words in capitals, as in `terms/NAME.py`, and names that begin with _ stand for others."""
    names = NAMED.findall(page.read_text(encoding="utf-8"))
    definite = [name for name in names if not re.search(r"[A-Z]{2}|^_", name)]
    assert [name for name in definite if f"/{name}\n" not in sources] == []


def field_row(hidden: str, verdict: str) -> FieldVerdict:
    kind = "none" if hidden == "none" else "effect"
    shares = {} if hidden == "none" else {hidden: Importance(0.1, 0.1, 100.0, 10.0)}
    hum = (ChainFault("hum", "spool", 0.2, "m/s^2"),)
    known = {"truth": {"end_stop.gap": 1.0}, "found": {"end_stop.gap": (1.0, 0.1)}, "confidence": 0.9}
    return FieldVerdict(
        seed=1, window="report", kind=kind, hidden=hidden, accepted=(hidden,), importance=shares,
        nuisances=hum, verdict=verdict, **known,
    )  # fmt: skip


def test_result_pages_have_the_columns_that_their_commands_write() -> None:
    told = Estimated("fluid", "spring_stiffness", "N/m", 1632.0, 1632.1, 0.2)
    fitted = RecordFit(1, "fluid", "soft", "HL68", "sweep", 0.01, (told,), (), None, True, 0.01, 3.5)
    compiled = markdown_of([Timing("a", "b", 1.0, 2.0, 1.0, 1.0, compiling=1.0)])
    judged = markdown_of([Timing("a", "b", 1.0, 2.0, 1.0, 1.0)])
    wanted = {
        "field_study.md": "\n\n".join(
            field_parts([field_row("end_stop", "end_stop"), field_row("none", "x")])
        ),
        "estimation_study.md": "\n\n".join(estimation_parts([fitted], [told])),
        "bench_sim.md": compiled,
        "bench_estimate.md": judged,
        "bench_gap.md": judged,
    }
    for name, text in wanted.items():
        assert headers(result(name)) == headers(text)
    # What limits the proof is part of the page, not of its last edit.
    assert LIMITS in wanted["estimation_study.md"]
    assert LIMITS in result("estimation_study.md")
