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
#: Connects to the server of a name, makes a fork that lasts, and prints its process and that of the server.
WORKER = """
import os, sys, time
from pathlib import Path
from tests.forks import Server
fork = Server([], sys.argv[1]).start(
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
        assert os.environ["SPOOL_TEST_FORKS"].encode() in Path(f"/proc/{fork.pid}/environ").read_bytes()
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


def test_workers_of_a_run_share_a_server_that_ends_with_the_last_of_them_that_is_killed(
    tmp_path: Path,
) -> None:
    words = [sys.executable, "-c", WORKER, tmp_path.name]
    root = Path(__file__).resolve().parent.parent
    workers = [subprocess.Popen(words, cwd=root, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    try:
        said = [worker.stdout.readline().split() for worker in workers if worker.stdout]
        (one, server), (other, same) = [[os.pidfd_open(int(word)) for word in words] for words in said]
        assert said[0][1] == said[1][1]
        workers[0].kill()
        assert select.select([one], [], [], 180.0)[0], "its fork runs on"
        assert not select.select([other, server], [], [], 0.0)[0], "that of the other worker does not"
    finally:
        for worker in workers:
            worker.kill()
            worker.communicate()
    for end in (other, server):
        assert select.select([end], [], [], 180.0)[0], "it runs on"
    for end in (one, other, server, same):
        os.close(end)
