"""Runs the tools of a set-up: output to a log, their end when the door ends."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

GRACE_S = 5.0


def run_logged(
    command: Sequence[str | Path],
    log: Path,
    environment: Mapping[str, str],
    keep_open: int,
    on_line: Callable[[str], None] | None = None,
    cwd: Path | None = None,
) -> tuple[int, str]:
    """Run a tool with its output in `log`.

    Args:
        command: program and arguments.
        log: file that takes stdout and stderr; replaced.
        environment: the tool's whole environment.
        keep_open: descriptor of the set-up's lock: a tool that outlives a killed door goes on holding it.
        on_line: called with every line as it comes.
        cwd: folder to run in.

    Returns:
        Exit code and output.
    """
    lines: list[str] = []
    with log.open("w", encoding="utf-8") as file:
        file.write(" ".join(str(part) for part in command) + "\n")
        with subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
            env=dict(environment),
            cwd=cwd,
            pass_fds=(keep_open,),
            start_new_session=True,
        ) as process:
            assert process.stdout is not None
            try:
                for line in process.stdout:
                    file.write(line)
                    file.flush()
                    lines.append(line)
                    if on_line is not None:
                        on_line(line.rstrip())
                code = process.wait()
            except BaseException:
                _end_group(process)
                raise
    return code, "".join(lines)


def ask(command: Sequence[str | Path], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a short question to a program and return its answer, whatever its exit code."""
    return subprocess.run(
        [str(part) for part in command], env=dict(environment), capture_output=True, text=True, check=False
    )


def _end_group(process: subprocess.Popen[str]) -> None:
    """End a tool together with all that it started."""
    for signal_number in (signal.SIGINT, signal.SIGKILL):
        try:
            os.killpg(process.pid, signal_number)
            process.wait(GRACE_S)
            return
        except ProcessLookupError:
            return
        except subprocess.TimeoutExpired:
            continue
