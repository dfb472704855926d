"""Store of a fleet: what is damaged is reported, runs go on where they ended, same bags give same bytes."""

from __future__ import annotations

import hashlib
import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
import spool_fleet
from spool_core.errors import InputError
from spool_fleet import execution, parquet
from spool_fleet.analyses import ANALYSES, chosen
from spool_fleet.execution import Done, ProcessPool, Task, run_task
from spool_fleet.manifest import Manifest, Rows
from spool_fleet.operations import add_service, add_to_store, answer, run_over_store
from spool_fleet.parquet import RECORD_TABLES, REFERRED, rows_in_tables
from spool_report.outputs import suite_version, write_json

PATTERN = "{machine}/{date}/{valve}"


def tables_of(store: Path) -> dict[str, str]:
    """Return the hash of each file of the tables."""
    folder = store / "tables"
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*.parquet"))
    }


@pytest.fixture(scope="session")
def store(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Store of the recordings, analysed by one process."""
    made = tmp_path_factory.mktemp("fleet") / "store"
    add_to_store(made, [recordings], PATTERN, None, "", 1)
    run_over_store(made, "monitor,features", 1, None)
    return made


def test_bags_are_named_by_their_paths(store: Path) -> None:
    rows = spool_fleet.table(store, "SELECT machine, valve, start, duration_s, rate_Hz FROM bags").to_pylist()
    assert {(row["machine"], row["valve"]) for row in rows} == {
        (machine, valve) for machine in ("press_1", "press_2") for valve in ("valve_1", "valve_2")
    }
    assert {str(row["start"].date()) for row in rows} == {"2026-03-02", "2026-04-06"}
    assert {(row["duration_s"], row["rate_Hz"]) for row in rows} == {(8.0, 1000.0)}


#: SQL of one value, and what JSON holds of it.
ANSWERS: dict[str, object] = {
    "sum(1)": 1,
    "sum(1.25::DECIMAL(9, 2))": 1.25,
    "avg(3)": 3.0,
    "count(*)": 1,
    "12345678901234567890123::HUGEINT": 12345678901234567890123,
    "255::UTINYINT": 255,
    "'nan'::DOUBLE": None,
    "'-inf'::FLOAT": None,
    "NULL::DECIMAL(9, 2)": None,
    "true": True,
    "'b'::ENUM('a', 'b')": "b",
    "'5d2c4d3e-7c6f-4a0b-9d55-0d6f0f3b7c11'::UUID": "5d2c4d3e-7c6f-4a0b-9d55-0d6f0f3b7c11",
    "TIMESTAMP '2026-03-02 01:02:03.5'": "2026-03-02T01:02:03.500000",
    "TIMESTAMPTZ '2026-03-02 01:02:03+02'": "2026-03-01T23:02:03+00:00",
    "TIMESTAMP_NS '2026-03-02 01:02:03.123456789'": "2026-03-02T01:02:03.123456789",
    "TIMESTAMP 'infinity'": None,
    "DATE '2026-03-02'": "2026-03-02",
    "DATE '-infinity'": None,
    "TIME '01:02:03'": "01:02:03",
    "TIMETZ '01:02:03+02'": "01:02:03+02",
    "INTERVAL '1 day 2 hours 3 milliseconds'": 93600.003,
    "INTERVAL '2 months'": "P2MT0S",
    "TIMESTAMP '2026-03-02' - TIMESTAMP '2026-03-01 12:00:00'": 43200.0,
    "'ab\\x00'::BLOB": "616200",
    "'101'::BIT": "101",
    "[1.5::DECIMAL(3, 1), NULL]": [1.5, None],
    "[1, 2]::INTEGER[2]": [1, 2],
    "[INTERVAL '1 hour']": [3600.0],
    "{'a': 1, 'b': [DATE '2026-03-02'], 'c': 'nan'::DOUBLE}": {"a": 1, "b": ["2026-03-02"], "c": None},
    "MAP {'k': 1.5::DECIMAL(3, 1)}": {"k": 1.5},
    "MAP {2.5: [1]}": {"2.5": [1]},
    "MAP([], [])": {},
    "union_value(k := DATE '2026-03-02')": "2026-03-02",
}


@pytest.mark.parametrize("sql", ANSWERS)
def test_a_value_of_each_sql_type_becomes_json(sql: str, tmp_path: Path) -> None:
    (tmp_path / "tables").mkdir()
    rows = answer(tmp_path, f"SELECT {sql} AS one, 7 AS one", None, "", "", "")
    write_json(tmp_path / "rows.json", rows)
    assert json.loads((tmp_path / "rows.json").read_text("utf-8")) == [{"one": ANSWERS[sql], "one_2": 7}]


def test_parameters_are_the_truth_at_one_oil_temperature(store: Path) -> None:
    drags = [
        row["value"]
        for row in spool_fleet.table(
            store, f"SELECT value FROM parameters WHERE name = '{REFERRED}'"
        ).to_pylist()
    ]
    raw = [
        row["value"]
        for row in spool_fleet.table(
            store, "SELECT value FROM parameters WHERE name = 'viscous_coefficient'"
        ).to_pylist()
    ]
    assert len(drags) == len(raw) == 8
    # At 36 to 43 deg C drags differ by a fifth; referred to 40 deg C they do not.
    assert max(raw) / min(raw) > 1.2
    assert max(drags) / min(drags) < 1.02


def test_damaged_and_repeated_bags_are_told_and_left_out(recordings: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bags"
    shutil.copytree(recordings / "press_1", folder / "press_1")
    shutil.copytree(folder / "press_1/2026-03-02/valve_1", folder / "press_1/2026-03-02/valve_1_copy")
    broken = folder / "press_1/2026-04-06/valve_1/valve_1_0.mcap"
    broken.write_bytes(broken.read_bytes()[:30_000])
    empty = folder / "press_1/2026-04-06/empty"
    empty.mkdir()
    (empty / "metadata.yaml").write_text("nothing", encoding="utf-8")
    store = tmp_path / "store"
    added = add_to_store(store, [folder], PATTERN, None, "", 1)
    assert (added.new, added.damaged, added.duplicates) == (6, 2, 1)
    told = ("2026-04-06/valve_1", "empty", "valve_1_copy")
    assert all(any(name in line for line in added.told) for name in told)
    result, _ = run_over_store(store, "features", 1, None)
    assert (result.bags, result.failed) == (3, [])
    rows = answer(store, None, "damaged", "", "", "")
    assert sorted(Path(row["bag"]).name for row in rows) == ["empty", "valve_1", "valve_1_copy"]
    assert all(row["reason"] for row in rows)


def test_machines_that_cannot_be_distinguished_are_not_merged(recordings: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bags"
    for machine in ("press_1", "press_2"):
        shutil.copytree(recordings / machine / "2026-03-02", folder / machine / "2026-03")
        shutil.copytree(recordings / machine / "2026-04-06", folder / machine / "april")
    added = add_to_store(tmp_path / "store", [folder], PATTERN, None, "", 1)
    assert (added.new, added.left_out) == (4, 4)
    assert all("'april' is not" in line and "left out" in line for line in added.told)
    run_over_store(tmp_path / "store", "features", 1, None)
    rows = answer(tmp_path / "store", "SELECT machine, valve FROM bags ORDER BY ALL", None, "", "", "")
    assert [(row["machine"], row["valve"]) for row in rows] == [
        (machine, valve) for machine in ("press_1", "press_2") for valve in ("valve_1", "valve_2")
    ]


@pytest.mark.slow
def test_nothing_is_done_twice_and_a_changed_bag_is_done_again(
    recordings: Path, tmp_path: Path, make_bag: Callable[..., Path]
) -> None:
    folder, store = tmp_path / "bags", tmp_path / "store"
    shutil.copytree(recordings / "press_1", folder / "press_1")
    add_to_store(store, [folder], PATTERN, None, "", 1)
    assert run_over_store(store, "features", 1, None)[0].bags == 4
    before = tables_of(store)
    assert add_to_store(store, [folder], PATTERN, None, "", 1).unchanged == 4
    assert run_over_store(store, "features", 1, None)[0].bags == 0
    assert tables_of(store) == before
    bag = folder / "press_1/2026-03-02/valve_1"
    shutil.rmtree(bag)
    make_bag(bag, 77)
    assert add_to_store(store, [folder], PATTERN, None, "", 1).new == 1
    assert run_over_store(store, "features", 1, None)[0].bags == 1
    assert tables_of(store) != before


def test_other_limits_are_another_analysis_of_the_same_bags(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text("/**/estimator: {ros__parameters: {memory: 8.0}}\n", "utf-8")
    again = tmp_path / "store"
    shutil.copytree(store, again)
    # In this process, the first bag alone.
    monkeypatch.setattr(
        ProcessPool, "run", lambda _, work, items: [Done(one, work(one)) for one in items[:1]]
    )
    assert run_over_store(again, "monitor,features", 1, None)[0].bags == 0
    result, lines = run_over_store(again, "monitor,features", 1, None, limits)
    assert (result.bags, result.analyses, result.failed) == (1, 1, [])
    assert lines[0] == f"monitor: limits of {limits}"
    drag = "SELECT bag, value FROM parameters WHERE name = 'viscous_coefficient' ORDER BY bag"
    before, after = (spool_fleet.table(one, drag).to_pylist() for one in (store, again))
    assert [one == other for one, other in zip(before, after, strict=True)].count(False) == 1
    limits.write_text("/**/monitor: {ros__parameters: {coulomb_chang: 0.2}}\n", "utf-8")
    with pytest.raises(InputError, match="coulomb_chang is unknown"):
        run_over_store(again, "features,monitor", 1, None, limits)


@pytest.mark.slow
def test_bags_that_come_later_give_the_same_bytes(recordings: Path, store: Path, tmp_path: Path) -> None:
    later = tmp_path / "store"
    for machine in ("press_2", "press_1"):
        add_to_store(later, [recordings / machine], PATTERN, None, "", 1)
        run_over_store(later, "features", 1, None)
    run_over_store(later, "monitor", 1, None)
    assert tables_of(later) == tables_of(store)


@pytest.mark.parametrize("lost", [None, "bags", "analyses", "parameters", "events", "gaps"])
def test_a_table_that_was_removed_is_made_again(store: Path, tmp_path: Path, lost: str | None) -> None:
    again = tmp_path / "store"
    shutil.copytree(store, again)
    for file in (again / "tables" / (lost or "")).rglob("*.parquet"):
        file.unlink()
    assert run_over_store(again, "monitor,features", 1, None)[0].bags == 0
    assert tables_of(again) == tables_of(store)


def test_a_bag_that_gets_another_name_keeps_its_results(
    recordings: Path, store: Path, tmp_path: Path
) -> None:
    again = tmp_path / "store"
    shutil.copytree(store, again)
    rows = "SELECT bag, name, value FROM parameters ORDER BY ALL"
    before = spool_fleet.table(again, rows).to_pylist()
    table = tmp_path / "bags.csv"
    bag = recordings / "press_1/2026-03-02/valve_1"
    table.write_text(f"bag,machine,valve,date\n{bag},press_9,valve_9,2025-12-01\n", "utf-8")
    assert add_to_store(again, [bag], PATTERN, table, "", 1).new == 1
    assert spool_fleet.table(again, rows).to_pylist() == before
    named = f"SELECT DISTINCT machine, valve, start FROM parameters WHERE bag = '{bag}'"
    (row,) = spool_fleet.table(again, named).to_pylist()
    assert (row["machine"], row["valve"], str(row["start"].date())) == ("press_9", "valve_9", "2025-12-01")


@pytest.fixture
def older(store: Path, tmp_path: Path) -> Path:
    """Store of format 1: of one bag the rows wait in the manifest, of the others the tables have them."""
    made = tmp_path / "older"
    shutil.copytree(store, made)
    with closing(sqlite3.connect(made / "manifest.sqlite", isolation_level=None)) as database:
        database.execute("UPDATE results SET rows = NULL WHERE path != (SELECT min(path) FROM bags)")
        database.execute("DROP INDEX results_by_key")
        database.execute("CREATE INDEX results_waiting ON results (path) WHERE rows IS NOT NULL")
        database.execute("PRAGMA user_version = 1")
    return made


def test_a_store_of_the_older_format_is_taken_over_with_its_results(store: Path, older: Path) -> None:
    with closing(Manifest(older)):
        shutil.rmtree(older / "tables")
    assert run_over_store(older, "monitor,features", 1, None)[0].bags == 0
    assert tables_of(older) == tables_of(store)


def test_an_older_store_is_taken_over_whole_or_not_at_all(
    store: Path, older: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        # March is taken over when the process ends.
        patched.setattr(
            parquet, "rows_in_tables", lambda *of: rows_in_tables(*of) if of[1] == "2026-03" else ended()
        )
        with pytest.raises(KeyboardInterrupt):
            Manifest(older)
    assert run_over_store(older, "monitor,features", 1, None)[0].bags == 0
    assert tables_of(older) == tables_of(store)


def test_what_an_older_store_lost_is_due_again(older: Path) -> None:
    (older / "tables/parameters/2026-03.parquet").unlink()
    with closing(Manifest(older)) as manifest:
        due = manifest.due(dict.fromkeys(("features", "monitor"), suite_version()))
    assert {Path(path).parent.name for path in due} == {"2026-03-02"}
    assert len(due) == 3


def test_a_service_is_told_and_tables_are_read_while_another_process_is_at_work(
    store: Path, tmp_path: Path
) -> None:
    busy = tmp_path / "store"
    shutil.copytree(store, busy)
    with closing(Manifest(busy)) as run:
        assert len(spool_fleet.table(busy, "bags")) == 8
        assert add_service(busy, "press_1", "", {"repair": "2026-03-20"}, "")
        assert [one.kind for one in run.services()] == ["repair"]
        with run.transaction():  # as the tables of a month are written
            assert len(spool_fleet.table(busy, "services")) == 1
            with closing(Manifest(busy)) as other:
                assert len(list(other.entries())) == 8


@pytest.mark.parametrize(("kind", "ours"), [(TypeError, True), (OSError, False)])
def test_the_reason_of_a_failed_analysis_says_whose_fault_it_is(
    kind: type[Exception], ours: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(_subject: object) -> Rows:
        raise kind("no such thing")

    monkeypatch.setitem(ANALYSES, "fit", faulty)
    (outcome,) = run_task(Task(str(tmp_path), (("valve_1", ("fit",)),)))
    assert outcome.status == execution.FAILED
    assert ("a fault of the suite" in outcome.reason) == ours


def test_an_analysis_that_fails_says_why_and_stops_nothing(
    recordings: Path, tmp_path: Path, make_bag: Callable[..., Path]
) -> None:
    folder = tmp_path / "bags"
    shutil.copytree(recordings / "press_1/2026-03-02", folder / "press_1/2026-03-02")
    make_bag(folder / "press_1/2026-03-02/short", 5, seconds=1.0)
    store = tmp_path / "store"
    add_to_store(store, [folder], PATTERN, None, "", 1)
    result, _ = run_over_store(store, "fit", 1, None)
    assert result.bags == 3
    (line,) = result.failed
    assert "short" in line
    assert "too short for an estimate" in line


def test_every_analysis_gives_rows_of_the_tables(recordings: Path) -> None:
    names = tuple(ANALYSES)
    assert {"fit", "monitor", "gap", "features"} <= set(names)
    bag = recordings / "press_1/2026-03-02/valve_1"
    for outcome in run_task(Task(str(bag), (("valve_1", tuple(n for n in names if n != "gap")),))):
        assert outcome.status == "ok", outcome.reason
        for table, rows in outcome.rows.items():
            assert {len(row) for row in rows} <= {len(RECORD_TABLES[table]) - 4}


def test_analyses_that_do_not_exist_are_refused() -> None:
    with pytest.raises(InputError, match="known are"):
        chosen("fitt")
    with pytest.raises(InputError, match="name one"):
        chosen(",")


@pytest.mark.parametrize(
    "query",
    [
        "DROP VIEW bags", "COPY bags TO '/tmp/out.csv'", "SELECT * FROM read_text('/etc/passwd')",
        "SELECT 1; SELECT 2", "ATTACH '/tmp/x.db'", "SELECT * FROM nothing", "not SQL", "INSTALL httpfs",
        "SELECT * FROM read_csv('https://example.org/x.csv')", "SET enable_external_access = true",
    ],
)  # fmt: skip
def test_a_query_reads_the_tables_and_nothing_else(store: Path, query: str) -> None:
    with pytest.raises(InputError, match="query: "):
        spool_fleet.table(store, query)


def test_every_named_question_is_answered(store: Path) -> None:
    for row in answer(store, None, "list", "", "", ""):
        found = answer(store, None, row["question"], "press_1", "valve_1", "spring_stiffness")
        assert all(one.get("machine", "press_1") == "press_1" for one in found)
    assert len(answer(store, None, "trend", "press_1", "valve_1", "spring_stiffness")) == 2
    # A name with a quote in it is a name.
    assert answer(store, None, "trend", "it's", "", "spring_stiffness") == []


def test_services_are_told_and_wrong_ones_refused(recordings: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    add_to_store(store, [recordings / "press_1"], PATTERN, None, "", 1)
    assert add_service(store, "press_1", "", {"oil_change": "2026-03-20"}, "") == [
        "press_1: oil change on 2026-03-20"
    ]
    with pytest.raises(InputError, match="no bag of press_9"):
        add_service(store, "press_9", "", {"oil_change": "2026-03-20"}, "")
    with pytest.raises(InputError, match="YYYY-MM-DD"):
        add_service(store, "press_1", "", {"oil_change": "20th of March"}, "")
    manifest = Manifest(store)
    assert [one.kind for one in manifest.services()] == ["oil_change"]
    manifest.close()


def test_a_store_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no fleet store"):
        run_over_store(tmp_path, "fit", 1, None)
    (tmp_path / "manifest.sqlite").write_bytes(b"something else" * 100)
    with pytest.raises(InputError, match="cannot be used as a fleet store"):
        Manifest(tmp_path)
