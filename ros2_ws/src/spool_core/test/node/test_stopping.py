"""SIGINT and SIGTERM at any moment of a node's life end it with 0 and without a traceback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from .conftest import PATIENCE

Start = Callable[..., "subprocess.Popen[str]"]
LOADING = """
import sys, types
from spool_core.node.program import start
module = types.ModuleType("slow")
sys.modules["slow"] = module
def __getattr__(name):  # what takes long while libraries are loaded
    print("loading", flush=True)
    while True:
        sum(range(1000))
module.__getattr__ = __getattr__
sys.exit(start("slow", "Node"))
"""


def wait_for(process: subprocess.Popen[str], line: str) -> None:
    assert process.stdout is not None
    for said in process.stdout:
        if said.strip() == line:
            return
    pytest.fail(f"it ended without saying {line}")


def ended_well(process: subprocess.Popen[str]) -> str:
    stdout, stderr = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in stderr
    assert process.returncode == 0, stderr
    return stdout


def test_while_libraries_are_loaded(environment: dict[str, str]) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", LOADING],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(process, "loading")
    process.send_signal(signal.SIGINT)
    ended_well(process)


@pytest.mark.parametrize(("hook", "number"), [("configure", signal.SIGTERM), ("activate", signal.SIGINT)])
def test_while_the_node_starts(probe: Start, hook: str, number: signal.Signals) -> None:
    process = probe(failing=f"{hook} until a signal")
    wait_for(process, hook)
    process.send_signal(number)
    assert "cleanup" in ended_well(process).split()


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_again_while_it_ends(probe: Start, observer: Any, number: signal.Signals) -> None:
    process = probe(failing="deactivate until two signals")
    observer.until(lambda: "tick" in observer.heard, "a tick")
    process.send_signal(number)
    wait_for(process, "deactivate")
    process.send_signal(number)
    assert ended_well(process).split() == ["cleanup"]


def test_while_the_interpreter_takes_itself_down(probe: Start, observer: Any) -> None:
    process = probe(failing="exit")
    observer.until(lambda: "tick" in observer.heard, "a tick")
    process.terminate()
    ended_well(process)


#: Arguments, and what the one line says that refuses them.
REFUSED = [
    ("--params-file broken.yaml", "broken.yaml: it cannot be read as a parameter file"),
    ("--params-file none.yaml", "none.yaml: it cannot be read as a parameter file: No"),
    ("-r __ns:=/4_press", "'/4_press' is no namespace: use letters, digits and single underscores"),
    ("-r __node:=4x", "'4x' is no name of a node: "),
    ("-r told:=4/x", "no rule for a topic's name"),
    ("-p gain=2", "-p gain=2: write it with :="),
    ("-p 4gain:=2", "'4gain' is no name of a parameter"),
    ("-p", "-p: its value is missing"),
    ("--log-level loud", "use debug, info, warn, error or fatal"),
    ("--params-file bare.yaml -r __ns:=/valve_1", "bare.yaml: no parameters for /valve_1/probe"),
    ("--params-file bare.yaml -r __node:=other", "write a section /**/other (or /other)"),
    ("-p prove:gain:=2.0", "it is for a node prove, and this is /probe: type -p gain:=2.0"),
    ("-- -r __ns:=/valve_9", "type --ros-args -r __ns:=/valve_9"),
    ("-- nonsense", "nonsense: no option of this program"),
    ("--bogus", "unknown ROS arguments"),
    ("--params-file valve.yaml", "valve.yaml: this is a valve description: pass it as --valve "),
]
#: The node with each of these arguments, in a fork: its output, and a line with its code.
EACH = """
import json, os, runpy, sys
from spool_core.node.running import run
node = runpy.run_path(sys.argv[0])["Probe"]
for arguments in json.loads(sys.argv[1]):
    sys.argv[1:] = ["--ros-args", *arguments]
    fork = os.fork()
    if fork == 0:
        sys.exit(run(node))
    print("code", os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]), file=sys.stderr, flush=True)
"""


def test_arguments_that_rcl_refuses_are_said_in_one_line(environment: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "broken.yaml").write_text("probe:\n  ros__parameters: [unclosed", "utf-8")
    (tmp_path / "bare.yaml").write_text("probe:\n  ros__parameters: {gain: 2.0}", "utf-8")
    (tmp_path / "valve.yaml").write_text("id: a\nmoving_mass: 0.18\nspring_stiffness: 1632.0\n", "utf-8")
    probe = Path(__file__).with_name("probe_node.py")
    given = json.dumps([arguments.split() for arguments, _ in REFUSED])
    answer = subprocess.run(
        [sys.executable, "-c", f"import sys; del sys.argv[0]\n{EACH}", str(probe), given],
        env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    lines = answer.stderr.splitlines()
    assert lines[1::2] == ["code 2"] * len(REFUSED), answer.stderr
    assert [reason for (_, reason), line in zip(REFUSED, lines[::2], strict=True) if reason not in line] == []


def test_without_a_writable_home_it_logs_elsewhere_and_says_so(
    environment: dict[str, str], domain_id: int, tmp_path: Path
) -> None:
    environment |= {"HOME": os.devnull, "TMPDIR": str(tmp_path)}
    for name in ("ROS_LOG_DIR", "ROS_HOME"):
        environment.pop(name, None)
    probe = Path(__file__).with_name("probe_node.py")
    process = subprocess.Popen(
        [sys.executable, str(probe)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(process, "activate")
    process.terminate()
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "/dev/null/.ros/log can't be written" in said
    assert list(tmp_path.glob("spool_*/log/*"))
