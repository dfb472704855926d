"""Forks of a process that has everything loaded behave as separate processes, and end with their test."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from .forks import completed, server

#: Prints what a program sees of itself.
SEEN = """
import json, multiprocessing, os, signal, sys
seen = {
    "arguments": sys.argv, "folder": os.getcwd(), "environment": dict(os.environ),
    "input": sys.stdin.read(), "files": sorted(os.listdir("/proc/self/fd")), "group": os.getpgrp(),
    "signals": {one.name: str(signal.getsignal(one)) for one in signal.Signals},
    "blocked": [one.name for one in signal.pthread_sigmask(signal.SIG_BLOCK, [])],
    "child of multiprocessing": multiprocessing.parent_process() is not None,
    "line by line": [sys.stdout.line_buffering, sys.stderr.line_buffering], "main": __name__,
}
json.dump(seen, sys.stdout)
print("what went wrong", file=sys.stderr)
sys.exit(3)
"""
#: Makes a server and a fork that last, and prints the processes of both.
WORKER = """
import os, sys, time
from pathlib import Path
from tests.forks import Server
fork = Server([]).start(
    ["-c", "import time; time.sleep(600)"], folder=Path(), environment=dict(os.environ), output=sys.stderr
)
print(fork.pid, Path(f"/proc/{fork.pid}/stat").read_text().rpartition(")")[2].split()[1], flush=True)
time.sleep(600)
"""


def test_a_program_sees_the_same_of_itself_in_a_fork_and_in_a_process_of_its_own(tmp_path: Path) -> None:
    command, environment = ["-c", SEEN, "--word"], {**os.environ, "OWN": "1"}
    own = subprocess.run(
        [sys.executable, *command],
        cwd=tmp_path, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    fork = completed(command, folder=tmp_path, environment=environment)
    assert json.loads(fork.stdout) == json.loads(own.stdout)
    assert (fork.returncode, fork.stderr) == (own.returncode, own.stderr) == (3, "what went wrong\n")


def test_a_fork_that_lasts_belongs_to_the_run_and_dies_by_a_signal(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as log:
        fork = server().start(
            ["-c", "import time; time.sleep(600)"], folder=tmp_path, environment=os.environ, output=log
        )
    try:
        assert os.environ["SPOOL_TEST_RUN"].encode() in Path(f"/proc/{fork.pid}/environ").read_bytes()
        assert fork.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            fork.wait(timeout=0.0)
    finally:
        fork.kill()
    assert fork.wait() == -signal.SIGKILL
    assert not Path(f"/proc/{fork.pid}").exists()


def test_a_fork_that_raises_ends_as_python_does(tmp_path: Path) -> None:
    done = completed(["-c", "raise ValueError('mine')"], folder=tmp_path, environment=os.environ)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "ValueError: mine"


def test_server_and_forks_end_with_a_worker_that_is_killed() -> None:
    root = Path(__file__).resolve().parent.parent
    worker = subprocess.Popen([sys.executable, "-c", WORKER], cwd=root, stdout=subprocess.PIPE, text=True)
    try:
        assert worker.stdout is not None
        ends = [os.pidfd_open(int(word)) for word in worker.stdout.readline().split()]
    finally:
        worker.kill()
        worker.communicate()
    for end in ends:
        assert select.select([end], [], [], 180.0)[0], "it runs on"
        os.close(end)
