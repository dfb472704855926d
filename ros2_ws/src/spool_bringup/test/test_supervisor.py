"""Supervisor of processes: real ones, killed, hanging, refused and ended by a signal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from spool_bringup.host.arguments import FirstList
from spool_core.errors import InputError

#: s that a test waits at most: machines are busy.
PATIENCE = 180.0
#: Each process says its number and its identifier, then beats until a signal ends it, or as its number says.
PROGRAM = """
import os, sys, time, signal
from spool_bringup.host import supervisor

supervisor.AGAIN, supervisor.LONGEST_AGAIN = 0.05, 0.1
supervisor.LONGEST_SILENCE, supervisor.LOOK = 5.0, 0.05
folder, count, codes = sys.argv[1], int(sys.argv[2]), dict(map(int, one.split(":")) for one in sys.argv[3:])


def load():
    print("loaded", flush=True)
    return run


def run(number, heartbeat):
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    with open(f"{folder}/{number}", "a") as stream:
        stream.write(f"{os.getpid()} {os.getppid()}\\n")
    while not ended:
        if number in codes:
            return codes[number]
        if not os.path.exists(f"{folder}/hang {number}"):
            heartbeat.beat(number)
        time.sleep(0.02)
    return 0


sys.exit(supervisor.Supervisor(count, load).run())
"""
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture(name="start")
def _start(tmp_path: Path) -> Iterator[Start]:
    running: list[subprocess.Popen[str]] = []

    def start(*words: str) -> subprocess.Popen[str]:
        running.append(
            subprocess.Popen(
                [sys.executable, "-c", PROGRAM, str(tmp_path), *words],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.communicate()


def _seen(folder: Path, number: int) -> list[list[int]]:
    """Return identifier and parent of each process that ever was ``number``."""
    file = folder / str(number)
    lines = file.read_text("utf-8").splitlines() if file.exists() else []
    return [list(map(int, line.split())) for line in lines]


def _until(met: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not met():
        assert time.monotonic() < end
        time.sleep(0.01)


def _gone(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text("utf-8").rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return True
    return state == "Z"


def test_all_processes_are_children_of_the_supervisor_and_one_loads_for_all(
    start: Start, tmp_path: Path
) -> None:
    process = start("3")
    _until(lambda: all(_seen(tmp_path, number) for number in range(3)))
    assert {_seen(tmp_path, number)[0][1] for number in range(3)} == {process.pid}
    process.send_signal(signal.SIGTERM)
    said, wrong = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert said == "loaded\n"
    assert not wrong


@pytest.mark.parametrize("killed", [0, 2])
def test_a_killed_process_is_begun_again_and_the_others_go_on(
    start: Start, tmp_path: Path, killed: int
) -> None:
    process = start("3")
    _until(lambda: all(_seen(tmp_path, number) for number in range(3)))
    os.kill(_seen(tmp_path, killed)[0][0], signal.SIGKILL)
    _until(lambda: len(_seen(tmp_path, killed)) == 2)
    assert _seen(tmp_path, killed)[1][1] == process.pid
    process.send_signal(signal.SIGTERM)
    _, wrong = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert wrong == f"host {killed} ended with -9: begun again in 0.05 s\n"
    assert [len(_seen(tmp_path, one)) for one in range(3)] == [2 if one == killed else 1 for one in range(3)]


def test_two_that_end_one_after_the_other_are_begun_once_each(start: Start, tmp_path: Path) -> None:
    process = start("3")
    _until(lambda: all(_seen(tmp_path, number) for number in range(3)))
    for number in (1, 0):
        os.kill(_seen(tmp_path, number)[0][0], signal.SIGKILL)
    _until(lambda: all(len(_seen(tmp_path, number)) == 2 for number in (0, 1)))
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=PATIENCE)
    assert [len(_seen(tmp_path, number)) for number in range(3)] == [2, 2, 1]


def test_a_process_without_progress_is_killed_and_begun_again(start: Start, tmp_path: Path) -> None:
    start("2")
    _until(lambda: all(_seen(tmp_path, number) for number in range(2)))
    (tmp_path / "hang 1").touch()
    _until(lambda: len(_seen(tmp_path, 1)) == 2)
    assert len(_seen(tmp_path, 0)) == 1


def test_a_refused_start_ends_all_with_2(start: Start) -> None:
    process = start("3", "1:2")
    process.communicate(timeout=PATIENCE)
    assert process.returncode == 2


def test_what_ends_every_time_is_begun_again_ever_later_and_costs_the_others_nothing(
    start: Start, tmp_path: Path
) -> None:
    process = start("2", "0:1")
    _until(lambda: len(_seen(tmp_path, 0)) >= 4)
    process.send_signal(signal.SIGTERM)
    _, wrong = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert len(_seen(tmp_path, 1)) == 1
    waits = [line.split()[-2] for line in wrong.splitlines()]
    assert waits[:3] == ["0.05", "0.1", "0.1"]


def test_a_list_of_valves_is_that_of_the_start_whatever_becomes_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "valves.yaml"
    file.write_text("- {namespace: valve_1}\n- {namespace: valve_2, valve_file: a.yaml}\n", "utf-8")
    kept = FirstList()
    first = kept.read(str(file))
    file.write_text("- {name", "utf-8")
    assert kept.read(str(file)) == first
    assert [(one.namespace, one.valve_file) for one in first] == [("valve_1", ""), ("valve_2", "a.yaml")]


def test_a_list_that_is_refused_is_read_once_more(tmp_path: Path) -> None:
    file, kept = tmp_path / "valves.yaml", FirstList()
    with pytest.raises(InputError):
        kept.read(str(file))
    file.write_text("- {namespace: valve_1}\n", "utf-8")
    assert [one.namespace for one in kept.read(str(file))] == ["valve_1"]


def test_a_killed_supervisor_takes_its_processes_along(start: Start, tmp_path: Path) -> None:
    process = start("3")
    _until(lambda: all(_seen(tmp_path, number) for number in range(3)))
    process.kill()
    _until(lambda: all(_gone(_seen(tmp_path, number)[0][0]) for number in range(3)))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_host_of_one_process_ends_quietly_while_it_loads(number: int) -> None:
    """Each line of ``-X importtime`` says what has just been imported."""
    words = [sys.executable, "-X", "importtime", "-m", "spool_bringup.host.program"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    said = next(line for line in process.stderr if "numpy" in line)
    process.send_signal(number)
    said += process.communicate(timeout=60)[1]
    assert process.returncode == 0
    assert "Traceback" not in said
