"""Operations of the command `fleet`: add, run, ask, tell of a service, page."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spool_core.errors import InputError
from spool_core.system import processors
from spool_report.outputs import suite_version
from spool_report.terminal import progress
from spool_sim.valve import find_valve

from spool_fleet import execution
from spool_fleet.add import DAMAGED, Added, Naming, PathPattern, Scan, add, found_bags, read_table, scan
from spool_fleet.manifest import Manifest, Service
from spool_fleet.parquet import bring_up_to_date
from spool_fleet.query import QUESTIONS, ask, rows_of, sql_of


def add_to_store(
    store: Path,
    folders: Sequence[Path],
    pattern: str | None,
    table: Path | None,
    valve: str,
    workers: int | None,
) -> Added:
    """Bring the bags in ``folders`` into the catalogue of ``store``, which is made where it is missing.

    Raises:
        InputError: a folder, the pattern, the table or the valve file cannot be used.
    """
    if valve:
        find_valve(valve)
    naming = Naming(
        None if pattern is None else PathPattern(pattern),
        {} if table is None else read_table(table),
        str(Path(valve).absolute()) if Path(valve).is_file() else valve,  # as workers find it
    )
    bags = found_bags(folders)
    pool = execution.ProcessPool(workers or processors())

    def scans(changed: Sequence[Path]) -> Iterator[Scan]:
        if len(changed) == 1:
            yield scan(changed[0])
            return
        for done in pool.run(scan, changed):
            yield done.found or Scan(done.item, "", "", (), DAMAGED, done.reason)

    with closing(Manifest(store, make=True)) as manifest, progress("reading bags", len(bags)) as advance:
        added = add(manifest, bags, naming, scans, advance)
        bring_up_to_date(manifest)
    return added


def run_over_store(
    store: Path, analysis: str, workers: int | None, dask: str | None, params_file: Path | None = None
) -> tuple[execution.RunResult, list[str]]:
    """Run the analyses named in ``analysis`` over what is new; return what was done, and lines for the user.

    Args:
        store: folder of the store.
        analysis: names, separated by commas.
        workers: processes; default: one for each processor.
        dask: address of a scheduler.
        params_file: parameters of the plant's nodes, by whose limits the monitor judges.

    Raises:
        InputError: no store, no such analysis, the parameter file cannot be used, or no Dask scheduler
            answers.
    """
    from spool_report.runs.record_replay import settings_from  # noqa: PLC0415 - slow to load

    from spool_fleet.analyses import chosen  # noqa: PLC0415
    from spool_fleet.judgement import sentences, write_trends  # noqa: PLC0415 - slow to load

    keys, count = dict.fromkeys(chosen(analysis), suite_version()), workers or processors()
    lines = []
    if "monitor" in keys:
        # Refused before the work, whatever the namespaces of the bags are.
        lines = [f"monitor: {settings_from(params_file, 'valve').source}"]
        if params_file is not None:
            keys["monitor"] += f" {hashlib.sha256(params_file.read_bytes()).hexdigest()}"
    with closing(Manifest(store)) as manifest:
        tasks = execution.tasks_due(manifest, keys, lambda name: settings_from(params_file, name))
        chosen_pool = execution.ProcessPool(count) if dask is None else execution.DaskCluster(dask, count)
        with closing(chosen_pool) as pool, progress("analysing bags", len(tasks)) as advance:
            result = execution.run_tasks(manifest, tasks, keys, pool, advance)
        trends = write_trends(store, manifest.services())
    return result, [*lines, *sentences(trends)]


def answer(
    store: Path, sql: str | None, question: str | None, machine: str, valve: str, parameter: str
) -> list[dict[str, Any]]:
    """Return the rows that an SQL query or a named question finds.

    Raises:
        InputError: neither or both are given, or it cannot be answered.
    """
    if (sql is None) == (question is None):
        raise InputError('fleet query: give one SELECT, or --question NAME ("--question list" lists them)')
    if question == "list":
        return [{"question": name, "asks": one.line} for name, one in QUESTIONS.items()]
    asked = sql if question is None else sql_of(question, machine, valve, parameter)
    assert asked is not None
    return rows_of(ask(store, asked))


def add_service(
    store: Path, machine: str, valve: str, dates: Mapping[str, str | None], comment: str
) -> list[str]:
    """Take the service events of ``dates``, by kind; return a line about each.

    Raises:
        InputError: no machine, valve or date, a date that is none, or a machine or valve that is not known.
    """
    from spool_fleet.judgement import write_trends  # noqa: PLC0415 - slow to load

    given = {kind: text for kind, text in dates.items() if text is not None}
    if not given:
        raise InputError(
            "fleet event: give the kind and date of the service, such as --oil-change 2026-05-04"
        )
    if not machine and not valve:
        raise InputError("fleet event: give --machine or --valve")
    lines = []
    with closing(Manifest(store)) as manifest:
        known = {(entry.machine, entry.valve) for entry in manifest.entries()}
        if not any(machine in ("", one) and valve in ("", other) for one, other in known):
            raise InputError(f"fleet event: no bag of {' '.join(filter(None, (machine, valve)))} in {store}")
        for kind, text in given.items():
            try:
                moment = datetime.fromisoformat(text)
            except ValueError:
                option = kind.replace("_", "-")
                raise InputError(f"--{option} {text}: write the date as YYYY-MM-DD") from None
            moment = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
            start = round(moment.timestamp()) * 1_000_000_000
            manifest.add_service(Service(machine, valve, start, kind, comment))
            whose = " ".join(filter(None, (machine, valve)))
            lines.append(f"{whose}: {kind.replace('_', ' ')} on {moment.date()}")
        if (store / "tables" / "trends").is_dir():
            write_trends(store, manifest.services())
    return lines


def write_page(store: Path, out: Path, reports: int, params_file: Path | None = None) -> str:
    """Write the page of the fleet, and the replay reports of ``reports`` bags of each conspicuous valve.

    The reports are judged by the limits in ``params_file``, by default the shipped ones.

    Raises:
        InputError: no store, the parameter file cannot be used, or the page cannot be written.
    """
    from spool_report.outputs import check_output, write_file  # noqa: PLC0415

    from spool_fleet.content import page_content, write_reports  # noqa: PLC0415
    from spool_fleet.fleet_page import fleet_page  # noqa: PLC0415

    check_output(out, "--out")
    with progress("drawing"):
        content = page_content(store)
        made = write_reports(content, out, reports, params_file) if reports else {}
        write_file(out, fleet_page(content, made), "--out")
    return f"{out}: {content.summary}" + (f"; {len(made)} reports beside it" if made else "")
