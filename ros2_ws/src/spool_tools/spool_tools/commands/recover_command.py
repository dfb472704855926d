"""`./spool recover`: a damaged bag made readable."""

from __future__ import annotations

import typer
from spool_core.text import plural, printable
from spool_report.outputs import damaged_places, lost_messages, making_room
from spool_report.terminal import progress, warn

from spool_tools.command import BagArgument, Command, Force, NewBag, refuse_missing

#: Damaged places of a bag that are listed one by one.
MOST_PLACES = 20


def recover(bag: BagArgument, out: NewBag, _force: Force = False) -> None:
    """Make a damaged bag readable and count the saved messages; exit 1 if messages were lost.

    Example: ./spool recover killed_bag --out saved_bag
    """
    refuse_missing(bag)
    from spool_bag.verification import recover as copy_readable  # noqa: PLC0415 - slow to load

    with making_room(out), progress("recovering"):
        result = copy_readable(bag, out)
    kept, bad = sum(result.messages.values()), sum(result.undecodable.values())
    lost = lost_messages(result.lost, estimated=result.estimated)
    damaged = damaged_places(result.damages)
    print(f"{out}: {plural(kept, 'message')} saved, {lost} lost, {bad} not decodable, {damaged}")
    for damage in result.damages[:MOST_PLACES]:
        gone = "an unknown number of" if damage.lost is None else str(damage.lost)
        place = f"at byte {damage.offset}, {damage.size} bytes: {printable(damage.reason)}"
        print(f"  {place}; {gone} messages lost")
    if len(result.damages) > MOST_PLACES:
        print(f"  and {len(result.damages) - MOST_PLACES} more")
    for valve, missing in result.missing.items():
        print(f"  /{printable(valve)}: missing by sequence numbers: {plural(missing, 'block')}")
    if not result.closed:
        print("  the recording was not finished: data not yet written to the disk are not counted")
    for warning in result.warnings:
        warn(warning)
    raise typer.Exit(1 if result.lost or bad or result.damages else 0)


COMMAND = Command(recover, place=140, line="a damaged bag made readable")
