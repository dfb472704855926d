"""Supervisor of host processes: restarts what died or hangs.

It loads nothing itself. The first process loads, forks the others, so that they share what was loaded, and
goes on as the first one; all of them are the supervisor's (``PR_SET_CHILD_SUBREAPER`` of prctl(2)).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import mmap
import os
import signal
import socket
import struct
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from types import FrameType

#: s before a process that died is begun again, twice as long for each further time in an hour, and at most.
AGAIN, LONGEST_AGAIN = 2.0, 300.0
#: s without progress after which a process is killed: starting a node takes less than a second; and between
#: two looks.
LONGEST_SILENCE, LOOK = 30.0, 0.5
#: s that loading takes at most, compiling included (about a minute), and the end of a process after a signal.
LONGEST_LOAD, LONGEST_END = 600.0, 60.0
#: s that a process waits to become the supervisor's, which takes a millisecond.
LONGEST_ADOPTION = 5.0
#: Of prctl(2).
_PARENT_DEATH_SIGNAL, _CHILD_SUBREAPER = 1, 36

#: Signals with which a host is asked to end.
ASKING = (signal.SIGINT, signal.SIGTERM)


class Heartbeat:
    """Heartbeat of so many processes, in memory that they share after a fork."""

    def __init__(self, count: int) -> None:
        self._map = mmap.mmap(-1, _BEAT.size * count)

    def beat(self, number: int, process: int | None = None) -> None:
        """Say that ``process``, this one where it is left out, is number ``number`` and makes progress."""
        _BEAT.pack_into(self._map, _BEAT.size * number, time.monotonic(), process or os.getpid())

    def forget(self, number: int) -> None:
        """Say that no process is number ``number``."""
        _BEAT.pack_into(self._map, _BEAT.size * number, 0.0, 0)

    def process(self, number: int) -> int:
        """Return the identifier of process ``number``, 0 where it never made progress."""
        return int(_BEAT.unpack_from(self._map, _BEAT.size * number)[1])

    def age(self, number: int) -> float:
        """Return how long ago process ``number`` did so, s."""
        return time.monotonic() - float(_BEAT.unpack_from(self._map, _BEAT.size * number)[0])


#: Time of the last beat by the monotonic clock, s, and the process that beats.
_BEAT = struct.Struct("<dq")

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
        self._loading_since: dict[int, float] = {}
        self._ended: set[int] = set()
        self._asked: list[int] = []
        self._told: set[int] = set()
        self._ends: dict[int, list[float]] = {}
        self._due: dict[int, float] = {}
        self._asked_at = math.inf
        self._looked = self._patient_until = time.monotonic()
        self._code = 0

    def run(self) -> int:
        """Keep the processes running until a signal; return 2 where what was given to them is wrong."""
        ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1)
        for asking in ASKING:
            signal.signal(asking, self._ask)
        self._begin(range(self._count))
        while len(self._ended) < self._count:
            try:
                process, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:  # all wait to be begun again
                process, status = 0, 0
            if process:
                self._take_end(process, os.waitstatus_to_exitcode(status))
                continue
            self._look()
            time.sleep(LOOK)
        return self._code

    def _ask(self, number: int, _frame: FrameType | None) -> None:
        self._asked.append(number)
        self._asked_at = min(self._asked_at, time.monotonic())
        self._told.clear()
        self._tell(number)

    @property
    def _running(self) -> set[int]:
        found = {self._heartbeat.process(number) for number in range(self._count)} | set(self._loading)
        return found - {0}

    def _tell(self, number: int) -> None:
        """Hand a signal on to all processes that have not had it."""
        for process in self._running - self._told:
            self._told.add(process)
            _signal(process, number)

    def _begin(self, numbers: Sequence[int]) -> None:
        supervisor = os.getpid()
        first, *others = numbers
        # Until the child has its own handlers, or none, a signal waits.
        signal.pthread_sigmask(signal.SIG_BLOCK, ASKING)
        try:
            process = os.fork()
        except OSError as error:  # no process or no memory is left
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING)
            print(f"host: no process can be begun: {error.strerror}", file=sys.stderr, flush=True)
            self._due.update(dict.fromkeys(numbers, time.monotonic() + AGAIN))
            return
        if process:
            self._loading_since[process] = time.monotonic()
            for before in self._loading.values():
                before[:] = [number for number in before if number not in numbers]
            self._loading[process] = list(numbers)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING)
            return
        try:
            for asking in ASKING:
                signal.signal(asking, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING)
            _die_with(supervisor)
            run = self._load()
            # Freeze live objects for the collector, so that their pages stay shared.
            gc.collect()
            gc.freeze()
            for number in others:
                self._fork(run, number, supervisor)
            self._heartbeat.beat(first)
            os._exit(run(first, self._heartbeat))
        except SystemExit as end:  # of a library that is missing
            os._exit(end.code if isinstance(end.code, int) else 1)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)

    def _fork(self, run: Run, number: int, supervisor: int) -> None:
        """Run process ``number`` as a child of the supervisor: its own parent ends at once."""
        between = os.fork()
        if between:
            if os.waitstatus_to_exitcode(os.waitpid(between, 0)[1]):
                raise OSError(f"process {number} cannot be begun")
            return
        try:
            process = os.fork()
            if process:
                self._heartbeat.beat(number, process)
                os._exit(0)
        except OSError:
            os._exit(1)
        _die_with(supervisor)
        os._exit(run(number, self._heartbeat))

    def _look(self) -> None:
        """Kill what makes no progress; tell the service manager that all do; begin what is due."""
        now = time.monotonic()
        if now - self._looked > 0.5 * LONGEST_SILENCE:  # the whole machine stood still
            self._patient_until = now + LONGEST_SILENCE
        self._looked = now
        if self._asked:
            self._tell(self._asked[-1])
            if now - self._asked_at > LONGEST_END:
                for process in self._running:
                    _signal(process, signal.SIGKILL)
            self._ended.update(self._due)
            self._due.clear()
            return
        known = {self._heartbeat.process(number): number for number in range(self._count)}
        late: set[int] = set()
        if now >= self._patient_until:  # those that make no progress, or load for too long
            late = {one for one in known if one and self._heartbeat.age(known[one]) > LONGEST_SILENCE}
            loads = self._loading_since.items()
            late |= {one for one, since in loads if one not in known and now - since > LONGEST_LOAD}
        for process in late:
            print(f"host process {process} makes no progress: it is killed", file=sys.stderr, flush=True)
            _signal(process, signal.SIGKILL)
        if not late:
            notify("WATCHDOG=1")
        loading = (numbers for process, numbers in self._loading.items() if process not in known)
        begun = {number for numbers in loading for number in numbers} | self._ended
        for number in set(range(self._count)) - begun - set(self._due):
            if not self._heartbeat.process(number):  # it ended before it said a word
                self._due[number] = now
        due = [number for number, at in self._due.items() if at <= now]
        for number in due:
            del self._due[number]
        if due:
            self._begin(due)

    def _take_end(self, process: int, code: int) -> None:
        """Begin again what ended with ``process``; where all are asked to end, count it."""
        loading = self._loading.pop(process, [])
        self._loading_since.pop(process, None)
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
        if code == 2 and not self._ends:  # it was refused at the start: what was given is wrong
            self._code = 2
            self._ended.update(numbers)
            self._ask(signal.SIGTERM, None)
            return
        now = time.monotonic()
        for number in numbers:
            ends = [at for at in self._ends.get(number, []) if now - at < 3600.0]
            self._ends[number] = [*ends, now]
            wait = min(AGAIN * 2.0 ** min(len(ends), 20), LONGEST_AGAIN)
            self._due[number] = now + wait
            said = f"host {number} ended with {code}: begun again in {wait:g} s"
            print(said, file=sys.stderr, flush=True)


def notify(text: str) -> None:
    """Tell the service manager ``text`` (sd_notify(3)); without one nothing happens."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
            connection.connect(address)
            connection.sendall(text.encode())
    except OSError:
        return  # it went away: nobody is left to tell


def _signal(process: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError):  # its end is about to be taken
        os.kill(process, number)


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
