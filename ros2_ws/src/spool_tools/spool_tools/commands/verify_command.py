"""`./spool verify`: what was done to a recording since it was written."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError

from spool_tools.command import Command, Force, JsonFile


def verify(
    folder: Annotated[
        Path | None, typer.Argument(metavar="FOLDER", help="Recording: the folder with its parts.")
    ] = None,
    key: Annotated[
        Path | None, typer.Option(metavar="PUBLIC.pem", help="Public key by which the parts must be signed.")
    ] = None,
    make_keys: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Make a pair of keys there, for the recorder's signing_key."),
    ] = None,
    json: JsonFile = None,
    _force: Force = False,
) -> None:
    """List edited, removed or exchanged parts of a recording; exit 1 if there are any.

    Example: ./spool verify recordings/press_4
    Example: ./spool verify recordings/press_4 --key keys/spool_public.pem
    """
    from spool_bag.verification import make_keys as made  # noqa: PLC0415 - slow to load, as below
    from spool_bag.verification import verify as verified  # noqa: PLC0415
    from spool_report.outputs import write_json  # noqa: PLC0415
    from spool_report.terminal import progress  # noqa: PLC0415

    if make_keys is not None:
        private, public = made(make_keys)
        print(f"{private}: for the recorder's signing_key; keep it secret")
        print(f"{public}: for --key, where the recording is verified")
        return
    if folder is None:
        raise InputError("FOLDER: name the folder of a recording, or --make-keys DIR")
    with progress("verifying"):
        found = verified(folder, key)
    if json is not None:
        write_json(json, found)
    for line in (*found.wrong, *found.notes):
        print(line)
    signed = f", {found.signed} signed" if key is not None else ""
    state = f"{len(found.wrong)} things are wrong" if found.wrong else "as it was written"
    print(f"{folder}: {found.parts} parts{signed}: {state}")
    raise typer.Exit(1 if found.wrong else 0)


COMMAND = Command(verify, place=145, line="edited, removed or exchanged parts of a recording")
