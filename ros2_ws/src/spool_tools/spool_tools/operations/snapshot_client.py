"""Client of the recorder's snapshots: keeps what surrounds this moment of a valve as a bag."""

from __future__ import annotations

from spool_core.errors import InputError
from spool_msgs.srv import TakeSnapshot

from .service_client import call, client_node, who_asks


def take_snapshot(valve: str, *, who: str, comment: str) -> None:
    """Ask the recorder for a snapshot of ``valve`` and say that it began.

    Raises:
        InputError: no recorder answers, or it refuses; its reason is given.
    """
    request = TakeSnapshot.Request(valve=valve, who=who_asks(who), comment=comment)
    with client_node("spool_snapshot", valve) as node:
        answer = call(node, "recorder", "take_snapshot", request, TakeSnapshot)
    if not answer.success:
        raise InputError(answer.reason)
    print(f"{valve}: the snapshot is being recorded; its bag is made when the time after it is over")
