"""The peer of the gap workflow in the benchmarks gets a fair chance."""

from rich.console import Console
from spool_blind.case import make
from spool_bringup.bench import table_of
from spool_bringup.benchmarks.gap import seeds
from spool_bringup.benchmarks.gap_peer import library, named
from spool_bringup.benchmarks.timing import Timing
from spool_bringup.studies.gap import given


def test_pysindy_finds_a_hardening_spring_from_the_library():
    case = make(6, "cubic_stiffness")
    found = library(*given(case))
    assert set(found.owners) > {"base", "cubic_stiffness", "coulomb_friction"}
    assert "cubic_stiffness" in named(found, ensemble=False)


def test_the_records_hide_only_what_a_library_can_hold():
    chosen = seeds(8)
    assert len(set(chosen)) == 8
    assert min(chosen) >= 1000


def test_errors_are_shown_where_there_are_any():
    timed, judged = Timing("a", "b", 1.0, 2.0), Timing("c", "d", 1.0, 2.0, 0.125, 0.5)
    console = Console(width=140, record=True)
    console.print(table_of([timed, judged]))
    console.print(table_of([timed]))
    both, alone = console.export_text().split("work ")[1:]
    assert "their error" in both
    assert "0.125" in both
    assert "error" not in alone
