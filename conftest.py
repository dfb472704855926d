"""Settings of every test: order, processors, a free ROS domain for each worker, no process left behind."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import uuid
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

with contextlib.suppress(ImportError):  # not beneath every package
    from spool_core.node.testing import away_from_other_ros_programs, claim_domain, domain_id  # noqa: F401

# A run says the same as the next one; ``--hypothesis-profile=random`` searches for new examples.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile("repeatable")
# One thread of linear algebra in each worker and in what it starts: more of them wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

#: Folders whose tests mostly wait, for live nodes or a browser; the others compute.
WAITING = ("tests", "web", "node")
#: Files that take longest, in this order: begun late, they leave the other workers idle at the end. A file
#: that is missing here costs time only.
LONGEST = (
    "test_browser.py",
    "test_analyse.py",
    "test_composition.py",
    "test_command_line.py",
    "test_search.py",
    "test_pasted_pages.py",
    "test_setup.py",
    "test_page.py",
    "test_host.py",
    "test_killed_nodes.py",
    "test_fuzz_commands.py",
    "test_documented_python.py",
    "test_nuisances.py",
    "test_position.py",
    "test_alignment.py",
    "test_sensor_clocks.py",
    "test_blind_gap.py",
    "test_alarms.py",
    "test_faults.py",
    "test_blows.py",
    "test_adapter.py",
    "test_force.py",
    "test_drift_oil.py",
    "test_lifecycle.py",
    "test_stream.py",
    "test_implausible.py",
    "test_refits.py",
    "test_gap_live.py",
    "test_fit_command.py",
    "test_replay_report.py",
    "test_launch.py",
    "test_two_valves.py",
    "test_bridge.py",
    "test_supervision.py",
    "test_store.py",
)

ROOT = Path(__file__).resolve().parent
#: Environment variable with the names of the test runs that a process belongs to: of the runner, and of its
#: worker. A process inherits it from whatever started it.
RUN = "SPOOL_TEST_RUN"
#: Environment variable with the names of the runner alone: its workers share a server of forks.
FORKS = "SPOOL_TEST_FORKS"

#: Program that ends what a test run left behind, however the run itself ended: it waits until its parent, the
#: runner, is gone, asks every process with the name of the run in its environment to end, and kills the rest.
REAPER = """
import os, signal, sys, time

parent, name = int(sys.argv[1]), sys.argv[2].encode()

def left():
    for entry in os.listdir("/proc"):
        if entry.isdigit() and int(entry) != os.getpid():
            try:
                with open(f"/proc/{entry}/environ", "rb") as stream:
                    if name in stream.read():
                        yield int(entry)
            except OSError:
                pass

for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
while os.getppid() == parent:
    time.sleep(0.2)
for number, seconds in ((signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0)):
    end = time.monotonic() + seconds
    told = set()
    while time.monotonic() < end and (there := set(left())):
        for process in there - told:
            try:
                os.kill(process, number)
            except OSError:
                pass
        told |= there
        time.sleep(0.1)
"""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer `--changed`."""
    parser.addoption(
        "--changed",
        nargs="?",
        const="HEAD",
        metavar="COMMIT",
        help="only tests that what differs from COMMIT (default: the last one) can reach; for the loop",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> int | None:
    """Replace the tests that were asked for by those that a change can reach, before workers are counted."""
    commit = config.getoption("--changed")
    if commit is None:
        return None
    if hasattr(config, "workerinput"):
        config.args[:] = config.workerinput["reached"]
        return None
    from spool_core.errors import InputError  # noqa: PLC0415 - not beneath every package
    from spool_evaluation.changed_tests import Repository  # noqa: PLC0415 - in a checkout only

    repository = Repository(ROOT)
    try:
        config.args[:] = repository.tests_reached(repository.changed_since(commit))
    except InputError as error:
        raise pytest.UsageError(str(error)) from error
    print(f"since {commit}: {len(config.args)} test functions can be reached; .ci/run runs all")
    return None if config.args else 0


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Give a worker the tests that a change can reach: it would begin with what was typed."""
    node.workerinput["reached"] = node.config.args


def pytest_configure(config: pytest.Config) -> None:
    """Let no process that a test starts outlive this runner, even after kill -9; fail deprecated calls."""
    try:
        from starlette.exceptions import StarletteDeprecationWarning  # noqa: PLC0415 - not on every machine
    except ImportError:
        pass
    else:
        kind = f"{StarletteDeprecationWarning.__module__}.{StarletteDeprecationWarning.__name__}"
        config.addinivalue_line("filterwarnings", f"error::{kind}")
    name = uuid.uuid4().hex
    # The reaper does not carry the name that it looks for.
    subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", REAPER, str(os.getpid()), name],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.environ[RUN] = f"{os.environ.get(RUN, '')} {name}".strip()
    if not hasattr(config, "workerinput"):
        os.environ[FORKS] = os.environ[RUN]


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long files first, and mix those that wait with those that compute, so that no processor idles."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    long = {name: place for place, name in enumerate(LONGEST)}
    order: list[tuple[float, Path]] = []
    for waits in (True, False):
        kind = [path for path in files if waits is not set(WAITING).isdisjoint(path.parts[len(ROOT.parts) :])]
        kind.sort(key=lambda path: long.get(path.name, len(long)))
        order += [(place / len(kind), path) for place, path in enumerate(kind)]
    items[:] = [item for _, path in sorted(order, key=lambda one: one[0]) for item in files[path]]


@pytest.hookimpl(optionalhook=True)  # pytest-xdist is not on every machine that has ROS 2
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Number of workers: the tests of one file run one after the other in the same worker."""
    named = {Path(argument.partition("::")[0]) for argument in config.args}
    if len(named) == 1 and all(path.is_file() for path in named):
        return 0
    # One more than the processors: tests of live nodes wait most of their time.
    return len(os.sched_getaffinity(0)) + 1
