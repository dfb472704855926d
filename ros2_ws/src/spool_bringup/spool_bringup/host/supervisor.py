"""Supervisor of host processes: begins them, ends them on a signal, and begins one again that ended.

It loads nothing itself. The first process loads, forks the others, so that they share what was loaded, and
goes on as the first one; all of them are the supervisor's (``PR_SET_CHILD_SUBREAPER`` of prctl(2)).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from types import FrameType

from .heartbeat import Heartbeat, notify

#: s before a process that died is begun again, and times within an hour.
AGAIN, MOST = 2.0, 20
#: s without progress after which a process is killed: starting a node takes less than a second; and between
#: two looks.
LONGEST_SILENCE, LOOK = 30.0, 0.5
#: s that a process waits to become the supervisor's, which takes a millisecond.
LONGEST_ADOPTION = 5.0
#: Of prctl(2).
_PARENT_DEATH_SIGNAL, _CHILD_SUBREAPER = 1, 36

Run = Callable[[int, Heartbeat], int]


class Supervisor:
    """Supervisor of ``count`` processes.

    A process that makes no progress, whatever holds it up, is killed and begun again.
    """

    def __init__(self, count: int, load: Callable[[], Run]) -> None:
        """Begin nothing yet.

        Args:
            count: of processes.
            load: loads what all processes need and returns what runs one of them: its exit code by number.
        """
        self._count, self._load = count, load
        self._heartbeat = Heartbeat(count)
        self._loading: dict[int, list[int]] = {}
        self._ended: set[int] = set()
        self._asked: list[int] = []
        self._told: set[int] = set()
        self._begun: list[float] = []
        self._code = 0

    def run(self) -> int:
        """Keep the processes running until a signal; return 2 where what was given to them is wrong."""
        ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1)
        for asking in (signal.SIGINT, signal.SIGTERM):
            signal.signal(asking, self._ask)
        self._begin(range(self._count))
        while len(self._ended) < self._count:
            process, status = os.waitpid(-1, os.WNOHANG)
            if process:
                self._take_end(process, os.waitstatus_to_exitcode(status))
                continue
            self._look()
            time.sleep(LOOK)
        return self._code

    def _ask(self, number: int, _frame: FrameType | None) -> None:
        self._asked.append(number)
        self._told.clear()
        self._tell()

    def _tell(self) -> None:
        """Hand a signal on to all processes that have not had it."""
        running = {self._heartbeat.process(number) for number in range(self._count)} | set(self._loading)
        for process in running - self._told - {0}:
            self._told.add(process)
            with contextlib.suppress(ProcessLookupError):  # its end is about to be taken
                os.kill(process, self._asked[-1])

    def _begin(self, numbers: Sequence[int]) -> None:
        supervisor = os.getpid()
        first, *others = numbers
        process = os.fork()
        if process:
            for before in self._loading.values():
                before[:] = [number for number in before if number not in numbers]
            self._loading[process] = list(numbers)
            return
        try:
            for asking in (signal.SIGINT, signal.SIGTERM):
                signal.signal(asking, signal.SIG_DFL)
            _die_with(supervisor)
            run = self._load()
            # What lives now stays: no collector looks through it, so that its pages stay shared.
            gc.collect()
            gc.freeze()
            for number in others:
                self._fork(run, number, supervisor)
            self._heartbeat.beat(first)
            os._exit(run(first, self._heartbeat))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)

    def _fork(self, run: Run, number: int, supervisor: int) -> None:
        """Run process ``number`` as a child of the supervisor: its own parent ends at once."""
        between = os.fork()
        if between:
            os.waitpid(between, 0)
            return
        if os.fork():
            os._exit(0)
        self._heartbeat.beat(number)
        _die_with(supervisor)
        os._exit(run(number, self._heartbeat))

    def _look(self) -> None:
        """Kill what makes no progress; tell the service manager that all do."""
        if self._asked:
            self._tell()
            return
        late = [
            number
            for number in range(self._count)
            if self._heartbeat.process(number) and self._heartbeat.age(number) > LONGEST_SILENCE
        ]
        for number in late:
            print(f"host {number} makes no progress: it is killed", file=sys.stderr, flush=True)
            os.kill(self._heartbeat.process(number), signal.SIGKILL)
        if not late:
            notify("WATCHDOG=1")

    def _take_end(self, process: int, code: int) -> None:
        """Begin again what ended with ``process``; where all are asked to end, count it."""
        loading = self._loading.pop(process, [])
        numbers = [
            number
            for number in range(self._count)
            if self._heartbeat.process(number) == process
            or (number in loading and not self._heartbeat.process(number))
        ]
        if not numbers:
            return  # a process that analysed for one that ended
        for number in numbers:
            self._heartbeat.forget(number)
        if self._asked:
            self._ended.update(numbers)
            return
        if code == 2:  # it was refused: what was given is wrong
            self._code = 2
            self._ended.update(numbers)
            self._ask(signal.SIGTERM, None)
            return
        print(f"host {', '.join(map(str, numbers))} ended with {code}", file=sys.stderr, flush=True)
        self._begun = [at for at in self._begun if time.monotonic() - at < 3600.0]
        if len(self._begun) >= MOST:
            print(f"host: {MOST} new starts within an hour, no more of this one", file=sys.stderr, flush=True)
            self._ended.update(numbers)
            return
        self._begun.append(time.monotonic())
        time.sleep(AGAIN)
        if self._asked:
            self._ended.update(numbers)
        else:
            self._begin(numbers)


def _die_with(supervisor: int) -> None:
    """Wait to be a child of ``supervisor``, and end with it: two hosts would share the valves' names."""
    end = time.monotonic() + LONGEST_ADOPTION
    while os.getppid() != supervisor:
        if time.monotonic() > end:
            os._exit(1)
        time.sleep(0.001)
    ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, int(signal.SIGTERM))
    if os.getppid() != supervisor:
        os._exit(1)
