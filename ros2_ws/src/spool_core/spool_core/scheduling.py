"""Scheduling of processes: which processors, and whether before all others (sched(7))."""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import re
import signal
import threading

from .errors import InputError

#: Niceness of what gives way to the stream where processors are short.
NICENESS = 10


def give_way() -> None:
    """Begin a process that works beside the stream: it gives way to it, and leaves Ctrl-C to its parent.

    It ends with its parent, however that ends: a pool's process would wait for work for ever.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.sched_getscheduler(0) != os.SCHED_OTHER:  # of a parent that runs before all others
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICENESS)


def _end_with(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


def processor_list(text: str) -> set[int]:
    """Return the processors of a list such as ``2,4-6``.

    Raises:
        InputError: it is no such list, or names a processor that this process may not use.
    """
    found: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", part.strip())
        if match is None:
            raise InputError(f"cpus: {text!r} is no list of processors: write 2 or 2,3 or 2-3")
        found |= set(range(int(match[1]), int(match[2] or match[1]) + 1))
    allowed = os.sched_getaffinity(0)
    if not found or found - allowed:
        named = ", ".join(map(str, sorted(allowed)))
        raise InputError(f"cpus: {text!r}: this process may use {named}")
    return found


def use_processors(text: str) -> None:
    """Bind this process, and what it starts, to the processors of a list such as ``2,4-6``.

    Raises:
        InputError: as of :func:`processor_list`.
    """
    os.sched_setaffinity(0, processor_list(text))


def run_before_others(priority: int) -> None:
    """Run this process, and threads that it starts, under SCHED_FIFO at ``priority``, 1 to 99.

    Raises:
        InputError: the priority is none, or the system does not grant it.
    """
    if not 1 <= priority <= 99:
        raise InputError(f"priority: {priority} is none of SCHED_FIFO: 1 to 99")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        raise InputError(
            f"priority: SCHED_FIFO {priority} is not granted ({error.strerror}): it needs CAP_SYS_NICE or a "
            f"limit of at least {priority} (LimitRTPRIO= of the service, rtprio in /etc/security/limits.conf)"
        ) from None
