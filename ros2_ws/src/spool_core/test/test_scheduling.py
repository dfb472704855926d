"""Processors and priority of a process, each tried in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from spool_core.errors import InputError
from spool_core.system import NICENESS, processor_list, run_before_others

ALLOWED = sorted(os.sched_getaffinity(0))


def answer(program: str) -> str:
    """Return the last line that ``program`` prints."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


def test_a_list_of_processors_may_have_ranges() -> None:
    first, last = ALLOWED[0], ALLOWED[-1]
    assert processor_list(f"{first},{last}") == {first, last}
    assert processor_list(f"{first}-{first}") == {first}


@pytest.mark.parametrize("text", ["", "two", "1-", "-1", "0,,1", "9999", "3-2"])
def test_what_is_no_list_of_processors_here_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^cpus: "):
        processor_list(text)


def test_a_process_is_bound_to_its_processors() -> None:
    last = ALLOWED[-1]
    said = answer(
        "import os\nfrom spool_core.system import use_processors\n"
        f"use_processors('{last}')\nprint(os.sched_getaffinity(0))"
    )
    assert said == f"{{{last}}}"


def test_threads_run_before_others_and_work_beside_the_stream_does_not() -> None:
    """Where the system does not grant it, the refusal says what is needed."""
    said = answer(
        "import os, threading\nfrom spool_core.errors import InputError\n"
        "from spool_core.system import give_way, run_before_others\n"
        "try:\n    run_before_others(7)\n"
        "except InputError as error:\n    print(error)\n    raise SystemExit\n"
        "found = []\n"
        "one = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0)))\n"
        "one.start(); one.join()\n"
        "give_way()\n"
        "print(found[0] == os.SCHED_FIFO, os.sched_getscheduler(0) == os.SCHED_OTHER, os.nice(0))"
    )
    if said.startswith("priority: "):
        assert "is not granted" in said
        assert "LimitRTPRIO=" in said
    else:
        # A process that is nice already, as a runner of tests may be, gets nicer; 19 is the nicest.
        assert said == f"True True {min(19, os.nice(0) + NICENESS)}"


@pytest.mark.parametrize("priority", [0, 100, -1])
def test_a_priority_that_is_none_is_refused(priority: int) -> None:
    with pytest.raises(InputError, match=r"^priority: "):
        run_before_others(priority)
