"""Programs of Python as forks of one process that has loaded what nodes and commands import.

A node's imports and compiled kernels cost 1 to 3 s of processor time at each start, a fork a tenth of that.
The fork runs the same executable file. It differs from a separate process in two ways: `/proc/PID/environ`
and `/proc/PID/cmdline` are those of the server, and modules that the program never imports are loaded.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import uuid
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

#: Modules that the server imports, and functions of modules that it calls.
LOADED = (
    *("spool_sim.simulator_node", "spool_estimator.estimator_node", "spool_monitor.monitor_node"),
    *("spool_bag.recorder_node", "spool_bag.adapter_node", "spool_core.node.running"),
    *("spool_view.page_node", "spool_opcua.opcua_node"),
    *("spool_bringup.host.host_process", "spool_tools.cli", "spool_report.records.simulation"),
    *("spool_report.runs.record_replay", "spool_report.runs.gap_run"),
    *("spool_report.runs.fit_run", "spool_tools.operations.valve_trend"),
    *("spool_estimator.warm_up:warm_up", "spool_monitor.warm_up:warm_up_monitor"),
)
#: B, of a request with its environment.
LARGEST = 1 << 20


class Fork:
    """A program in a fork of the server, with the methods of ``subprocess.Popen`` that tests use."""

    def __init__(self, server: Server, arguments: Sequence[str], pid: int) -> None:
        self.args, self.pid = arguments, pid
        self.returncode: int | None = None
        self._server = server

    def poll(self) -> int | None:
        """Return the exit code, None while the program runs."""
        if self.returncode is None:
            self.returncode = self._server.code(self.pid, time.monotonic())
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end of the program and return its exit code."""
        if self.returncode is None:
            end = None if timeout is None else time.monotonic() + timeout
            self.returncode = self._server.code(self.pid, end)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal to a program that still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End the program as a crash does."""
        self.send_signal(signal.SIGKILL)


class Server:
    """Connection to the process whose forks the programs are; they end with this one, even after kill -9.

    All connections of one ``name`` share the process, which the first of them starts and which ends with the
    last. ``run``: what its environment holds as the name of the test run.
    """

    def __init__(self, loaded: Sequence[str] = LOADED, name: str = "", run: str = "") -> None:
        address = f"\0spool_forks_{name or uuid.uuid4().hex}"
        self._connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        while self._connection.connect_ex(address):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
                try:
                    listener.bind(address)
                except OSError:  # another worker was first
                    continue
                listener.listen()
                self._process = subprocess.Popen(
                    [sys.executable, __file__, str(listener.fileno()), *loaded],
                    pass_fds=[listener.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    env={**os.environ, "SPOOL_TEST_RUN": run or os.environ.get("SPOOL_TEST_RUN", "")},
                )
        self._codes: dict[int, int] = {}

    def start(
        self,
        command: Sequence[str],
        *,
        folder: Path,
        environment: Mapping[str, str],
        output: IO[Any],
        errors: IO[Any] | None = None,
    ) -> Fork:
        """Run a Python file, or what follows ``-c``; without ``errors`` both outputs go to ``output``."""
        request = json.dumps([list(map(str, command)), str(folder), dict(environment)])
        streams = [output.fileno(), (errors or output).fileno()]
        socket.send_fds(self._connection, [request.encode()], streams)
        while (started := self._hear()) is None:
            pass
        return Fork(self, command, started)

    def code(self, pid: int, end: float | None) -> int | None:
        """Return the exit code of a program, None if it still runs at ``end`` on the monotonic clock."""
        while pid not in self._codes:
            left = None if end is None else max(0.0, end - time.monotonic())
            if not select.select([self._connection], [], [], left)[0]:
                return None
            self._hear()
        return self._codes.pop(pid)

    def close(self) -> None:
        """End all that still runs, and the process if nobody else uses it."""
        self._connection.close()

    def _hear(self) -> int | None:
        """Take up one message: return the process that was started, or note how one ended."""
        message = self._connection.recv(LARGEST)
        if not message:
            raise RuntimeError("the server of forks ended")
        pid, code = json.loads(message)
        if code is None:
            return int(pid)
        self._codes[pid] = code
        return None


@functools.cache
def server() -> Server:
    """Return the server that the workers of this test run share."""
    run = os.environ["SPOOL_TEST_FORKS"]
    made = Server(name=run.replace(" ", "_"), run=run)
    atexit.register(made.close)
    return made


def completed(
    command: Sequence[str], *, folder: Path, environment: Mapping[str, str], timeout: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end as ``subprocess.run`` does."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        popen = server().start(command, folder=folder, environment=environment, output=output, errors=errors)
        try:
            popen.wait(timeout)
        finally:
            popen.kill()
        said = []
        for stream in (output, errors):
            stream.seek(0)
            said.append(stream.read().decode(errors="replace"))
    return subprocess.CompletedProcess(command, popen.wait(), *said)


def serve(listener: socket.socket) -> tuple[list[str], str, dict[str, str]]:
    """Fork for each request and report how the forks end; return, in a fork, what it has to run."""
    owners: dict[int, socket.socket] = {}
    connections: set[socket.socket] = set()
    wake, ring = os.pipe()
    os.set_blocking(ring, False)
    signal.set_wakeup_fd(ring)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    while True:
        ready = select.select([listener, wake, *connections], [], [])[0]
        if wake in ready:
            os.read(wake, 4096)
            report_ended(owners)
        if listener in ready and (connection := accepted(listener)):
            connections.add(connection)
        for connection in connections.intersection(ready):
            message, streams = received(connection)
            if not message:
                for pid in (pid for pid, owner in owners.items() if owner is connection):
                    os.kill(pid, signal.SIGKILL)
                connections.remove(connection)
                connection.close()
                if not connections:
                    sys.exit()
                continue
            pid = fork()
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                signal.signal(signal.SIGINT, signal.default_int_handler)
                os.dup2(streams[0], 1)
                os.dup2(streams[1], 2)
                for number in (wake, ring, *streams, *(one.detach() for one in (listener, *connections))):
                    os.close(number)
                command, folder, environment = json.loads(message)
                return command, folder, environment
            owners[pid] = connection
            for stream in streams:
                os.close(stream)
            connection.send(json.dumps([pid, None]).encode())


def accepted(listener: socket.socket) -> socket.socket | None:
    """Return a new connection, None if it is another user's."""
    connection = listener.accept()[0]
    _, user, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return connection if user == os.getuid() else None


