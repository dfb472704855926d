"""Steps of a set-up: announced, timed, and their subprocesses ended with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

GRACE_S = 5.0

TERMINAL_REFRESH_S = 0.5


@dataclass(frozen=True)
class Runner:
    """Runs the tools of one set-up.

    Attributes:
        logs: folder of the logs.
        keep_open: descriptor of the set-up's lock: a tool that outlives a killed set-up goes on holding it.
        on_line: called with every line of a tool's output as it comes.
    """

    logs: Path
    keep_open: int
    on_line: Callable[[str], None]

    def log(self, name: str) -> Path:
        """The log of the step `name`."""
        return self.logs / f"{name}.log"

    def run(
        self, name: str, command: Sequence[str | Path], environment: Mapping[str, str]
    ) -> tuple[int, str]:
        """Run a tool with its output in the step's log.

        Args:
            name: of the step.
            command: program and arguments.
            environment: the tool's whole environment.

        Returns:
            Exit code and output.
        """
        lines: list[str] = []
        with self.log(name).open("w", encoding="utf-8") as file:
            file.write(" ".join(str(part) for part in command) + "\n")
            with self._started(command, environment, subprocess.PIPE) as process:
                for line in process.stdout or ():
                    file.write(line)
                    file.flush()
                    lines.append(line)
                    self.on_line(line.rstrip())
                code = process.wait()
        return code, "".join(lines)

    @contextmanager
    def in_parallel(
        self, name: str, command: Sequence[str | Path], environment: Mapping[str, str]
    ) -> Iterator[Callable[[], int]]:
        """Run a tool in parallel with the body, with its output in the step's log.

        Args:
            name: of the step.
            command: program and arguments.
            environment: the tool's whole environment.

        Yields:
            What waits for the tool's end and returns its exit code.
        """
        with self.log(name).open("wb") as file, self._started(command, environment, file.fileno()) as process:
            yield process.wait

    @contextmanager
    def _started(
        self, command: Sequence[str | Path], environment: Mapping[str, str], output: int
    ) -> Iterator[subprocess.Popen[str]]:
        """Start a tool, and end it where the body is interrupted."""
        with subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
            env=dict(environment),
            pass_fds=(self.keep_open,),
            start_new_session=True,
        ) as process:
            try:
                yield process
            except BaseException:
                _end_group(process)
                raise


def ask(command: Sequence[str | Path], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a short question to a program and return its answer, whatever its exit code."""
    return subprocess.run(
        [str(part) for part in command], env=dict(environment), capture_output=True, text=True, check=False
    )


def say(line: str) -> None:
    """One line on stderr; stdout belongs to the command's own work."""
    print(f"spool: {line}", file=sys.stderr, flush=True)


class Steps:
    """Counts the steps of a set-up.

    Attributes:
        total: how many steps there will be.
    """

    def __init__(self) -> None:
        self.total = 0
        self._number = 0
        self._began = time.monotonic()
        self._drawn = 0.0
        self._line = ""
        self._step_began = self._began

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        """Announce a step, and say how long it took."""
        self._number += 1
        self._line = f"[{self._number}/{self.total}] {what} ..."
        self._step_began = time.monotonic()
        print(self._line, end="", file=sys.stderr, flush=True)
        try:
            yield
        except BaseException:
            sys.stderr.write("\n")
            raise
        took = time.monotonic() - self._step_began
        print(f"{self._start_of_line()} {took:.0f} s", file=sys.stderr, flush=True)

    def progress(self, what: str) -> None:
        """Draw what is going on, on a terminal only and not too often."""
        now = time.monotonic()
        if sys.stderr.isatty() and now - self._drawn > TERMINAL_REFRESH_S:
            self._drawn = now
            line = f"{self._start_of_line()} {now - self._step_began:.0f} s  {what[:40]}"
            print(line, end="", file=sys.stderr, flush=True)

    def elapsed(self) -> float:
        """Seconds since the first step."""
        return time.monotonic() - self._began

    def _start_of_line(self) -> str:
        return f"\r\033[K{self._line}" if sys.stderr.isatty() else ""


def _end_group(process: subprocess.Popen[str]) -> None:
    with suppress(ProcessLookupError):
        for signal_number in (signal.SIGINT, signal.SIGKILL):
            with suppress(subprocess.TimeoutExpired):
                os.killpg(process.pid, signal_number)
                process.wait(GRACE_S)
                return
