"""What a recorder promises, whatever fails: a sample of faults here, a thousand by ``.ci/nightly``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from spool_evaluation.results.page import made_by

from .outcome import table
from .rig import run

#: Faults to inject, which seed chooses them, and how many recorders run at a time.
COUNT, SEED, AT_A_TIME = (
    int(os.environ.get(name, default))
    for name, default in (("SPOOL_FAULTS", "25"), ("SPOOL_FAULTS_SEED", "1"), ("SPOOL_FAULTS_AT_A_TIME", "2"))
)
HEAD = """# Faults injected into recordings

{made}

{count} faults, chosen by seed {seed}: real recorder processes that hear a valve at 2 kHz over DDS, with a
disk and a clock that fail on command (a library between the process and the C library), killed, terminated,
started again; and recordings cut off, changed, or left as a power loss at any write leaves them. Held
means: at most the last second lost, nothing lost that neither the bag nor `/diagnostics` states, no message
that nobody sent, no traceback. What is sent while no recorder runs does not count.
"""


def test_at_most_a_second_is_lost_nothing_unstated_nothing_made_up(
    claim_domain: Callable[[], AbstractContextManager[int]], tmp_path: Path
) -> None:
    with contextlib.ExitStack() as stack:
        domains = [stack.enter_context(claim_domain()) for _ in range(AT_A_TIME)]
        outcomes = run(tmp_path, COUNT, domains, SEED, print)
    text = table(outcomes)
    print(text, *(one for one in outcomes if not one.held), sep="\n")
    if "SPOOL_FAULTS_TABLE" in os.environ:
        made = made_by(f"SPOOL_FAULTS={COUNT} .ci/nightly")
        head = HEAD.format(made=made, count=len(outcomes), seed=SEED)
        Path(os.environ["SPOOL_FAULTS_TABLE"]).write_text(f"{head}\n{text}", "utf-8")
    assert len(outcomes) >= COUNT
    assert [one for one in outcomes if not one.held] == []
