"""Program ``host``: estimators and monitors of many valves in one process, or spread over a few."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from spool_core.errors import InputError, libraries_reported
from spool_core.kernels.kernel_files import COMPILING, KernelCache
from spool_core.node.network import check_middleware
from spool_core.node.stop import STOP
from spool_core.system import run_before_others, use_processors
from spool_core.text import keep_standard_streams

from spool_bringup.host.arguments import FirstList, economise
from spool_bringup.host.supervisor import Run, Supervisor


def main() -> int:
    """Run the host; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="host",
        description="Estimators and monitors of many valves, managed nodes all, in a few processes.",
        epilog="Example: ros2 run spool_bringup host --processes 2 --ros-args -p valves_file:=valves.yaml",
    )
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--cpus", metavar="LIST", help="processors that they may use, such as 2,3 or 2-3")
    parser.add_argument(
        "--priority",
        type=int,
        metavar="P",
        help="run before all others, under SCHED_FIFO at this priority, 1 to 99",
    )
    words = sys.argv[1:]
    at = words.index("--ros-args") if "--ros-args" in words else len(words)
    options = parser.parse_args(words[:at])
    if not 1 <= options.processes <= 64:
        parser.error("--processes: 1 to 64")
    keep_standard_streams()
    try:
        check_middleware()
        if options.cpus is not None:
            use_processors(options.cpus)
        if options.priority is not None:
            run_before_others(options.priority)
    except InputError as error:
        parser.error(str(error))
    arguments = [*(words[at:] or ["--ros-args"]), "-p", f"processes:={options.processes}"]
    economise()  # before the middleware is loaded
    if options.processes > 1:
        return Supervisor(options.processes, partial(_load, arguments, FirstList())).run()
    STOP.install()
    with libraries_reported("host"):
        from spool_bringup.host.host_process import HostProcess  # noqa: PLC0415 - slow to load

    return HostProcess(arguments).run()


def _load(arguments: list[str], valves: FirstList) -> Run:
    with libraries_reported("host"):
        from spool_bringup.host.host_process import HostProcess  # noqa: PLC0415 - slow to load, once for all

    with _compiling_said():
        HostProcess.warm_up()
    return lambda number, heartbeat: HostProcess(arguments, number, heartbeat, valves).run()


@contextmanager
def _compiling_said() -> Iterator[None]:
    """Say that kernels compile where they do: nothing is monitored meanwhile."""
    begun = 0.0

    def watch(_change: int) -> None:
        nonlocal begun
        if not begun:
            begun = time.monotonic()
            print(f"host: {COMPILING}: it may take a minute", file=sys.stderr, flush=True)

    before, KernelCache.watch = KernelCache.watch, watch
    try:
        yield
    finally:
        KernelCache.watch = before
    if begun:
        print(f"host: kernels ready after {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
