"""Client of a monitor's baseline: what the healthy valve is held to be, shown, learned and confirmed."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table
from spool_core.errors import InputError
from spool_core.uncertainty import LEGEND, PLUS_MINUS, interval
from spool_msgs.srv import ManageBaseline

from .service_client import call, client_node, who_asks

#: Actions by the words of the command line.
ACTIONS = {
    "show": ManageBaseline.Request.SHOW,
    "learn": ManageBaseline.Request.LEARN,
    "freeze": ManageBaseline.Request.FREEZE,
    "restore": ManageBaseline.Request.RESTORE,
}


def manage_baseline(valve: str, action: str, *, version: int = 0, who: str = "", comment: str = "") -> None:
    """Do ``action`` (of ``ACTIONS``) with the baseline of ``valve`` and print what there is then.

    Raises:
        InputError: no monitor answers, or it refuses; its reason is given.
    """
    request = ManageBaseline.Request(
        action=ACTIONS[action],
        version=version,
        who="" if action == "show" else who_asks(who),
        comment=comment,
    )
    with client_node("spool_baseline", valve) as node:
        answer = call(node, f"{valve}/monitor", "manage_baseline", request, ManageBaseline)
    if not answer.success:
        raise InputError(f"{valve}: {answer.reason}")
    _show(valve, answer)


def _show(valve: str, answer: ManageBaseline.Response) -> None:
    console = Console(highlight=False)
    console = console if console.is_terminal else Console(highlight=False, width=140)
    words = [f"{valve}: baseline version {answer.version}, {answer.stage}"]
    words += [f"of {answer.valve_id}"] if answer.valve_id else []
    words += [f"oil {answer.oil}"] if answer.oil else []
    low, high = answer.temperature
    words += [f"learned at {low:.1f} to {high:.1f} deg C"] if math.isfinite(low) else []
    words += [f"confirmed by {answer.frozen_by}"] if answer.frozen_by else []
    console.print(", ".join(words), markup=False, soft_wrap=True)
    if not answer.values:
        return
    table = Table("parameter", "value", PLUS_MINUS, "unit", "estimates", box=None, pad_edge=False)
    for quantity, count in zip(answer.values, answer.counts, strict=True):
        shown = interval(quantity.value, quantity.standard_deviation)
        table.add_row(quantity.name, shown.value, shown.half_width, quantity.unit, str(count))
    console.print(table)
    console.print(f"{LEGEND}, of a single estimate", markup=False, soft_wrap=True)
