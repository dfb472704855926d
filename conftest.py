"""Settings of every test: order, processors, a free ROS domain for each worker, no process left behind."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import uuid
from collections import Counter
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

with contextlib.suppress(ImportError):  # not beneath every package
    from spool_core.node.testing import away_from_other_ros_programs, claim_domain, domain_id  # noqa: F401
    from spool_core.system import private_temporary_folder

    # ROS and matplotlib write there; otherwise no node starts, and forks remove matplotlib's own folder.
    for name in ("ROS_LOG_DIR", "MPLCONFIGDIR") if not os.access(Path.home(), os.W_OK) else ():
        os.environ.setdefault(name, str(private_temporary_folder(name.lower())))

# A run says the same as the next one; ``--hypothesis-profile=random`` searches for new examples.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile("repeatable")
# One thread of linear algebra in each worker and in what it starts: more of them wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

#: Folders whose tests mostly wait, for live nodes or a browser; the others compute.
WAITING = ("tests", "web", "node")
ROOT = Path(__file__).resolve().parent
#: Environment variable with the names of the test runs that a process belongs to: of the runner, and of its
#: worker. A process inherits it from whatever started it.
RUN = "SPOOL_TEST_RUN"
#: Environment variable with the names of the runner alone: its workers share a server of forks.
FORKS = "SPOOL_TEST_FORKS"
#: s by file, of the last run; of a machine that keeps them where this one has none yet.
TIMES, SHIPPED = "spool/times", ROOT / "tests" / "times.json"
#: Options with which a run needs all tests before the first.
WHOLE = ("lf", "failedfirst", "newfirst", "stepwise")

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
    """Give a worker what all of them must agree on, and the tests that a change can reach."""
    config = node.config
    node.workerinput["reached"] = config.args
    node.workerinput["late"] = not (
        any("::" in argument for argument in config.args)
        or any(config.getoption(name, False) for name in WHOLE)
    )
    node.workerinput["times"] = config.pluginmanager.get_plugin("times").known


def pytest_configure(config: pytest.Config) -> None:
    """Let no process that a test starts outlive this runner, even after kill -9; fail deprecated calls."""
    worker = hasattr(config, "workerinput")
    if not worker:
        config.pluginmanager.register(Times(config), "times")
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
    if not worker:
        os.environ[FORKS] = os.environ[RUN]


class WholeFile(pytest.Item):
    """A file of tests, which its worker reads when it is its turn: the other workers never do."""

    def runtest(self) -> None:
        """Be no test: `pytest_runtest_protocol` runs those of the file."""


class UnreadFile(pytest.File):
    """What holds it."""

    def collect(self) -> Iterator[pytest.Item]:
        """Return the file as its only item."""
        yield WholeFile.from_parent(self, name=self.path.name, nodeid=self.nodeid)


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Leave a file unread where workers share many."""
    late = getattr(parent.config, "workerinput", {}).get("late")
    return UnreadFile.from_parent(parent, path=module_path) if late else None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Read a file and run its tests."""
    if not isinstance(item, WholeFile):
        return None
    session, place, folder = item.session, item.session.items.index(item), item.listchain()[-3]
    tests = list(session.genitems(pytest.Module.from_parent(folder, path=item.path)))
    item.ihook.pytest_collection_modifyitems(session=session, config=item.config, items=tests)
    # Whatever the next file is: of this one only what belongs to the session is left.
    last = nextitem and WholeFile.from_parent(session, name="")
    for test, after in zip(tests, [*tests[1:], last], strict=False):
        session.items[place] = test
        item.ihook.pytest_runtest_protocol(item=test, nextitem=after)
        if session.shouldfail or session.shouldstop:
            break
    session.items[place] = item
    return True


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Put long files first, and mix those that wait with those that compute, so that no processor idles."""
    given = list(items)
    yield
    if any(isinstance(item, WholeFile) for item in given):
        items[:] = given  # which of its tests are wanted is seen when it is read
    times = getattr(config, "workerinput", {}).get("times", {})
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    lasting = {path: times.get(some[0].nodeid.partition("::")[0], 1.0) for path, some in files.items()}
    order: list[tuple[float, Path]] = []
    for waits in (True, False):
        kind = [path for path in files if waits is not set(WAITING).isdisjoint(path.parts[len(ROOT.parts) :])]
        kind.sort(key=lambda path: -lasting[path])
        ends = list(accumulate(lasting[path] for path in kind))
        order += [((end - lasting[path]) / ends[-1], path) for end, path in zip(ends, kind, strict=True)]
    items[:] = [item for _, path in sorted(order, key=lambda one: one[0]) for item in files[path]]


class Times:
    """How long each file takes, kept for the order of the next run; how much of this one is over."""

    def __init__(self, config: pytest.Config) -> None:
        self.cache = getattr(config, "cache", None)
        shipped = json.loads(SHIPPED.read_text(encoding="utf-8")) if SHIPPED.is_file() else {}
        self.known: dict[str, float] = shipped | ((self.cache and self.cache.get(TIMES, {})) or {})
        self.taken = Counter[str]()
        self.tests = 0
        self.files: list[str] = []

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, node: Any, ids: list[str]) -> None:
        """Take up the files that the workers will read."""
        self.files = ids if node.workerinput["late"] else []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count, and guess how many tests there are by the share of the files that have begun."""
        self.taken[report.nodeid.partition("::")[0]] += report.duration
        self.tests += report.when == "setup"
        if self.files and report.when == "setup":
            begun, all_ = (sum(self.known.get(one, 1.0) for one in some) for some in (self.taken, self.files))
            self.session.testscollected = max(self.tests, round(self.tests * all_ / begun))

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtestloop(self, session: pytest.Session) -> Iterator[None]:
        """Correct the guess: no test at all is a failure."""
        self.session = session
        yield
        if self.files:
            self.session.testscollected = self.tests

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Keep the times of a run that was not ended early."""
        option = session.config.getoption
        whole = exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED) and not option("keyword")
        if self.cache and self.files and whole and option("markexpr") == "not slow":
            taken = {file: round(0.1 + seconds, 1) for file, seconds in self.taken.items()}
            self.cache.set(TIMES, self.known | taken)


@pytest.hookimpl(optionalhook=True)  # pytest-xdist is not on every machine that has ROS 2
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Number of workers: the tests of one file run one after the other in the same worker."""
    named = {Path(argument.partition("::")[0]) for argument in config.args}
    if len(named) == 1 and all(path.is_file() for path in named):
        return 0
    # Two more than the processors: tests of live nodes wait most of their time.
    return len(os.sched_getaffinity(0)) + 2
