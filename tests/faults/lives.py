"""Lives of processes on a disk of which the n-th call fails: what each keeps, what it loses and reports.

Runs below :mod:`.shim`, as ``python -m tests.faults.lives PROCESS FOLDER BEGIN STEP``, and prints one JSON
object a life. Each life is a fork of this process, which has everything loaded; its disk is ``FOLDER/disk``.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from .disk import Disk

#: Calls that fail from the n-th on, by mode; a journal's entry takes ten.
MODES = {"once": 1, "for a while": 30, "permanently": 1 << 40}
#: Number of a call that no process reaches.
NEVER = 1 << 50
#: Keys of what is kept of which more than without a fault is as wrong as less.
ADDED = ("journal", "trends")
#: s after which a life is given up.
LONGEST = 120


class Process(Protocol):
    """Process whose lives are compared.

    ``excuses``: words in its log with which others may get something else.
    """

    excuses: tuple[str, ...]

    def load(self) -> None:
        """Load what all lives share."""

    def prepare(self, disk: Path) -> object:
        """Make what the process finds on its disk; called in a fork, :meth:`load` before."""

    def live(self, disk: Path) -> object:
        """Be the process from start to end; return what others got from it, as JSON can hold it."""

    def kept(self, disk: Path) -> dict[str, dict[str, Any]]:
        """Return what is on the disk after the end."""

    def stated(self, said: str) -> set[str]:
        """Return the keys of :meth:`kept` of which ``said``, the log, reports a loss."""


@dataclass(frozen=True, slots=True)
class Lived:
    """Life whose ``number``-th call failed in ``mode``.

    ``lost`` and ``doubled``: keys of what it kept; ``unstated`` of the lost; ``wrong``: whatever else.
    """

    mode: str
    number: int
    lost: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    unstated: tuple[str, ...] = ()
    wrong: str = ""
    said: str = ""
    diff: str = ""


class Rig:
    """Rig for the lives of one process in ``folder``."""

    def __init__(self, process: Process, folder: Path) -> None:
        self.process, self.folder = process, folder
        self.place = folder / "disk"
        self.disk = Disk(self.place, folder / "control")
        self.disk.tell()
        shutil.rmtree(self.place, ignore_errors=True)
        process.load()
        self._forked(process.prepare)
        shutil.rmtree(folder / "found", ignore_errors=True)
        self.place.rename(folder / "found")
        self.got, self.kept, self.calls = self.lived(NEVER, NEVER)

    def lived(self, first: int, last: int) -> tuple[object, dict[str, dict[str, Any]], int]:
        """Live with calls ``first`` to ``last`` failing; return what others got, what is kept, all calls."""
        shutil.rmtree(self.place, ignore_errors=True)
        shutil.copytree(self.folder / "found", self.place)
        self.disk.fail(first, last)
        got = self._forked(self.process.live)
        calls = self.disk.calls
        self.disk.tell()
        return got, self.process.kept(self.place), calls

    def _forked(self, act: Callable[[Path], object]) -> object:
        """Return what ``act`` returns in a fork; what it prints is in the log.

        Raises:
            RuntimeError: it did not end well.
        """
        got = self.folder / "got.json"
        got.unlink(missing_ok=True)
        pid = os.fork()
        if pid == 0:
            signal.alarm(LONGEST)
            log = os.open(self.folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(log, 1)
            os.dup2(log, 2)
            code = 1
            try:
                got.write_text(json.dumps(act(self.place)), "utf-8")
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if code:
            self.disk.tell()
            raise RuntimeError(f"it ended with {code}")
        return json.loads(got.read_text("utf-8"))

    def judged(self, mode: str, number: int) -> Lived:
        """Return what the failure of the ``number``-th call cost."""
        wrong: list[str] = []
        try:
            got, kept, _ = self.lived(number, number + MODES[mode] - 1)
        except Exception as error:  # a process that ended, or files that nobody can read afterwards
            got, kept = self.got, {}
            wrong.append(f"{type(error).__name__}: {error}")
        said = (self.folder / "log").read_text(errors="replace", encoding="utf-8")
        if got != self.got and not any(words in said for words in self.process.excuses):
            wrong.append(f"others got {got}")
        if "Traceback" in said or "Exception" in said:
            wrong.append("traceback")
        lost = tuple(key for key in self.kept if _less(kept.get(key, {}), self.kept[key]))
        again = "can't be read" in said  # then alarms are raised again
        doubled = tuple(
            key for key in kept if not again and key in ADDED and _less(self.kept[key], kept[key])
        )
        unstated = tuple(key for key in lost if key not in self.process.stated(said))
        return Lived(
            mode,
            number,
            lost,
            doubled,
            unstated,
            "; ".join(wrong),
            said,
            f"{self.kept} {kept}" if (doubled or unstated) else "",
        )


def _less(some: dict[str, Any], others: dict[str, Any]) -> bool:
    """Return whether ``some`` lacks what ``others`` hold; of numbers whether one is smaller."""
    return any(
        name not in some or (some[name] < one if isinstance(one, (int, float)) else some[name] != one)
        for name, one in others.items()
    )


def lives(process: Process, folder: Path, begin: int, step: int) -> Iterator[Lived]:
    """Yield the lives whose call ``begin``, ``begin + step``, ... fails, in each mode."""
    rig = Rig(process, folder)
    print(json.dumps({"calls": rig.calls, "modes": list(MODES)}), flush=True)
    for number in range(begin, rig.calls + 1, step):
        for mode in MODES:
            yield rig.judged(mode, number)


def main(name: str, folder: str, begin: str, step: str) -> None:
    """Print the lives of the process ``name``."""
    import importlib  # noqa: PLC0415

    process: Process = importlib.import_module(f"{__package__}.{name}_life").PROCESS
    for one in lives(process, Path(folder), int(begin), int(step)):
        print(json.dumps(asdict(one)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
