"""Client of an estimator's gap analysis: asks for one of the last samples and waits for its answer."""

from __future__ import annotations

import json
from pathlib import Path

from spool_core.errors import InputError
from spool_core.node import qos
from spool_msgs.msg import GapAnalysis
from std_srvs.srv import Trigger

from spool_tools.console.outputs import write_file

from .service_client import call, client_node, until

#: s that an analysis of the last minute may take: twice its bound on one core, with others working besides.
LONGEST = 300.0


def analyse_live(valve: str, json_file: Path | None) -> None:
    """Ask the estimator of ``valve`` what its model lacks, and print the answer.

    Args:
        valve: namespace.
        json_file: takes everything, as `gap --json` writes it.

    Raises:
        InputError: no estimator answers, it refuses, or the analysis fails; the reason is given.
    """
    with client_node("spool_analyse", valve) as node:
        heard: list[GapAnalysis] = []
        node.create_subscription(GapAnalysis, f"/{valve}/gap", heard.append, qos.state())
        answer = call(node, f"{valve}/estimator", "analyse_gap", Trigger.Request(), Trigger)
        if not answer.success:
            raise InputError(f"{valve}: {answer.message}")
        print(f"{valve}: {answer.message}", flush=True)
        # The last answer is latched: what was heard until now is an earlier one.
        earlier = {_stamp(one) for one in heard}
        until(
            node,
            lambda: any(_stamp(one) not in earlier for one in heard),
            f"{valve}/estimator",
            patience=LONGEST,
        )
        found = next(one for one in reversed(heard) if _stamp(one) not in earlier)
    if found.state != GapAnalysis.STATE_DONE:
        raise InputError(f"{valve}: {found.sentence}")
    if json_file is not None:
        text = json.dumps(json.loads(found.json), indent=2) + "\n"
        write_file(json_file, text, "--json")
    print(f"{found.verdict}  (confidence {found.confidence.value:.2f}, of the last {found.window:.0f} s)")
    print(found.sentence)


def _stamp(message: GapAnalysis) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec
