"""The processors that a process may use, not those of the machine."""

from __future__ import annotations

import subprocess
import sys

SAID = "from spool_core.system import processors; print(processors())"


def test_a_process_bound_to_one_processor_has_one() -> None:
    bind = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); "
    said = subprocess.run([sys.executable, "-c", bind + SAID], capture_output=True, text=True, check=True)
    assert int(said.stdout) == 1
