"""Cost of running processes, as the kernel accounts for it."""

from __future__ import annotations

import os
from pathlib import Path


def family(process: int) -> list[int]:
    """Return ``process`` and all that it started."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii").split()
    return [process, *(one for child in children for one in family(int(child)))]


def processor_time(process: int) -> float:
    """Return user and system time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(process: int) -> tuple[int, int]:
    """Return the memory of a process, B: its share of what it shares, and all that is resident."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    found = {name: 1024 * int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
    return found["Pss"], found["Rss"]