def received(connection: socket.socket) -> tuple[bytes, list[int]]:
    """Return a request and its streams; nothing where the one who asked is gone."""
    try:
        return socket.recv_fds(connection, LARGEST, 2)[:2]
    except ConnectionResetError:
        return b"", []


def report_ended(owners: dict[int, socket.socket]) -> None:
    """Report each fork that ended to its owner, if that is still there."""
    for pid in list(owners):
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            with contextlib.suppress(OSError):
                owners.pop(pid).send(json.dumps([pid, os.waitstatus_to_exitcode(status)]).encode())


def fork() -> int:
    """Fork this process, in which Python has one thread; those of LTTng in rclpy wait and hold no lock."""
    assert threading.active_count() == 1, threading.enumerate()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def run(command: list[str], folder: str, environment: dict[str, str]) -> None:
    """Be the program."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    if command[0] == "-c":
        sys.argv = ["-c", *command[2:]]
        exec(compile(command[1], "<string>", "exec", dont_inherit=True), {"__name__": "__main__"})
    else:
        sys.argv = command
        runpy.run_path(command[0], run_name="__main__")


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends programs in the order that the tests ask for
    sys.path[:] = [folder for folder in sys.path if folder != str(Path(__file__).resolve().parent)]
    for module, _, function in (name.partition(":") for name in sys.argv[2:]):
        try:
            found = importlib.import_module(module)
        except ImportError as error:  # a library that is missing here: the program that needs it reports that
            if (error.name or "").startswith("spool_"):
                raise
            continue
        if function:
            getattr(found, function)()
    gc.freeze()  # a collection in a fork would copy all that it shares with the server
    run(*serve(socket.socket(fileno=int(sys.argv[1]))))
