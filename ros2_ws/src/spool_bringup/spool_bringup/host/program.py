"""Program ``host``: spreads valves over a few processes and starts one that died again."""

from __future__ import annotations

import argparse
import ctypes
import os
import signal
import sys
import time
from types import FrameType
from typing import TYPE_CHECKING

from spool_stream.errors import InputError
from spool_stream.scheduling import run_before_others, use_processors
from spool_stream.text.standard_streams import keep_standard_streams

from .heartbeat import Heartbeat, notify

if TYPE_CHECKING:
    from .host_process import HostProcess

#: s before a process that died is started again, and times within an hour.
AGAIN, MOST = 2.0, 20
#: s without progress after which a process is killed: starting a node takes less than a second; and between
#: two looks.
LONGEST_SILENCE, LOOK = 30.0, 0.5
#: PR_SET_PDEATHSIG of prctl(2).
_PARENT_DEATH_SIGNAL = 1


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
        if options.cpus is not None:
            use_processors(options.cpus)
        if options.priority is not None:
            run_before_others(options.priority)
    except InputError as error:
        parser.error(str(error))
    arguments = [*(words[at:] or ["--ros-args"]), "-p", f"processes:={options.processes}"]
    from .middleware import economise  # noqa: PLC0415 - before the middleware is loaded

    economise()
    from .host_process import HostProcess  # noqa: PLC0415 - slow to load: once, for all processes

    if options.processes == 1:
        return HostProcess(arguments).run()
    return _supervise(HostProcess, arguments, options.processes)


def _supervise(kind: type[HostProcess], arguments: list[str], count: int) -> int:
    """Keep ``count`` processes running until a signal; return 2 where what was given is wrong.

    A process that makes no progress, whatever holds it up, is killed and started again.
    """
    from spool_estimator.warm_up import warm_up_estimator  # noqa: PLC0415
    from spool_monitor.warm_up import warm_up_monitor  # noqa: PLC0415

    # What is loaded here is shared by all processes.
    warm_up_estimator()
    warm_up_monitor()
    heartbeat = Heartbeat(count)
    children: dict[int, int] = {}
    asked: list[int] = []
    starts: list[float] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        asked.append(number)
        for child in children:
            os.kill(child, number)

    def start(number: int) -> None:
        heartbeat.beat(number)
        child = os.fork()
        if child == 0:
            children.clear()
            # Killed outright, the parent takes its processes along: two hosts would share the valves' names.
            ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, int(signal.SIGTERM))
            os._exit(kind(arguments, number, heartbeat).run())
        children[child] = number

    for asking in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asking, stop)
    for number in range(count):
        start(number)
    code = 0
    while children:
        child, status = os.waitpid(-1, os.WNOHANG)
        if not child:
            late = [one for one, number in children.items() if heartbeat.age(number) > LONGEST_SILENCE]
            for one in late:
                print(f"host {children[one]} makes no progress: it is killed", file=sys.stderr, flush=True)
                os.kill(one, signal.SIGKILL)
            if not late and not asked:
                notify("WATCHDOG=1")
            time.sleep(LOOK)
            continue
        ended_one = children.pop(child)
        ended = os.waitstatus_to_exitcode(status)
        if asked:
            continue
        if ended == 2:  # it was refused: what was given is wrong
            code = 2
            stop(signal.SIGTERM, None)
            continue
        starts = [at for at in starts if time.monotonic() - at < 3600.0]
        print(f"host {ended_one} ended with {ended}", file=sys.stderr, flush=True)
        if len(starts) < MOST:
            starts.append(time.monotonic())
            time.sleep(AGAIN)
            start(ended_one)
    return code


if __name__ == "__main__":
    sys.exit(main())
