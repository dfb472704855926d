"""The command line through `./spool`: what scripts rely on."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from spool_bag.information import describe
from spool_bag.writer import BagWriter
from spool_evaluation.benchmarks.load.valve_source import family
from spool_msgs.msg import AccelerationBlock
from spool_tools.cli import app, main
from spool_tools.operations.node_processes import find_executable
from typer.main import get_command

from setup.main import commands

from .conftest import PATIENCE
from .forks import completed

if TYPE_CHECKING:
    from .conftest import System

ROOT = Path(__file__).resolve().parent.parent


def spool(*arguments: object, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command through the launcher."""
    return subprocess.run(
        [ROOT / "spool", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        cwd=folder,
    )


def program(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command as what the launcher hands over to, in a fork."""
    command = [str(find_executable("spool_bringup", "spool")), *map(str, arguments)]
    return completed(command, folder=Path.cwd(), environment={**os.environ, **environment}, timeout=180)


def test_info_tells_what_is_in_a_bag(tmp_path: Path) -> None:
    done = spool("info", ROOT / "bags" / "practice_01", "--json", tmp_path / "info.json")
    assert done.returncode == 0, done.stderr
    assert "/valve_1/acceleration" in done.stdout
    assert done.stderr == ""
    told = json.loads((tmp_path / "info.json").read_text("utf-8"), parse_constant=pytest.fail)
    assert isinstance(told, dict)


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with a folder `here` that holds a file."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "kept").write_text("mine", "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("replay", "missing"), "missing: no such bag"),
        (("import", "missing.csv", "--out", "bag"), "missing.csv"),
        (("simulate", "--out", "here"), "here"),
        (("simulate", "--excitation", "dance", "--out", "new"), "dance: no such excitation"),
        (("simulate", "--valve", "4weh11", "--out", "new"), "4weh11: no such valve"),
        (("simulate", "--model", "magic", "--out", "new"), "magic"),
        (("simulate", "--seconds", "-1", "--out", "new"), "-1"),
        (("simulate", "--noise", "much", "--out", "new"), "'--noise'"),
        (("info", "missing", "--colour", "red"), "--colour"),
        (("simulate",), "--out"),
        (("run", "spool_dance", "dancer"), "package spool_dance is not installed"),
        (("run", "spool_sim", "dancer"), "it has: simulator"),
        (("run",), "PACKAGE"),
        (("alarm", "list", "../x"), "../x"),
        (("bench", "nothing"), "nothing"),
        (("gap", "/dev/null", "--valve", "4weh10_soft"), "/dev/null"),
        (("info", "/"), "/: "),
    ],
    ids=lambda value: "_".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_input_ends_in_one_line_and_2(
    work: Path, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    assert main(list(arguments)) == 2
    said = capfd.readouterr().err
    assert expected in said
    assert len(said.strip().splitlines()) == 1
    assert (work / "here" / "kept").read_text("utf-8") == "mine"
    assert not (work / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(("info", "missing"), "missing: no such bag"), (("dance",), "dance"), (("doctor", "x"), "x")],
    ids=lambda value: "_".join(value) if isinstance(value, tuple) else "",
)
def test_the_launcher_passes_a_refusal_on(work: Path, arguments: tuple[str, ...], expected: str) -> None:
    done = spool(*arguments, folder=work)
    assert done.returncode == 2
    assert expected in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_tree_that_is_not_set_up_yet_lists_the_commands_that_there_are() -> None:
    group = get_command(app)
    known = group.list_commands(None)
    assert [name for name in commands(ROOT) if name not in ("test", "package")] == known


@pytest.mark.parametrize("command", ["doctor", "info"])
def test_help_is_had_by_the_launcher(command: str) -> None:
    done = spool(command, "--help")
    assert done.returncode == 0, done.stderr
    assert f"./spool {command}" in done.stdout


def test_version_names_package_and_commit() -> None:
    done = spool("--version")
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"spool \d+\.\d+\.\d+( \(commit [0-9a-f]{12}\+?\))?\n", done.stdout)


def asked(typed: str) -> dict[str, str]:
    """Return the variables by which bash asks for completions, with what `--show-completion` prints."""
    return {
        "_SPOOL_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(len(typed.split()) - 1),
    }


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("./spool repl", {"replay"}),
        ("./spool fit bag --valve 4weh10_s", {"4weh10_soft", "4weh10_stiff"}),
        ("./spool fit bag --model coulomb", {"coulomb", "coulomb_hydrodynamic"}),
        ("./spool simulate --excitation mult", {"multisine"}),
        ("./spool gap bag --base stri", {"stribeck"}),
    ],
)
def test_tab_completes_commands_and_names(typed: str, expected: set[str]) -> None:
    done = program(**asked(typed))
    assert expected <= set(done.stdout.split()), done.stderr
    assert all(word.startswith(typed.rsplit(maxsplit=1)[-1]) for word in done.stdout.split())


def test_the_launcher_completes() -> None:
    environment = {**os.environ, **asked("./spool repl")}
    done = subprocess.run([ROOT / "spool"], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["replay"]


def test_shown_completion_is_for_the_launcher() -> None:
    # The shell is found among the callers, so there has to be one: bash stays until after the call.
    script = '"$0" --show-completion; true'
    done = subprocess.run(
        ["bash", "-c", script, ROOT / "spool"], capture_output=True, text=True, timeout=180, check=False
    )
    assert "_SPOOL_COMPLETE" in done.stdout + done.stderr


def test_names_in_a_bag_do_not_steer_the_terminal(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/\x1b[2J\x07[red]/oil", "sensor_msgs/msg/Temperature")
    done = program("info", tmp_path / "bag")
    assert done.returncode == 2
    assert "no valve found" in done.stderr
    assert "spool_msgs/msg/AccelerationBlock" in done.stderr
    assert not {"\x1b", "\x07"} & set(done.stdout + done.stderr)
    assert "[red]" in done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupted_demonstration_says_what_was_recorded(
    system: System, tmp_path: Path, number: int
) -> None:
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    process = subprocess.Popen(
        [ROOT / "spool", "demo", "--out", tmp_path / "demo"],
        env={**os.environ, "ROS_DOMAIN_ID": str(system.domain_id)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        # Eight nodes start together: on a busy machine each import waits for the others.
        ready = "the valves are simulated"
        system.until(lambda: len(blocks.heard) > 50 or process.poll() is not None, ready, 4.0 * PATIENCE)
        process.send_signal(number)
        said, _ = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "Error" not in said
    information = describe(tmp_path / "demo" / "bag")
    assert information.closed
    assert f"{sum(valve.blocks for valve in information.valves)} blocks recorded" in " ".join(said.split())


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_run_starts_a_node_that_ends_by_a_signal(system: System, tmp_path: Path, number: int) -> None:
    blocks = system.listen(AccelerationBlock, "/valve_9/acceleration")
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(
            [
                *(ROOT / "spool", "run", "spool_sim", "simulator", "--ros-args"),
                *("-r", "__ns:=/valve_9", "-p", "valve_file:=4weh10_stiff"),
            ],
            env={**os.environ, "ROS_DOMAIN_ID": str(system.domain_id)},
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    try:
        system.until(lambda: len(blocks.heard) > 10, "the node publishes")
        assert blocks.last.header.frame_id == "4weh10_stiff"
        process.send_signal(number)
        assert process.wait(timeout=180) == 0
    finally:
        process.kill()
        process.wait()
    assert "Traceback" not in (tmp_path / "log").read_text("utf-8")


def _named(process: int, *words: str) -> list[int]:
    """Return the processes that ``process`` started with one of ``words``, once they run."""
    found = []
    with contextlib.suppress(OSError):  # others come and go meanwhile
        found = family(process)
    return [one for one in found if any(word in _command_line(one) for word in words) and _runs(one)]


def _runs(process: int) -> bool:
    """Whether the middleware of a node runs: it starts about ten threads."""
    with contextlib.suppress(OSError):
        return len(list(Path(f"/proc/{process}/task").iterdir())) > 8
    return False


def _command_line(process: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_text(encoding="utf-8")
    return ""


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_benchmark_that_is_ended_early_leaves_no_process_behind(number: int) -> None:
    process = subprocess.Popen(
        [ROOT / "spool", "bench", "--valves", "1", "--seconds", "600", "host"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        while len(begun := _named(process.pid, "valve_source", "spool_bringup/host")) < 2:
            assert process.poll() is None
        process.send_signal(number)
        said, _ = process.communicate(timeout=180)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130
    assert "Traceback" not in said
    assert not [one for one in begun if Path(f"/proc/{one}").exists()]
