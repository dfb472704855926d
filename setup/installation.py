"""Steps of the set-up: what is missing is done, and each step remembered."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager

from setup import packages, requirements, workspace
from setup.layout import Layout, SetupError
from setup.process import Runner, Steps, say

#: Logs and modules of the processes that compile kernels: of the nodes, and of analyses.
WARM_UPS = {"kernels": "spool_monitor.warm_up", "analysis_kernels": "spool_gap.warm_up"}


def is_current(layout: Layout, done: requirements.SetupState) -> bool:
    """Whether nothing has to be done."""
    return (
        requirements.stale(layout, done) is None
        and layout.ready_file.exists()
        and _is_built(layout, done, workspace.package_fingerprints(layout.packages))
    )


def ensure(layout: Layout, environment: Mapping[str, str]) -> None:
    """Do what is missing of the set-up.

    Raises:
        SetupError: one line that says what went wrong.
    """
    try:
        layout.notes.mkdir(parents=True, exist_ok=True)
        with _alone(layout) as keep_open:
            done = requirements.load(layout)
            if not is_current(layout, done):
                Installation(layout, environment, done, keep_open).run()
    except OSError as error:
        raise requirements.cannot_write(layout, error) from error


class Installation:
    """One set-up; what is done is kept in `done`, which is saved after every step.

    Args:
        layout: the project.
        environment: the user's.
        done: the stamp so far.
        keep_open: descriptor of the set-up's lock.
    """

    def __init__(
        self, layout: Layout, environment: Mapping[str, str], done: requirements.SetupState, keep_open: int
    ) -> None:
        self._layout = layout
        self._environment = environment
        self._done = done
        self._steps = Steps()
        self._runner = Runner(layout.notes, keep_open, self._steps.progress)
        self._wanted = workspace.package_fingerprints(layout.packages)

    def run(self) -> None:
        """Do the steps that are missing.

        Raises:
            SetupError: a step failed, or something it needs is missing.
        """
        layout, done = self._layout, self._done
        stale = requirements.stale(layout, done)
        if stale is not None and done.python_version:
            say(f"{stale}: setting up again")
        requirements.check_machine(layout, self._environment)
        requirements.check_ros(layout, self._environment)
        fresh = stale is not None or not packages.venv_works(layout, self._tools())
        if fresh:
            requirements.check_space(layout)
            # Nothing of the old is trusted from here on, whenever the set-up is interrupted.
            requirements.save(layout, requirements.SetupState())
            done.__dict__.update(requirements.SetupState().__dict__)
        building = not done.lock or not _is_built(layout, done, self._wanted)
        archive = workspace.messages_archive(layout, self._environment)
        compiling = building and not archive.exists()
        self._steps.total = fresh + (not done.lock) + building + compiling + (not done.warmed)
        if fresh:
            self._make_venv()
        if not done.lock:
            packages.forget_half_installed(layout)
            lock = layout.lock_hash()
            with self._steps.step(f"installing {len(packages.locked(layout.requirements))} packages"):
                packages.install(layout, self._tools(), self._runner)
                if layout.underlay.is_wheels:
                    workspace.patch_foreign_files(layout, self._tools())
            done.lock = lock
            requirements.save(layout, done)
        if building:
            self._link()
        with ExitStack() as parallel:
            kernels = None if done.warmed else parallel.enter_context(self._kernels())
            if building:
                if not workspace.install_messages(layout, archive):
                    with self._steps.step(f"building {workspace.MESSAGES}"):
                        workspace.build_messages(layout, self._tools(), self._runner, archive)
                    if not workspace.install_messages(layout, archive):
                        raise SetupError(f"{archive} is damaged: check the disk and call again")
                workspace.compile_bytecode(layout, self._tools(), self._runner)
                done.built = self._wanted
                requirements.save(layout, done)
            if kernels:
                self._finish_kernels(kernels)
        layout.ready_file.touch()
        say(f"set up in {self._steps.elapsed():.0f} s")

    def _tools(self) -> dict[str, str]:
        """The environment in which the steps' tools run; the wheels add to it once they are installed."""
        return workspace.base_environment(self._layout, self._environment)

    def _make_venv(self) -> None:
        with self._steps.step(
            f"making {self._layout.venv.relative_to(self._layout.root)} with Python {requirements.VERSION}"
        ):
            packages.make_venv(self._layout, self._tools(), self._runner)
        self._done.root = str(self._layout.root)
        self._done.python_version = requirements.SERIES
        self._done.underlay = list(self._layout.underlay.prefixes)
        requirements.save(self._layout, self._done)

    def _link(self) -> None:
        """Put the workspace's packages into an empty prefix; messages and kernels follow."""
        layout, done = self._layout, self._done
        if not done.built:
            shutil.rmtree(layout.output / "build", ignore_errors=True)
        done.built = {}
        requirements.save(layout, done)
        with self._steps.step(f"linking {len(self._wanted)} packages"):
            shutil.rmtree(layout.install, ignore_errors=True)
            workspace.link_packages(layout, self._tools())

    @contextmanager
    def _kernels(self) -> Iterator[dict[str, Callable[[], int]]]:
        """Compile the kernels into their cache on disk, in parallel with the build; yield the ends by log."""
        environment = workspace.run_environment(self._layout, self._environment)
        with ExitStack() as parallel:
            ends = {}
            for name, module in WARM_UPS.items():
                command = (str(self._layout.python), "-m", module)
                ends[name] = parallel.enter_context(self._runner.in_parallel(name, command, environment))
            yield ends

    def _finish_kernels(self, ends: dict[str, Callable[[], int]]) -> None:
        with self._steps.step("compiling the numerical kernels"):
            for name, end in ends.items():
                if end() != 0:
                    log = self._runner.log(name)
                    raise packages.failure("the kernels could not be compiled", log.read_text("utf-8"), log)
        self._done.warmed = True
        requirements.save(self._layout, self._done)


def _is_built(layout: Layout, done: requirements.SetupState, wanted: dict[str, str]) -> bool:
    return done.built == wanted and (layout.install / "local_setup.bash").exists()


@contextmanager
def _alone(layout: Layout) -> Iterator[int]:
    """Hold the set-up's lock; wait, and say so, where another one holds it."""
    with layout.lock_file.open("a", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"another set-up is at work in {layout.root}: waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield file.fileno()
