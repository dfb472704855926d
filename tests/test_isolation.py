"""Tests among other programs: on domains that nobody else uses, and without a process left behind."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGTERM

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from spool_core.errors import InputError
from spool_core.node import network as free_domain
from spool_msgs.msg import AccelerationBlock

from .conftest import PATIENCE, System

ROOT = Path(__file__).resolve().parent.parent

#: A test that lasts, with three children: one ends when asked, as nodes do, one ignores the request, and
#: one has left its parent.
LASTING = """
import os, subprocess, sys, time
from pathlib import Path

WILLING = "import time; time.sleep(600)"
STUBBORN = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"
FORKING = "import os, time; os.fork() and os._exit(0); time.sleep(600)"


def test_that_lasts():
    for program in (WILLING, STUBBORN, FORKING):
        subprocess.Popen([sys.executable, "-c", program], start_new_session=True)
    Path(os.environ["STARTED"]).touch()
    time.sleep(600)
"""


class Foreign:
    """Foreign program on a domain: it sends the blocks of a valve that tests use."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("foreign", context=self.context, start_parameter_services=False, enable_rosout=False)
        self.node.create_publisher(AccelerationBlock, "/valve_1/acceleration", 10)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(name="foreign")
def _foreign(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return a domain on which another program sends, whatever the discovery range of that program is."""
    with free_domain.claimed_domain() as number:
        pass
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    program = Foreign(number)
    yield number
    program.close()


def test_a_domain_on_which_another_program_talks_is_not_claimed(foreign: int) -> None:
    assert foreign in free_domain.domains_in_use()
    with free_domain.claimed_domain() as number:
        assert number != foreign


def test_a_claimed_domain_is_claimed_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(free_domain, "DOMAINS", (231, 232))
    monkeypatch.setattr(free_domain, "domains_in_use", set)
    monkeypatch.setattr(free_domain, "private_temporary_folder", lambda _name: tmp_path)
    with free_domain.claimed_domain() as first, free_domain.claimed_domain() as second:
        assert {first, second} == {231, 232}
        with pytest.raises(InputError, match=r"^no ROS domain is free"), free_domain.claimed_domain():
            pass


def test_what_a_test_starts_without_a_domain_is_apart_from_other_programs(system: System) -> None:
    """The worker's own domain is neither that of people, 0, nor that of a test's system."""
    domain = int(os.environ["ROS_DOMAIN_ID"])
    assert domain not in (0, system.domain_id)
    assert domain in free_domain.DOMAINS
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def carrying(name: str) -> set[int]:
    """Return the processes with ``name`` in their environment."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if name.encode() in (entry / "environ").read_bytes():
                    found.add(int(entry.name))
            except OSError:  # it ended, or is another user's
                continue
    return found


def until(met: object, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not met():  # type: ignore[operator]
        assert time.monotonic() < end, f"waited {PATIENCE:g} s for {what}"
        time.sleep(0.05)


def test_an_interrupted_run_leaves_no_process(tmp_path: Path) -> None:
    """Ctrl-C, the end of a session, and kill -9 of the runner."""
    (tmp_path / "test_lasting.py").write_text(LASTING, "utf-8")
    runs: dict[int, subprocess.Popen[bytes]] = {}
    started = {number: tmp_path / f"started_{number}" for number in (SIGINT, SIGTERM, SIGKILL)}
    try:
        for number, file in started.items():
            words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "conftest", "test_lasting.py"]
            path = os.pathsep.join(filter(None, [str(ROOT), *sys.path]))
            runs[number] = subprocess.Popen(
                [sys.executable, *words],
                cwd=tmp_path,
                env={**os.environ, "PYTHONPATH": path, "STARTED": str(file)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        for number, run in runs.items():
            until(started[number].exists, "its children are started")
            until(lambda name=f"STARTED={started[number]}": len(carrying(name)) >= 4, "they run")
            run.send_signal(number)
            run.wait(timeout=PATIENCE)
        for number, file in started.items():
            name = f"STARTED={file}"
            until(lambda name=name: not carrying(name), f"nothing is left after signal {number}")
    finally:
        for file in started.values():
            for process in carrying(f"STARTED={file}"):
                with suppress(ProcessLookupError):
                    os.kill(process, SIGKILL)
        for run in runs.values():
            run.wait(timeout=PATIENCE)
