"""`./spool fleet run` on real processes that are killed: the tables are those of an undisturbed run."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from spool_fleet.operations import add_to_store, run_over_store
from spool_report.records.simulation import simulate
from spool_report.requests import SimulationSettings
from spool_tools.operations.node_processes import find_executable

#: s; what is waited for comes much sooner on an idle machine.
PATIENCE = 300.0
BAGS = 10


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for number in range(BAGS):
        path = folder / f"press_{number % 2}" / f"2026-0{1 + number % 3}-05" / f"valve_{number}"
        path.parent.mkdir(parents=True, exist_ok=True)
        settings = SimulationSettings(
            "4weh10_soft", "coulomb", "multisine", 10.0, sample_rate=1000.0, block_rate=25.0,
            coulomb_force=0.5, seed=number, oil_temperature="40",
        )  # fmt: skip
        simulate(path, settings)
    return folder


def catalogue(bags: Path, store: Path) -> Path:
    add_to_store(store, [bags], "{machine}/{date}/{valve}", None, "", 1)
    return store


@pytest.fixture(scope="module")
def undisturbed(bags: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    store = catalogue(bags, tmp_path_factory.mktemp("undisturbed") / "store")
    run_over_store(store, "fit,monitor", 1, None)
    return hashes(store)


def hashes(store: Path) -> dict[str, str]:
    return {
        str(file.relative_to(store)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(store.rglob("*.parquet"))
    }


@pytest.fixture
def started(bags: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Yield a run over a fresh store, and the store."""
    store = catalogue(bags, tmp_path / "store")
    command = [find_executable("spool_bringup", "spool"), "fleet", "run", "--store", store, "--workers", "2"]
    process = subprocess.Popen([str(word) for word in command], start_new_session=True)
    yield process, store
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    """Return the processes of the pool, without that which tracks resources."""
    found = []
    for entry in Path(f"/proc/{process.pid}/task").glob("*/children"):
        for child in entry.read_text("utf-8").split():
            command = Path(f"/proc/{child}/cmdline").read_bytes()
            if b"spawn_main" in command:
                found.append(int(child))
    return found


def wait_for_results(store: Path, process: subprocess.Popen[bytes], count: int) -> None:
    """Return when so many results are kept."""
    import sqlite3  # noqa: PLC0415

    database = sqlite3.connect(f"file:{store / 'manifest.sqlite'}?mode=ro", uri=True, timeout=30.0)
    end = time.monotonic() + PATIENCE
    while database.execute("SELECT count(*) FROM results").fetchone()[0] < count:
        assert process.poll() is None, "the run ended too soon to be disturbed"
        assert time.monotonic() < end
        time.sleep(0.01)
    database.close()


@pytest.mark.slow
def test_a_killed_worker_costs_nothing(
    started: tuple[subprocess.Popen[bytes], Path], undisturbed: dict[str, str]
) -> None:
    process, store = started
    wait_for_results(store, process, 2)
    os.kill(workers_of(process)[0], signal.SIGKILL)
    assert process.wait(PATIENCE) == 0
    assert hashes(store) == undisturbed


@pytest.mark.slow
def test_a_killed_run_goes_on_and_leaves_no_worker(
    started: tuple[subprocess.Popen[bytes], Path], undisturbed: dict[str, str]
) -> None:
    process, store = started
    wait_for_results(store, process, 2)
    workers = workers_of(process)
    process.kill()
    process.wait()
    end = time.monotonic() + PATIENCE
    while any(Path(f"/proc/{one}").exists() for one in workers):
        assert time.monotonic() < end, "a worker outlives its run"
        time.sleep(0.01)
    result, _ = run_over_store(store, "fit,monitor", 1, None)
    assert 0 < result.bags < BAGS
    assert hashes(store) == undisturbed


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_bytes_though_a_worker_is_lost(
    bags: Path, tmp_path: Path, undisturbed: dict[str, str]
) -> None:
    distributed = pytest.importorskip("distributed")
    store = catalogue(bags, tmp_path / "store")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        command = [find_executable("spool_bringup", "spool"), "fleet", "run", "--store", store]
        words = [*command, "--dask", cluster.scheduler_address]
        process = subprocess.Popen([str(word) for word in words])
        wait_for_results(store, process, 2)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        assert process.wait(PATIENCE) == 0
    assert hashes(store) == undisturbed


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_said(bags: Path, tmp_path: Path) -> None:
    store = catalogue(bags, tmp_path / "store")
    command = [
        find_executable("spool_bringup", "spool"),
        "fleet",
        "run",
        "--store",
        store,
        "--dask",
        "nowhere:1",
    ]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "no scheduler responds" in done.stderr
    assert "Traceback" not in done.stderr
