"""Study of a fleet's cost: time a bag and of a trend query, at a hundred bags and at many."""

from __future__ import annotations

import contextlib
import io
import resource
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import date, timedelta
from functools import partial
from pathlib import Path

from spool_core.errors import InputError
from spool_fleet.operations import add_to_store, answer, run_over_store
from spool_tools.operations.simulation import simulate

from spool_evaluation.results.page import markdown_table, renew_json, study_command, write_page
from spool_evaluation.studies.workers import spread

#: Machines and valves of each that the bags are of, one bag a week of each, and the first day.
MACHINES, VALVES, FIRST = 40, 5, date(2026, 1, 5)
#: s and Hz of a bag: short, for what grows with the number of bags is asked, not with their length.
SECONDS, SAMPLE_RATE = 4.0, 500.0
ANALYSES = "features"
SMALLEST = 100
#: Times a query is asked; the median counts.
REPEATS = 5
ABOUT = (
    "Short bags (4 s at 500 Hz) of 40 machines with 5 valves each, looked at, analysed (`features`), judged. "
    "Each size is a store of its own, filled from nothing."
)


@dataclass(frozen=True, slots=True)
class FleetCost:
    """Cost of a store of so many bags: seconds a bag of each step, of a query; files; peak memory in MB."""

    bags: int
    add: float
    run: float
    query: float
    files: int
    driver: float


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[FleetCost]:
    """Measure stores of 100, 1000 ... up to ``cases`` bags; ``out`` gets ``fleet_cost.md`` and ``.json``.

    Raises:
        InputError: ``cases`` is below 100.
    """
    if cases < SMALLEST:
        raise InputError(f"--cases {cases}: a store has {SMALLEST} bags at least here")
    out.mkdir(parents=True, exist_ok=True)
    bags = out / "bags"
    for _ in spread(partial(_bag, bags, seed), range(cases), "bags", workers):
        pass
    sizes = [SMALLEST]
    while sizes[-1] * 10 <= cases:
        sizes.append(sizes[-1] * 10)
    costs = []
    for size in sizes:
        costs.append(_cost(bags, out / "store", size, workers))
        _write(out, costs, study_command("fleet-cost", cases, seed))
    shutil.rmtree(bags)
    return costs


def _bag(folder: Path, seed: int, number: int) -> None:
    """Make one bag unless it is there."""
    machine, valve, week = number % MACHINES, number // MACHINES % VALVES, number // (MACHINES * VALVES)
    day = (FIRST + timedelta(weeks=week)).isoformat()
    path = folder / str(len(str(number))) / f"press_{machine}" / day / f"valve_{valve}"
    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.redirect_stdout(io.StringIO()):
        simulate(
            path, "4weh10_soft", "coulomb", "sweep", SECONDS, sample_rate=SAMPLE_RATE, block_rate=10.0,
            coulomb_force=None, noise=0.05, seed=seed + number, name="valve_1", oil_temperature="40",
        )  # fmt: skip


def _cost(bags: Path, store: Path, size: int, workers: int | None) -> FleetCost:
    """Return what a fresh store of the first ``size`` bags costs."""
    shutil.rmtree(store, ignore_errors=True)
    folders = [bags / str(digits) for digits in range(1, len(str(size - 1)) + 1)]
    begun = time.perf_counter()
    added = add_to_store(store, folders, "{machine}/{date}/{valve}", None, "", workers)
    looked = time.perf_counter()
    run_over_store(store, ANALYSES, workers, None)
    done = time.perf_counter()
    asked = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        answer(store, None, "trend", "press_1", "valve_1", "body_rms")
        asked.append(time.perf_counter() - start)
    files = sum(1 for _ in (store / "tables").rglob("*.parquet"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    shutil.rmtree(store)
    count = added.new
    return FleetCost(
        count, (looked - begun) / count, (done - looked) / count, sorted(asked)[REPEATS // 2], files, peak
    )


def _write(out: Path, costs: Sequence[FleetCost], command: str) -> None:
    head = ("bags", "add, ms a bag", "run, ms a bag", "trend query, s", "files", "driver, peak MB")
    rows = [
        [
            f"{one.bags}", f"{1e3 * one.add:.1f}", f"{1e3 * one.run:.1f}", f"{one.query:.2f}", f"{one.files}",
            f"{one.driver:.0f}",
        ]
        for one in costs
    ]  # fmt: skip
    renew_json(out / "fleet_cost.json", [asdict(one) for one in costs])
    write_page(out / "fleet_cost.md", "Cost of a fleet", command, [ABOUT, markdown_table(head, rows)])
