"""Fixtures of several tests: a program that is killed while it works."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import TypeAlias

import pytest

#: Runs Python code with arguments, kills it after a number of lines, and returns each whole line it printed.
Killed: TypeAlias = Callable[[str, list[str], int], list[str]]


@pytest.fixture
def killed() -> Killed:
    def run(code: str, arguments: list[str], lines: int) -> list[str]:
        worker = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": ":".join(filter(None, sys.path))},
        )
        assert worker.stdout is not None
        told = [worker.stdout.readline() for _ in range(lines)]
        worker.send_signal(signal.SIGKILL)
        told += worker.stdout.read().splitlines(keepends=True)
        worker.wait()
        return [line.strip() for line in told if line.endswith("\n")]

    return run
